"""Numbers in text that Python or a float do not hold: each is refused in one line, in files and in options."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from quaffure import InputError
from quaffure.apps.cli.style_settings import with_settings
from quaffure.body import bundled_clip, load_body
from quaffure.body.joint_names import _side_and_stem
from quaffure.drape_motion import material_of
from quaffure.io import read_joint_map
from quaffure.io.read_strands import read_strands
from quaffure.model import load_groom_autoencoder
from quaffure.procedural import STYLES, read_styles
from quaffure.training import RunFolder
from quaffure.training.distributed import joined_workers
from tests.synthetic_drape import drape, patch_of_strands

DIGITS = "9" * 5000
"""More than Python converts to a number, or from one."""
BEYOND_FLOAT = "9" * 400


def refused_widths(folder: Path) -> object:
    save_file({"weight": torch.zeros(1)}, folder / "own.safetensors", {"widths": f"{DIGITS},1,1,1"})
    return load_groom_autoencoder(folder / "own.safetensors")


def refused_ply(folder: Path) -> object:
    (folder / "own.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex {DIGITS}\nend_header\n")
    return read_strands(folder / "own.ply")


def refused_joint_map(number: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "own.toml").write_text(f'Head = ["a", "b", {number}]\n')
        return read_joint_map(folder / "own.toml")

    return read


def refused_styles(text: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "own.toml").write_text(text)
        return read_styles(folder / "own.toml")

    return read


def refused_meta(folder: Path) -> object:
    sequence = drape(patch_of_strands((0.0, 1.0, 0.0)))
    sequence.meta["material"] = {"k_stretch": int(BEYOND_FLOAT)}
    return material_of(sequence)


def refused_table(folder: Path) -> None:
    run = RunFolder(folder)
    (folder / "training.csv").write_text(f"step,loss\n1,{DIGITS * 50}\n")
    run.rewind_logs(3)


def refused_environment(folder: Path) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WORLD_SIZE", DIGITS)
        with joined_workers("cpu"):
            pass


NUMBERS_BEYOND: dict[str, tuple[Callable[[Path], object], str]] = {
    "widths of weights": (refused_widths, "four widths of a groom decoder"),
    "rows of a .ply": (refused_ply, "element and property lines"),
    "decimals in a joint map": (refused_joint_map(DIGITS), "a joint map"),
    "hexadecimals in a joint map": (refused_joint_map(f"0x{DIGITS}"), "a joint map"),
    "decimals in styles": (refused_styles(f"[a]\nroot_rows = {DIGITS}\n"), "a TOML file"),
    "hexadecimals in styles": (refused_styles(f"[a]\nlength = 0x{DIGITS}\n"), "a TOML file|length"),
    "nested styles": (refused_styles("a = " + "[" * 100_000), "a TOML file"),
    "styles that are no tables": (refused_styles("a = 1\n"), "a table of controls"),
    "material of a drape": (refused_meta, "material of its hair"),
    "a long word in a log": (refused_table, "a table of a training"),
    "frames": (lambda _: bundled_clip("nod", load_body()).frames(f"{DIGITS}:"), "whole numbers"),
    "a control": (lambda _: with_settings(STYLES["bob"], (f"root_rows={BEYOND_FLOAT}",)), "within"),
    "a part of a control": (lambda _: with_settings(STYLES["ponytail"], (f"ties.{DIGITS}.x=1",)), "ties.0.CONTROL"),
    "the environment": (refused_environment, "a whole number from 1"),
}


@pytest.mark.parametrize(("read", "expected"), NUMBERS_BEYOND.values(), ids=NUMBERS_BEYOND.keys())
def test_numbers_that_python_does_not_convert(read: Callable[[Path], object], expected: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=expected) as caught:
        read(tmp_path)
    assert len(str(caught.value).replace(BEYOND_FLOAT, "").replace(DIGITS, "")) < 1000


def test_joints_may_be_named_by_thousands_of_digits() -> None:
    assert _side_and_stem(f"left_arm_{DIGITS}")[0] == "Left"
    assert _side_and_stem("spine_007") == _side_and_stem("spine_7")


def test_a_log_with_steps_of_thousands_of_digits_goes_back(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    (tmp_path / "training.csv").write_text(f"step,loss\n1,2\n{DIGITS},2\n\u00b2,2\n")
    run.rewind_logs(3)
    assert (tmp_path / "training.csv").read_text().split() == ["step,loss", "1,2"]
