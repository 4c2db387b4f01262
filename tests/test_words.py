"""The words of the package: names and sentences that an engineer of the field understands without our docs.

Each entry of `WORDS` is a word that was once used here in a private sense, with the term of the field that replaces
it. A word with a common technical meaning of its own is matched only in its private use.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import quaffure
from quaffure.apps.cli.main import main

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "quaffure"
MODULES = sorted(SOURCE.rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMANDS = (
    *("drape", "train", "train-code", "groomgen-data", "train-groomgen", "render", "view", "evaluate", "score"),
    *("benchmark inference", "benchmark solvers", "grooms", "groom new", "groom import", "inspect", "info"),
    *("export-onnx", "rig", "crowd", "doctor", "groom hold", "body import", "body show"),
)

WORDS = {
    # Words of sentences and of names with underscores: whole words, in any case.
    r"undeformed": "initial shape",
    r"told": "features, network input; reported",
    r"answers?|answered|answering": "outputs, predictions",
    r"feels?|felt": "estimates the contact force",
    r"leaders?|leader_of": "cluster representative",
    r"handed_back|(?<!-)handed": "propagated from tip to root, passed",
    r"slides|slid|slid_twice": "contact resolution",
    r"sees": "reads, evaluates",
    r"(?:looks|looked)(?! up)": "evaluates, appears, searches",
    r"faint": "kernel cutoff",
    r"whereabouts": "classify",
    r"unlisted": "out of band",
    r"dealt": "interleaved",
    r"rooms?|roomy": "module, package, workspace, space",
    r"house": "package",
    r"packets?": "SIMD block",
    r"crowds?|crowded|crowding": "density, active particles; busy",
    r"crease|bulge": "curvature part of the Hessian",
    r"surprise": "model error",
    r"forecast|foretold|foretells?": "predicted reduction",
    r"is_bent": "negative curvature",
    r"carried": "transported, moved rigidly",
    r"sag(?![-_ ]free)|sags|sagged|sagging": "gravity equilibrium, sag-free",
    r"limit_forces": "gradient clipping",
    r"stubble": "very short hair",
    r"hair_cut|gathering": "trimming, ties",
    r"garden": "cache",
    r"grown|growings": "generated, a procedural sample",
    r"gauges?": "metric",
    r"figures? of merit": "metric",
    r"competitors?": "method",
    r"(?<!_)of_first": "broadcast from rank 0",
    r"walks|walked|walking": "traverses",
    # In sentences these words are common; in names they had a private sense.
    r"(?:soft_body|soft_surface|wide_tree|face_tree|clear_cells|face_grid)s?": "MLS body, BVH, grid",
    r"(?:foot_points|head_view|hair_skin)s?": "closest points, body in the frame of the head, skin for contact",
    r"strand_packets|starting_margin|strand_weights|fitted_groom": "blocks, clearance, clipping, prepared groom",
    r"pressing_particles|density_crowd": "active particles",
    r"beside_\w+|\w+_beside": "neighbors",
    r"following_\w+|\w+_following": "parallel-transported frames",
    r"turns_of|edge_turns|\w+_turns": "rotations",
}
CLASSES = {
    r"Undeformed\w*|LedPackets|HeadView": "initial shape, blocks, body in the frame of the head",
    r"SpaceMap|FaceGrid|FootPoints": "occupancy grid, triangle grid, closest points",
    r"Crowd|Forecast|FittedGroom|Garden|Growing": "active particles, prediction, prepared groom, cache, sample",
    r"Trust\b(?=\(|:|\[| =)|SIGHT|ALONE|MEMORY": "trust-region state, kernel radius, single process, EMA decay",
    # A docstring that begins with "Of" has its object before its verb.
    r"(?<=\"\"\")Of\b": "subject, verb, object",
}
ALLOWED = (
    r"[\"']slides[\"']|--(?:no-)?slides",  # a key of weights files and its option
    r"[\"]crowd[\"]|quaffure crowd|(?:docs/)?crowd\.md|\[CROWD OPTIONS\]|^crowd$",  # the command for many characters
)


def findings(text: str) -> Iterator[str]:
    """Lines of `text` with a word of the tables: line number, word, replacement."""
    prose = re.compile(
        "|".join(rf"(?P<w{i}>(?<![A-Za-z])(?:{word})(?![A-Za-z]))" for i, word in enumerate(WORDS)), re.I
    )
    classes = re.compile("|".join(rf"(?P<c{i}>(?<![A-Za-z])(?:{name}))" for i, name in enumerate(CLASSES)))
    terms = {f"w{i}": term for i, term in enumerate(WORDS.values())} | {
        f"c{i}": term for i, term in enumerate(CLASSES.values())
    }
    for number, line in enumerate(text.splitlines(), 1):
        kept = re.sub("|".join(ALLOWED), " ", line)
        for match in (*prose.finditer(kept), *classes.finditer(kept)):
            yield f"{number}: {match[0]!r} -> {terms[match.lastgroup or '']}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_modules_use_the_words_of_the_field(path: Path) -> None:
    assert not list(findings(path.read_text(encoding="utf-8")))
    assert not list(findings(path.stem))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_pages_use_the_words_of_the_field(path: Path) -> None:
    assert not list(findings(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_uses_the_words_of_the_field(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    text = capfd.readouterr().out
    assert command.split()[0] in text
    assert not list(findings(text))


@pytest.mark.parametrize(
    "line",
    [
        "def slid_twice(hair):",
        "grown = grow(style)",
        "class FaceGrid:",
        '"""Of one strand the length."""',
        "what the network is told",
        "the face_tree of a body",
        "Figures of merit",
    ],
)
def test_private_words_are_found(line: str) -> None:
    assert list(findings(line))


@pytest.mark.parametrize(
    "line", ['settings["slides"]', 'bundled_clip("walk")', "for node in ast.walk(tree)", "trust region", "a guide"]
)
def test_common_words_are_not_found(line: str) -> None:
    assert not list(findings(line))


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.name
)
def test_modules_named_in_the_docs_exist(path: Path) -> None:
    for dotted in re.findall(r"`quaffure((?:\.[a-z_0-9]+)+)", path.read_text(encoding="utf-8")):
        parts = dotted.strip(".").split(".")
        if parts == ["safetensors"] or (len(parts) == 1 and parts[0] in quaffure.__all__):
            continue  # the file of the weights; a public name
        first_two = SOURCE.joinpath(*parts[:2])
        assert first_two.is_dir() or first_two.with_suffix(".py").is_file(), f"quaffure{dotted}"
