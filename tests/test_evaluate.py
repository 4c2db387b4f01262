"""`quaffure evaluate` and `quaffure score`: their files, their page, and one line for every mistake."""

import json
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from quaffure import HairMaterial, InputError, load_groom
from quaffure.apps.cli.main import main
from quaffure.benchmark import CaseEntry, GroomSource
from quaffure.benchmark.evaluation_set import EvaluationSet
from quaffure.benchmark.methods import methods
from quaffure.benchmark.report import METRICS, PAGE, PICTURE, RATIOS, cell_text, headline, page
from quaffure.body import BodyModel
from quaffure.hair import Groom
from quaffure.io import write_groom
from quaffure.model import NetworkConfig, build_network, save_network
from tests.test_comparison import STRANDS, tiny_groom

MATERIAL = HairMaterial(k_cosserat=1e-7)
"""Of the network that stands in for the shipped one."""
DOCS = Path(__file__).parents[1] / "docs"


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, groom: Groom) -> Path:
    """A folder with a groom and networks that were trained for our hair and for other hair."""
    folder = tmp_path_factory.mktemp("inputs")
    write_groom(folder / "tiny.npz", groom)
    torch.manual_seed(0)
    network = build_network(NetworkConfig(texel_channels=4, strand_width=8))
    save_network(folder / "own.safetensors", network, MATERIAL, {"trained": "not at all"})
    other = build_network(NetworkConfig(texel_channels=4, strand_width=8))
    save_network(folder / "other.safetensors", other, MATERIAL, {"trained": "neither"})
    save_network(folder / "stiff.safetensors", network, replace(MATERIAL, k_cosserat=1.0), {})
    return folder


@pytest.fixture(autouse=True)
def timed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No drape is repeated only to be timed."""
    monkeypatch.setattr("quaffure.benchmark.draping.REPEATS", 1)


@pytest.fixture
def tiny_set(inputs: Path) -> EvaluationSet:
    """A set of two cases on the small groom, one of them on a motion file that is not there."""
    entries = (CaseEntry("tiny", "bow", "a", (40, 41, 42)), CaseEntry("tiny", "13_26", "a", (3,)))
    grooms = {"tiny": GroomSource("unseen", "tiny.npz")}
    return EvaluationSet(7, 30.0, ("13_26",), {"a": (0.5,) * 10}, grooms, entries, ("tiny-bow-a",))


@pytest.fixture
def run(tmp_path: Path, inputs: Path, tiny_set: EvaluationSet) -> Callable[..., None]:
    """Runs a command of the command line on the small set."""

    def run(command: str, *arguments: str | Path) -> None:
        folders: tuple[str | Path, ...] = ("--cache", tmp_path / "cache", "--motion-folder", inputs)
        folders += () if "--groom-folder" in arguments else ("--groom-folder", inputs)
        with mock.patch("quaffure.apps.cli.evaluate.load_evaluation_set", return_value=tiny_set):
            weights = ("--weights", f"neural={inputs / 'own.safetensors'}")
            main([command, *map(str, (*folders, *weights, *arguments))])

    return run


@pytest.fixture
def refused(run: Callable[..., None], capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must fail with exit code 2, and gives the one line it says."""

    def refused(*arguments: str | Path) -> str:
        with pytest.raises(SystemExit) as stop:
            run(*arguments)
        errors = capfd.readouterr().err
        assert stop.value.code == 2, errors
        assert errors.count("\n") == 1
        return errors

    return refused


def rows_of(text: str, title: str) -> dict[str, dict[str, str]]:
    """The cells of one table of a page, by row and column."""
    lines = text.split(f"## {title}\n\n")[1].split("\n\n")[0].splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: dict(zip(cells[0], row)) for row in cells[2:]}


