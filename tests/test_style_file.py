from pathlib import Path

import pytest

from quaffure import InputError
from quaffure.procedural import Fringe, HairStyle, read_styles
from quaffure.procedural.hair_style import Tie


def styles_of(text: str, tmp_path: Path) -> dict[str, HairStyle]:
    path = tmp_path / "styles.toml"
    path.write_text(text)
    return read_styles(path)


def test_controls_of_a_file_replace_the_defaults(tmp_path: Path) -> None:
    text = """
    [short]
    length = 0.1
    length_map = [1.0, 0.9, 0.8, 0.7]
    cut_around_ears = true
    parting = "none"
    flat_top = 0.2
    root_rows = 12
    fringe = { depth = 0.04 }
    ties = [{ side = 1 }, { side = -1, place = [0.1, 0.7] }]
    [plain]
    """
    expected = HairStyle(
        length=0.1, length_map=(1.0, 0.9, 0.8, 0.7), cut_around_ears=True, parting=None, flat_top=0.2, root_rows=12,
        fringe=Fringe(depth=0.04), ties=(Tie(side=1), Tie(side=-1, place=(0.1, 0.7))),
    )  # fmt: skip
    assert styles_of(text, tmp_path) == {"short": expected, "plain": HairStyle()}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("lenght = 0.1", "styles.toml: wrong: expected one of the controls length, .* found 'lenght'"),
        ("fringe = { with = 0.1 }", "styles.toml: wrong.fringe: expected one of the controls cut_height, "),
        ("ties = [{ side = 0.5 }]", "wrong.ties.side: expected int, found 0.5"),
        ('length = "0.1"', "wrong.length: expected float, found '0.1'"),
        ("cut_around_ears = 1.0", "wrong.cut_around_ears: expected bool, found 1.0"),
        ("length_map = [1.0, 1.0]", "wrong.length_map: expected tuple"),
        ("parting = true", "wrong.parting: expected float | None, found True"),
        ("length 0.1", "styles.toml: expected a TOML file"),
    ],
)
def test_a_mistake_in_a_file_is_named(line: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message.replace("|", r"\|")):
        styles_of(f"[wrong]\n{line}\n", tmp_path)
