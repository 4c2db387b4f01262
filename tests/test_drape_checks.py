"""Faults that `quaffure drape` names, and metrics on request alone."""

import json
from pathlib import Path

import pytest
import torch

from quaffure import HairMaterial
from quaffure.apps.cli import drape as drape_cli
from quaffure.apps.cli.main import main
from quaffure.benchmark import DrapeMetrics
from quaffure.benchmark.drape_checks import MOST_INSIDE_PERCENT, DrapeChecks, frames_named
from quaffure.body import BodyModel
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Positions
from tests.training_runs import tiny_groom

FRAMES = 5


@pytest.fixture(scope="module")
def scene(body: BodyModel) -> Scene:
    return Scene(tiny_groom(body), BodyBatch(body, torch.zeros(FRAMES, 81), torch.zeros(FRAMES, 10)))


def faulty(scene: Scene) -> Positions:
    """Hair far above the head; the tips of frame 2 are displaced, and of frame 4 seven strands are inside the head."""
    draped = scene.posed.clone()
    draped[..., 1] += 1.0
    draped[2, :3, -1, 0] += 0.2
    centre = scene.surface.vertices[0].mean(dim=0)
    draped[4, :7, 1:] = centre + 1e-3 * torch.rand(7, 23, 3)
    return draped


def checked(draped: Positions, scene: Scene, batches: tuple[int, ...] = (3, 2)) -> DrapeChecks:
    checks, start = DrapeChecks(30.0), 0
    for count in batches:
        rows = slice(start, start + count)
        part = BodyBatch(scene.bodies.body, scene.bodies.body_pose[rows], scene.bodies.body_shape[rows])
        checks.add(draped[rows], Scene(scene.groom, part))
        start += count
    return checks


def test_checks_are_the_metrics_of_the_same_names(scene: Scene) -> None:
    draped = faulty(scene)
    checks, measured = checked(draped, scene), DrapeMetrics(scene.groom, HairMaterial())
    measured.add(draped, scene)
    metrics = measured.of_all_frames()[0]
    assert checks.inside_percent == metrics["body_intersection_percent"].tolist()
    assert checks.jumping_tips == metrics["jumps"].tolist()
    assert checks.inside_percent[4] == pytest.approx(100 * 7 / 40)
    assert checks.jumping_tips == [0, 0, 3, 3, 7]


def test_faults_are_named_with_their_frames(scene: Scene) -> None:
    draped = faulty(scene)
    assert checked(draped, scene).findings() == ["frames 2-4: 13 tips jump", "frame 4: 18 % inside"]
    draped[2:] = draped[1]
    assert checked(draped, scene).findings() == []
    assert 0 < MOST_INSIDE_PERCENT < 1


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        ([7], "frame 7"),
        ([35, 38], "frames 35, 38"),
        ([0, 1, 2, 5], "frames 0-2, 5"),
        (list(range(0, 20, 2)), "frames 0, 2, 4, 6, 8, 10, ... (10 in all)"),
    ],
)
def test_frames_are_named_in_ranges(frames: list[int], text: str) -> None:
    assert frames_named(frames) == text


def drape(groom: Path | str, out: Path, *options: str) -> list[str]:
    """Posed hair in a nod, in which long hair is inside the back."""
    return [
        "drape",
        str(groom),
        "--draper",
        "posed",
        "--motion",
        "nod",
        "--frames",
        "8:12",
        *options,
        "--out",
        str(out),
    ]


def test_nothing_is_measured_unasked(
    tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def measured(*arguments: object) -> None:
        raise AssertionError("measured")

    monkeypatch.setattr(drape_cli, "DrapeMetrics", measured)
    out = tmp_path / "hair.npz"
    main(drape(tiny_groom_file, out))
    printed = capfd.readouterr().out
    assert out.is_file()
    assert "checked: " in printed
    assert "%" in printed
    assert "excess" not in printed
    main(drape(tiny_groom_file, out, "--json"))
    report = json.loads(capfd.readouterr().out)
    assert "per_frame" not in report
    assert len(report["inside_percent"]) == len(report["jumps"]) == 4
    for option in (["--metrics"], ["--reference", str(out)]):
        with pytest.raises(AssertionError, match="measured"):
            main(drape(tiny_groom_file, tmp_path / "other.npz", *option))


def test_strict_makes_faults_exit_code_3_and_writes(tiny_groom_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "hair.npz"
    with pytest.raises(SystemExit) as stop:
        main(drape("long_straight", out, "--strict"))
    assert stop.value.code == 3
    assert out.is_file()
    main(drape("long_straight", out))
    main(drape(tiny_groom_file, out, "--strict"))  # short hair is outside