def check_page(text: str, results: dict) -> None:
    """The page says what results.json holds, to the digit, and nothing is missing."""
    everything, hair = headline(results["summary"])
    for title, time_kind, kind in (("Means", "median", "mean"), ("Worst frames", "worst", "worst")):
        table = rows_of(text, title + hair)
        assert list(table) == list(everything)
        for row, figures in everything.items():
            for key in METRICS:
                known = figures.get(key, {}).get(time_kind if key == "milliseconds" else kind)
                assert table[row][key] == ("" if known is None else f"{known:.4g}"), (row, key)
    solvers = everything.keys() & {"adam", "lbfgs", "groomgen"}
    for row in solvers if "neural" in everything else ():
        cells, own, ours = rows_of(text, RATIOS)[row], everything[row], everything["neural"]
        time = own["milliseconds"]["median"] / ours["milliseconds"]["median"]
        turned = own["orientation_error_deg"]["mean"] / ours["orientation_error_deg"]["mean"]
        assert (cells["seconds"], cells["orientation"]) == (f"{time:.4g}", f"{turned:.4g}")
    for key in ("body_intersection_percent", "excess_energy", "distance_mm"):
        for row, cells in rows_of(text, f"{key} by group of cases").items():
            means = {
                group: f"{rows[row][key]['mean']:.4g}" for group, rows in results["summary"].items() if row in rows
            }
            assert means.items() <= cells.items()
    assert list(rows_of(text, "Rows")) == list(results["rows"])
    for note in results["rows"].values():
        for name, value in note["weights"].items():
            assert f"{name} {value}" in text


