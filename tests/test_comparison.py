"""The evaluation set, drapes that are kept, and the figures that are made of them."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import torch
from safetensors import safe_open

from quaffure import HairMaterial, InputError
from quaffure.baselines import PosedDraper
from quaffure.benchmark import (
    CaseDraper,
    CaseEntry,
    DataFolders,
    DrapeCache,
    EvaluationCase,
    Method,
    compare,
    drape_key,
    draping,
    load_cases,
    load_evaluation_set,
    measure,
)
from quaffure.benchmark.comparison import measure_case, summarize
from quaffure.benchmark.drape_cache import TimedDrape
from quaffure.benchmark.drape_key import draper_key
from quaffure.benchmark.machine_facts import machine
from quaffure.benchmark.metrics import metrics, total_energy
from quaffure.body import CLIP_NAMES, BodyModel, Motion, bundled_clip
from quaffure.drape_motion import drape_motion
from quaffure.draper import Draper
from quaffure.energies import Gravity, HairEnergy, HairState, Loading, SelfCollision, hair_terms, terms_of_design
from quaffure.hair import Groom
from quaffure.model import DirectionNetwork, NetworkConfig, NeuralDraper, build_network
from quaffure.model.quaffure_model import WEIGHTS
from quaffure.procedural import HELD_OUT, STYLES, make_groom
from quaffure.scene import HairScene, Scene
from quaffure.solvers import AdamDraper, DesignSolver, SettledDraper, StrandNewtonDraper, XpbdDraper, XpbdSetting
from quaffure.types import Energy, Float, Positions, Tensor

STRANDS = 40


def tiny_groom(body: BodyModel) -> Groom:
    whole = make_groom("bob", body)
    return replace(whole.select(torch.linspace(0, len(whole) - 1, STRANDS).long()), name="tiny")


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return tiny_groom(body)


@pytest.fixture(scope="module")
def case(groom: Groom, body: BodyModel) -> EvaluationCase:
    return case_of(groom, bundled_clip("bow", body), (40, 41, 42))


def case_of(groom: Groom, clip: Motion, frames: tuple[int, ...], group: str = "seen") -> EvaluationCase:
    motion = replace(clip, body_pose=clip.body_pose[list(frames)])
    return EvaluationCase(f"{groom.name}-{clip.name}", group, "mean", groom, motion, frames, torch.zeros(10))


# ---- the set


@pytest.mark.parametrize(("version", "cases", "frames"), [(2, 41, 88), (3, 98, 144)])
def test_a_set_is_sound(body: BodyModel, version: int, cases: int, frames: int) -> None:
    of = load_evaluation_set(version)
    assert of.version == version
    names = [entry.name for entry in of.cases]
    assert len(set(names)) == len(names) == cases
    assert sum(len(entry.frames) for entry in of.cases) == frames
    assert {entry.loading for entry in of.cases} - {""} == set(of.loadings)
    for loading in of.loadings.values():
        loading.check()
    assert set(of.quick) <= set(names)
    assert {entry.clip for entry in of.cases} <= {*of.motions, *CLIP_NAMES}
    assert {entry.groom for entry in of.cases} == set(of.grooms)
    assert {entry.shape for entry in of.cases} == set(of.shapes)
    assert len({shape for shape in of.shapes.values() if len(shape) == 10}) == 5
    bundled = {name: source for name, source in of.grooms.items() if not source.file}
    assert {name for name, source in bundled.items() if source.group == "unseen"} == set(HELD_OUT)
    assert set(bundled) <= set(STYLES)
    for entry in of.cases:
        assert entry.clip not in CLIP_NAMES or max(entry.frames) < len(bundled_clip(entry.clip, body))


def test_the_quick_cases_need_nothing_but_the_package_and_hold_a_run(body: BodyModel) -> None:
    of = load_evaluation_set()
    nowhere = DataFolders((Path("nowhere"),), (Path("nowhere"),))
    quick = [entry for entry in of.cases if entry.name in of.quick]
    assert all(nowhere.missing(entry, of) is None for entry in quick)
    assert {of.grooms[entry.groom].group for entry in quick} == {"seen", "unseen", "tied"}
    (case,) = (case for case in load_cases(quick[-1:], of, nowhere, body))
    assert case.is_run
    assert len(case.bodies(body).body_pose) == len(case.frames)
    assert torch.equal(case.body_shape, torch.tensor(of.shapes[quick[-1].shape]))


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.parametrize(("version", "length"), [(2, 76), (3, 145)])
def test_the_frames_of_a_set_lie_within_its_motion_files(
    body: BodyModel, shared_data: Path, version: int, length: int
) -> None:
    of = load_evaluation_set(version)
    both = (("motion", "motion_evaluation"), ("grooms", "grooms_evaluation"))
    folders = DataFolders(*(tuple(shared_data / name for name in names) for names in both))
    assert all(folders.missing(entry, of) is None for entry in of.cases)
    last = {entry.clip: max(entry.frames) for entry in sorted(of.cases, key=lambda entry: max(entry.frames))}
    entries = [CaseEntry("bob_fringe", clip, "a", (last[clip],)) for clip in of.motions]
    assert [case.motion.fps for case in load_cases(entries, of, folders, body)] == [30, 30, 30]
    with pytest.raises(InputError, match=f"more than {length} frames"):
        list(load_cases([replace(entries[1], frames=(length,))], of, folders, body))


# ---- drapes, kept


class Counting:
    """The posed groom, draped as often as it is asked."""

    name, material = "counting", HairMaterial()

    def __init__(self, shift: float = 0.0) -> None:
        self.shift = shift
        self._seen: list[Scene] = []

    def drape(self, scene: Scene) -> Positions:
        CALLS.append(len(scene.groom))
        self._seen.append(scene)
        return scene.posed + self.shift


CALLS: list[int] = []


def test_a_run_that_is_killed_goes_on_where_it_was(tmp_path: Path, case: EvaluationCase, body: BodyModel) -> None:
    CALLS.clear()
    row = Method("counting", Counting())
    first = CaseDraper(body, DrapeCache(tmp_path))
    made = first.drape(row, case, 0)
    # One drape of a few strands to warm up, the drape itself, and its repetitions for the clock.
    assert [8, *[STRANDS] * (1 + draping.REPEATS)] == CALLS
    with (
        mock.patch.object(Counting, "drape", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        first.drape(row, case, 1)
    again = CaseDraper(body, DrapeCache(tmp_path))
    CALLS.clear()
    fetched = again.drape(row, case, 0)
    assert CALLS == []
    torch.testing.assert_close(fetched.strands, made.strands, rtol=0, atol=0)
    assert (fetched.milliseconds, fetched.machine) == (made.milliseconds, machine())
    assert again.known(row, case, 1) is None
    again.drape(row, case, 1)
    assert (again.made, again.fetched) == (1, 1)
    notes = [str(np.load(path)["made"]) for path in tmp_path.glob("*.npz")]
    assert sorted(notes) == ["tiny-bow, frame 40, counting", "tiny-bow, frame 41, counting"]


def test_two_runs_on_one_folder_lose_nothing(tmp_path: Path, case: EvaluationCase, body: BodyModel) -> None:
    row = Method("counting", Counting())
    both = [CaseDraper(body, DrapeCache(tmp_path)) for _ in range(2)]
    for frame, one in enumerate(both):
        one.drape(row, case, frame)
    late = CaseDraper(body, DrapeCache(tmp_path))
    assert late.known(row, case, 0) is not None
    assert late.known(row, case, 1) is not None
    assert both[0].known(row, case, 1) is not None


def test_a_drape_that_is_half_written_is_none(tmp_path: Path) -> None:
    drape = TimedDrape(torch.zeros(2, 3, 3), None, "a machine")
    cache = DrapeCache(tmp_path)
    with (
        mock.patch("quaffure.benchmark.drape_cache.np.savez", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        cache.put("key", drape, "case", 0, "posed")
    assert list(tmp_path.iterdir()) == []
    assert cache.get("key") is None
    cache.put("key", drape, "case", 0, "posed")
    kept = cache.get("key")
    assert (kept.milliseconds, kept.machine) == (None, "a machine")


def test_slow_drapes_are_timed_by_the_run_that_makes_them(
    tmp_path: Path, case: EvaluationCase, body: BodyModel
) -> None:
    CALLS.clear()
    with mock.patch.object(draping, "SLOW_SECONDS", 0.0):
        CaseDraper(body, DrapeCache(tmp_path)).drape(Method("counting", Counting()), case, 0)
    assert CALLS == [8, STRANDS]


def test_whatever_decides_a_drape_is_in_its_key(tmp_path: Path, case: EvaluationCase, body: BodyModel) -> None:
    draper = CaseDraper(body, DrapeCache(tmp_path))
    draper.drape(Method("counting", Counting()), case, 0)

    def known(row: Method = Method("counting", Counting()), of: EvaluationCase = case) -> bool:  # noqa: B008
        return CaseDraper(body, draper.cache).known(row, of, 0) is not None

    def moved(by: float, strands: slice = slice(None)) -> EvaluationCase:
        rest_strands = case.groom.rest_strands.clone()
        rest_strands[strands] += by
        return replace(case, groom=replace(case.groom, rest_strands=rest_strands))

    assert known()
    assert known(of=moved(1e-6))
    assert known(of=replace(case, name="another", frames=(7, 8, 9)))
    assert not known(Method("counting", Counting(shift=1e-6)))
    assert not known(of=moved(1e-4))
    assert not known(of=moved(1e-4, slice(7, 8)))
    assert not known(of=replace(case, groom=replace(case.groom, root_uv=case.groom.root_uv + 1e-2)))
    assert not known(of=replace(case, groom=case.groom.select(torch.arange(STRANDS - 1))))
    for part, value in {"stiffness_scale": 1.0, "goal_weight": 1e-5, "tie_vertex": 3}.items():
        shape = (STRANDS,) if part == "tie_vertex" else (STRANDS, case.groom.rest_strands.shape[1] - 1)
        held = replace(case.groom, **{part: torch.full(shape, value)})
        assert not known(of=replace(case, groom=held))
        key = draper.cache.groom_key(held)
        assert draper.cache.groom_key(replace(held, name="another")) == key
        assert draper.cache.groom_key(replace(held, **{part: torch.full(shape, 2 * value)})) != key
    assert not known(of=replace(case, body_shape=case.body_shape + 1e-6))
    assert not known(of=replace(case, motion=replace(case.motion, body_pose=case.motion.body_pose + 1e-6)))


def test_weights_settings_and_material_are_in_the_key_of_a_draper() -> None:
    torch.manual_seed(0)
    network = build_network(NetworkConfig(texel_channels=4, strand_width=8))
    draper = NeuralDraper(network, HairMaterial())
    before = draper_key(draper)
    assert draper_key(draper) == before
    assert draper_key(NeuralDraper(network, HairMaterial(k_cosserat=1e-7))) != before
    settled = draper_key(SettledDraper(draper, StrandNewtonDraper(), 3))
    with torch.no_grad():
        next(network.parameters())[0] += 1e-3
    assert draper_key(draper) != before
    assert draper_key(SettledDraper(draper, StrandNewtonDraper(), 3)) != settled
    keys = {
        draper_key(AdamDraper()),
        draper_key(AdamDraper(steps=301)),
        draper_key(AdamDraper(HairMaterial(k_cosserat=1e-7))),
        draper_key(XpbdDraper()),
        draper_key(XpbdDraper(setting=XpbdSetting(steps=7))),
        draper_key(PosedDraper()),
        draper_key(AdamDraper(terms=(Gravity(),))),
        draper_key(AdamDraper(terms=(SelfCollision(),))),
        draper_key(XpbdDraper(terms=hair_terms("rod"))),
        draper_key(StrandNewtonDraper()),
        draper_key(StrandNewtonDraper(terms=hair_terms("rod"))),
        draper_key(StrandNewtonDraper(terms=hair_terms("rod", stiffness=2.0))),
    }
    assert len(keys) == 12


def test_a_draper_that_starts_from_another_knows_the_loadings_that_both_know(groom: Groom, body: BodyModel) -> None:
    soft = Loading(stiffness=0.5)

    def drapes(draper: Draper) -> bool:
        return Method("row", draper).drapes(groom, body, soft)

    newton = StrandNewtonDraper()
    of_directions, of_displacements = (
        NeuralDraper(build_network(NetworkConfig(output=output, texel_channels=4, strand_width=8)), HairMaterial())
        for output in ("directions", "displacement")
    )
    assert drapes(newton)
    assert drapes(SettledDraper(of_directions, newton, 3))
    assert not drapes(SettledDraper(of_displacements, newton, 3))
    assert drapes(SettledDraper(PosedDraper(), newton, 3))
    assert drapes(DesignSolver("lbfgs", HairMaterial(), start=of_directions))
    assert not drapes(DesignSolver("lbfgs", HairMaterial(), start=of_displacements))


class _Shifted(DirectionNetwork):
    def forward(self, *inputs: Any) -> Float[Tensor, "b s e 3"]:
        return super().forward(*inputs) + 0.5


class _Moon(Gravity):
    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        return super().energy(hair, scene) / 6


def test_code_and_layers_of_a_user_are_in_the_key_of_a_draper() -> None:
    config = NetworkConfig(texel_channels=4, strand_width=8)
    networks = []
    for kind in (DirectionNetwork, DirectionNetwork, DirectionNetwork, _Shifted):
        torch.manual_seed(0)
        networks.append(kind(config))
    networks[2].strand[0] = torch.nn.Tanh()
    same, again, other_layer, other_forward = (draper_key(NeuralDraper(each, HairMaterial())) for each in networks)
    assert same == again
    assert len({same, other_layer, other_forward}) == 3
    assert draper_key(AdamDraper(terms=(Gravity(),))) != draper_key(AdamDraper(terms=(_Moon(),)))


def test_a_renamed_class_or_file_keeps_its_drapes_and_another_version_does_not(
    tmp_path: Path, case: EvaluationCase, body: BodyModel
) -> None:
    draper = CaseDraper(body, DrapeCache(tmp_path))
    draper.drape(Method("counting", Counting()), case, 0)

    class Renamed(Counting):
        __module__ = "quaffure.elsewhere"

    known = CaseDraper(body, draper.cache).known
    assert known(Method("counting", Renamed()), case, 0) is not None
    with mock.patch.object(Renamed, "name", "another"):
        assert CaseDraper(body, draper.cache).known(Method("counting", Renamed()), case, 0) is None
    with mock.patch.object(drape_key, "DRAPE_VERSION", drape_key.DRAPE_VERSION + 1):
        assert known(Method("counting", Counting()), case, 0) is None


def test_a_damaged_drape_is_made_again(tmp_path: Path, case: EvaluationCase, body: BodyModel) -> None:
    row = Method("counting", Counting())
    CaseDraper(body, DrapeCache(tmp_path)).drape(row, case, 0)
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(file.read_bytes()[:40])
    again = CaseDraper(body, DrapeCache(tmp_path))
    again.drape(row, case, 0)
    assert (again.made, again.fetched) == (1, 0)
    assert again.known(row, case, 0) is not None


def test_a_drape_of_nan_is_refused(tmp_path: Path, case: EvaluationCase, body: BodyModel) -> None:
    with pytest.raises(InputError, match="counting: expected finite vertices in tiny-bow"):
        CaseDraper(body, DrapeCache(tmp_path)).drape(Method("counting", Counting(float("nan"))), case, 0)
    assert not list(tmp_path.glob("*.npz"))


# ---- figures


def lifted(
    body: BodyModel, heights: dict[int, float], wave: float = 0.0
) -> Callable[[EvaluationCase, int], TimedDrape]:
    """The posed groom with its loose vertices lifted by so much [m] in each frame of a case."""

    def drape(case: EvaluationCase, frame: int) -> TimedDrape:
        hair = Scene(case.groom, case.bodies(body, frame)).posed[0].clone()
        hair[:, 1:, 2] += heights[frame]
        hair[:, 1:, 0] += wave * (-1) ** frame
        return TimedDrape(hair, 10.0 * (frame + 1), "a machine")

    return drape


def test_the_reference_is_the_lowest_solver_of_each_frame(case: EvaluationCase, body: BodyModel) -> None:
    # Upright on the mean body the design is the minimum, and a lift costs energy.
    upright = replace(case.motion, body_pose=torch.zeros(3, 81))
    still = replace(case, motion=upright, body_shape=torch.zeros(10))
    rows = {
        "first": lifted(body, {0: 0.0, 1: 0.004, 2: 0.0}),
        "second": lifted(body, {0: 0.002, 1: 0.002, 2: 0.002}, wave=1e-4),
        "network": lifted(body, {0: 0.0, 1: 0.001, 2: 0.001}, wave=3e-4),
    }
    material = HairMaterial()
    (result,) = compare([still], rows, ("first", "second"), body, material)
    assert result.reference == ("first", "second", "first")
    figures = result.metrics
    assert figures["first"]["excess_energy"][0] == 0
    assert figures["first"]["excess_energy"][1] > 0
    assert figures["network"]["excess_energy"][1] < 0  # a row that is no solver may be lower than all of them
    free = 23 / 24
    assert figures["first"]["distance_mm"][1] == pytest.approx(free * 1e3 * np.hypot(2e-3, 1e-4), rel=1e-3)
    # `first` moves by 4 mm up and down, `second` by 0.2 mm to and fro: second differences over those of the lowest.
    best = "first" if np.mean(figures["first"]["energy"]) < np.mean(figures["second"]["energy"]) else "second"
    assert figures[best]["jitter"] == [1]
    assert figures["first"]["jitter"][0] / figures["second"]["jitter"][0] == pytest.approx(8e-3 / 4e-4, rel=1e-3)
    energy = HairEnergy(still.groom, material, terms_of_design(still.groom, body, material))
    scene = Scene(still.groom, still.bodies(body, 0))
    expected = metrics(rows["network"](still, 0).strands[None], scene, energy)
    assert {key: figures["network"][key][0] for key in expected} == pytest.approx(
        {key: float(value) for key, value in expected.items()}, rel=1e-5, abs=1e-6
    )


def test_each_frame_of_a_case_is_posed_once_for_all_rows(case: EvaluationCase, body: BodyModel) -> None:
    drapes = {
        name: [lifted(body, dict.fromkeys(range(3), 0.0))(case, frame) for frame in range(3)]
        for name in ("a", "b", "c")
    }
    with mock.patch.object(BodyModel, "skin", autospec=True, side_effect=BodyModel.skin) as skin:
        measure_case(case, drapes, ["a", "b"], body, HairMaterial())
    assert skin.call_count == len(case.frames)


def test_without_solvers_there_is_no_reference_and_isolated_frames_do_not_tremble(
    case: EvaluationCase, body: BodyModel
) -> None:
    flat = dict.fromkeys(range(3), 0.0)
    (alone,) = compare([case], {"network": lifted(body, flat)}, (), body, HairMaterial())
    assert alone.reference == ()
    assert not {"excess_energy", "distance_mm", "jitter"} & set(alone.metrics["network"])
    apart = replace(case, frames=(10, 20, 30))
    (isolated,) = compare([apart], {"xpbd": lifted(body, flat)}, ("xpbd",), body, HairMaterial())
    assert isolated.reference == ("xpbd",) * 3
    assert "jitter" not in isolated.metrics["xpbd"]
    (without,) = compare([case], {"none": lambda case, frame: None}, (), body, HairMaterial())
    assert without.metrics == {}


def test_hair_that_does_not_move_has_no_jitter(case: EvaluationCase, body: BodyModel) -> None:
    still = replace(case, motion=replace(case.motion, body_pose=case.motion.body_pose[:1].expand(3, -1)))
    flat = dict.fromkeys(range(3), 0.0)
    rows = {"xpbd": lifted(body, flat), "network": lifted(body, flat, wave=1e-3)}
    (result,) = compare([still], rows, ("xpbd",), body, HairMaterial())
    assert result.reference == ("xpbd",) * 3
    for figures in result.metrics.values():
        assert "distance_mm" in figures
        assert "jitter" not in figures
    assert "jitter" not in summarize([result])["all"]["network"]
    sequence = drape_motion(PosedDraper(), case.groom, body, still.motion, still.body_shape)
    sequence = replace(sequence, strands=sequence.strands[:1].repeat(3, axis=0))
    trembling = replace(sequence, strands=sequence.strands + 1e-3 * np.float32([0, 1, 0])[:, None, None, None])
    assert "jitter" not in measure(trembling, case.groom, body, reference=sequence)[0]
    assert "jitter" in measure(sequence, case.groom, body, reference=trembling)[0]


def test_a_run_weighs_no_more_than_a_frame(case: EvaluationCase, body: BodyModel) -> None:
    single = replace(case, name="single", group="unseen", frames=(40,))
    rows = {"posed": lifted(body, dict.fromkeys(range(3), 0.0))}
    results = compare([case, single], rows, (), body, HairMaterial())
    summary = summarize(results)
    assert list(summary) == ["all", "free", "seen", "unseen", "clip bow"]
    energies = [result.metrics["posed"]["energy"] for result in results]
    assert summary["all"]["posed"]["energy"]["mean"] == pytest.approx(np.mean([np.mean(e) for e in energies]))
    assert summary["all"]["posed"]["energy"]["worst"] == max(energies[0] + energies[1])
    assert summary["unseen"]["posed"]["energy"] == {"mean": energies[1][0], "worst": energies[1][0]}
    assert summary["all"]["posed"]["milliseconds"] == {"median": 15.0, "worst": 30.0}
    assert summarize([results[0], replace(results[1], metrics={})])["all"] == {}


def test_settling_lowers_the_energy_and_keeps_lengths(case: EvaluationCase, body: BodyModel) -> None:
    torch.manual_seed(0)
    network = NeuralDraper(build_network(NetworkConfig(texel_channels=4, strand_width=8)), HairMaterial())
    scene, newton = Scene(case.groom, case.bodies(body, 0)), StrandNewtonDraper()
    draped, settled = network.drape(scene), SettledDraper(network, newton, 3).drape(scene)
    energy = newton.energy_of(scene)
    assert float(total_energy(settled, scene, energy)) < float(total_energy(draped, scene, energy)) - 1e-4
    lengths = settled.diff(dim=2).norm(dim=-1)
    torch.testing.assert_close(lengths[0], case.groom.rest_lengths, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(settled[:, :, 0], scene.posed[:, :, 0])


def test_a_material_has_the_fields_that_files_of_earlier_versions_name() -> None:
    """Runs are resumed, and drapes scored, only if their materials are the same: a field more would refuse them all."""
    with safe_open(WEIGHTS, "pt") as file:
        assert json.loads(file.metadata()["material"]).keys() == asdict(HairMaterial()).keys()