def test_evaluate_writes_the_same_on_file_page_and_screen(
    run: Callable[..., None], tmp_path: Path, inputs: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    out, report = tmp_path / "results.json", tmp_path / "report"
    weights = ("--weights", f"mine={inputs / 'other.safetensors'}")
    chosen = [word for name in ("posed", "strand_newton", "neural", "mine") for word in ("--draper", name)]
    run("evaluate", "--out", out, "--report", report, *chosen, *weights)
    screen = capfd.readouterr().out
    results = json.loads(out.read_text())
    text = (report / PAGE).read_text()
    check_page(text, results)
    assert (report / PICTURE).read_bytes().startswith(b"\x89PNG")
    assert "left out" in screen
    assert "13_26.bvh" in screen
    assert "tiny-bow-a: 3 frames" in screen
    assert results["skipped"] == {"tiny-13_26-a": "13_26.bvh"}
    assert "tiny-13_26-a" in text
    assert (results["evaluation_set"], results["drapes_made"], results["drapes_fetched"]) == (7, 12, 0)
    assert results["material"] == asdict(MATERIAL)
    assert list(results["rows"]) == ["posed", "strand_newton", "neural", "mine"]
    assert results["rows"]["mine"]["weights"] == {"trained": "neither"}
    (only,) = results["cases"]
    assert (only["case"], only["group"], only["frames"]) == ("tiny-bow-a", "unseen", [40, 41, 42])
    assert only["reference"] == ["strand_newton"] * 3
    assert only["figures"]["strand_newton"]["jitter"] == [1]
    assert min(only["figures"]["posed"]["excess_energy"]) > 0
    for key, figure in results["summary"]["all"]["mine"].items():
        assert re.search(rf"{key} .*{re.escape(cell_text(figure['worst']))}", screen), key
    run("evaluate", "--out", out, "--json", *chosen, *weights)
    again = json.loads(capfd.readouterr().out)
    assert again == json.loads(out.read_text())
    assert (again["drapes_made"], again["drapes_fetched"]) == (0, 12)
    assert again["summary"] == results["summary"]


@pytest.fixture
def every_ninth_strand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Grooms of the set with a ninth of their strands."""

    def thinned(name: str, body: BodyModel) -> Groom:
        groom = load_groom(name, body)
        return groom.select(torch.arange(0, len(groom), 9))

    monkeypatch.setattr("quaffure.benchmark.evaluation_set.load_groom", thinned)


@pytest.mark.slow
@pytest.mark.usefixtures("every_ninth_strand")
def test_the_quick_evaluation_of_the_shipped_weights(tmp_path: Path) -> None:
    out = tmp_path / "quick.json"
    main(["evaluate", "--quick", "--out", str(out), "--report", str(tmp_path), "--cache", str(tmp_path / "cache")])
    results = json.loads(out.read_text())
    check_page((tmp_path / PAGE).read_text(), results)
    assert results["skipped"] == {}
    assert (len(results["cases"]), results["drapes_made"]) == (4, 24)
    assert results["summary"].keys() > {"free", "tied"}
    rows = results["summary"]["free"]
    assert list(rows) == ["posed", "strand_newton", "neural", "neural_settled"]
    assert [mean_of(rows, row, "energy") for row in ("strand_newton", "neural_settled", "neural", "posed")] == sorted(
        mean_of(rows, row, "energy") for row in rows
    )
    inside, length, turned = "body_intersection_percent", "length_error_percent", "orientation_error_deg"
    assert mean_of(rows, "neural", inside) < 0.5 < mean_of(rows, "posed", inside)
    assert mean_of(rows, "neural", length) < 0.01
    assert mean_of(rows, "neural", turned) < 1.5 * mean_of(rows, "strand_newton", turned)


def mean_of(rows: dict, row: str, figure: str) -> float:
    return rows[row][figure]["mean"]


def test_evaluate_takes_what_a_user_brings(
    run: Callable[..., None], tmp_path: Path, inputs: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "results.json", tmp_path / "report"
    posed = ("--draper", "posed")
    with mock.patch("quaffure.benchmark.report.is_installed", return_value=False):
        run("evaluate", "--out", out, "--groom", inputs / "tiny.npz", "--motion", "nod", *posed, "--report", report)
    printed = capfd.readouterr().out
    results = json.loads(out.read_text())
    assert results["evaluation_set"] is None
    assert [(case["case"], case["group"], case["frames"]) for case in results["cases"]] == [
        ("tiny-nod", "own", [15, 45, 75])
    ]
    assert [path.name for path in report.rglob("*.*")] == [PAGE]
    assert "pip install 'quaffure[docs]'" in printed
    shape = ("--shape", ",".join("1" * 10))
    frames = ("--frames", "4:10:2")
    run("evaluate", "--out", out, "--groom", inputs / "tiny.npz", "--motion", "walk", *posed, *shape, *frames)
    (case,) = json.loads(out.read_text())["cases"]
    assert (case["clip"], case["frames"], case["shape"]) == ("walk", [4, 6, 8], shape[1])


@pytest.mark.slow
def test_drapes_of_another_method_are_scored_like_our_own(
    run: Callable[..., None], refused: Callable[..., str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out, folder = tmp_path / "results.json", tmp_path / "cases"
    run("evaluate", "--out", out, "--draper", "posed", "--draper", "strand_newton")
    own = json.loads(out.read_text())["summary"]["all"]
    run("evaluate", "--write-cases", folder)
    (path,) = folder.iterdir()
    assert path.name == "tiny-bow-a.npz"
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    assert arrays["rest_strands"].shape == arrays["strands"].shape[1:] == (STRANDS, 24, 3)
    capfd.readouterr()
    run("score", path, "--json")
    scored = json.loads(capfd.readouterr().out)
    summary = scored["summary"]["all"]
    assert list(summary) == ["submission", "posed", "strand_newton"]
    # Posed frame by frame or all at once, hair differs in its last bit; angles and jitters of almost zero show it.
    untimed = {key: value for key, value in own["posed"].items() if key != "milliseconds"}
    assert set(summary["submission"]) == set(untimed)
    for key, figure in untimed.items():
        assert summary["submission"][key] == pytest.approx(figure, rel=1e-3, abs=5e-3), key
    assert summary["posed"] == own["posed"]

    def submitted(name: str, **changed: object) -> Path:
        meta = json.loads(str(arrays["meta"])) | changed.pop("meta", {})  # type: ignore[operator]
        np.savez(tmp_path / f"{name}.npz", **(arrays | {"meta": np.array(json.dumps(meta))} | changed))
        return tmp_path / f"{name}.npz"

    strands = arrays["strands"]
    run("score", submitted("timed", meta={"milliseconds": 12.5}), "--name", "theirs")
    assert "theirs" in capfd.readouterr().out
    assert "finite strands" in refused("score", submitted("nan", strands=strands * np.float32(np.nan)))
    assert "evaluation_set 7" in refused("score", submitted("old", meta={"evaluation_set": 1}))
    assert "'magic'" in refused("score", submitted("other", meta={"case": "magic"}))
    fewer = {name: arrays[name][:2] for name in ("strands", "posed", "body_vertices", "body_pose")}
    assert "(3, 40, 24, 3)" in refused("score", submitted("short", **fewer))
    assert "roots within 1 mm" in refused("score", submitted("millimetres", strands=1000 * strands))
    assert "the body_pose of the case" in refused("score", submitted("turned", body_pose=arrays["body_pose"] + 0.1))
    assert "hair of" in refused("score", submitted("soft", meta={"material": {}}))
    assert "one drape of tiny-bow-a" in refused("score", path, submitted("twice"))
    assert "no such file" in refused("score", tmp_path / "none.npz")
    assert "--name" in refused("score", path, "--name", "strand_newton")
    assert "13_26.bvh" in refused("score", submitted("far", meta={"case": "tiny-13_26-a"}))


def test_score_says_when_there_is_nothing_to_measure_against(
    run: Callable[..., None], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run("evaluate", "--write-cases", tmp_path / "cases", "--json")
    (path,) = json.loads(capfd.readouterr().out)
    run("score", path)
    assert "no reference for tiny-bow-a" in capfd.readouterr().out


def test_rows_share_one_hair(inputs: Path) -> None:
    own = methods(("posed", "adam", "neural_settled"), {"neural": inputs / "stiff.safetensors"})
    assert {row.draper.material.k_cosserat for row in own} == {1.0}
    assert [row.is_solver for row in own] == [False, True, False]
    both = {"neural": inputs / "own.safetensors", "stiff": inputs / "stiff.safetensors"}
    with pytest.raises(InputError, match=r"stiff\.safetensors: expected weights for hair of"):
        methods(("posed",), both)
    twice = methods(("neural", "posed", "neural"), {"neural": inputs / "own.safetensors"})
    assert [row.name for row in twice] == ["neural", "posed"]


def test_a_network_has_one_name_everywhere(inputs: Path) -> None:
    for row in methods(("posed", "neural", "neural_settled"), {"neural": inputs / "own.safetensors"}):
        assert row.draper.name == row.name


def test_an_evaluation_without_cases_writes_nothing(refused: Callable[..., str], tmp_path: Path) -> None:
    nothing = ("--groom-folder", tmp_path, "--json")
    out = ("--out", tmp_path / "results.json", "--report", tmp_path / "report")
    assert "expected at least one case" in refused("evaluate", *out, *nothing)
    assert "expected at least one case" in refused("evaluate", "--write-cases", tmp_path / "cases", *nothing)
    assert not list(tmp_path.iterdir())


def test_mistakes_are_told_in_one_line_before_the_work(
    refused: Callable[..., str], tmp_path: Path, inputs: Path
) -> None:
    out = ("--out", tmp_path / "results.json")
    own = inputs / "own.safetensors"
    with mock.patch("quaffure.apps.cli.evaluate.compare", side_effect=AssertionError):
        assert "--out" in refused("evaluate")
        assert "suffix .json" in refused("evaluate", "--out", tmp_path / "results.txt")
        assert "existing folder" in refused("evaluate", "--out", tmp_path / "none" / "results.json")
        assert "'magic'" in refused("evaluate", *out, "--draper", "magic")
        assert "NAME=FILE" in refused("evaluate", *out, "--weights", own)
        assert "another name" in refused("evaluate", *out, "--weights", f"strand_newton={own}")
        assert "'a b'" in refused("evaluate", *out, "--weights", f"a b={own}")
        assert "hair of" in refused("evaluate", *out, "--weights", f"stiff={inputs / 'stiff.safetensors'}")
        assert "no such file" in refused("evaluate", *out, "--weights", f"none={inputs / 'none.safetensors'}")
        assert "--groom" in refused("evaluate", *out, "--groom", "bob", "--quick")
        assert "--frames" in refused("evaluate", *out, "--frames", "3:5")
    assert not list(tmp_path.glob("*.json"))


def test_the_committed_page_says_what_the_committed_results_hold() -> None:
    committed = DOCS / "evaluation_results.json"
    if not committed.is_file():
        pytest.skip(f"no {committed.name}: no evaluation has been committed")
    results = json.loads(committed.read_text())
    text = (DOCS / PAGE).read_text()
    check_page(text, results)
    assert text == page(results, with_picture=PICTURE in text)
