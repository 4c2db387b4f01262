"""The live page: its state without a browser, then the page itself in Chromium where there is one."""

import io
import queue
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from PIL import Image

from quaffure import HairMaterial, InputError
from quaffure.apps.cli.main import main
from quaffure.apps.viewer.catalogue import REST, Catalogue
from quaffure.apps.viewer.draping_thread import DrapingThread
from quaffure.apps.viewer.hair_colours import INSIDE, hair_colours, segments
from quaffure.apps.viewer.hair_drawing import ALL_STRANDS, Display, HairDrawing
from quaffure.apps.viewer.page import Page, check_address
from quaffure.apps.viewer.panel import put
from quaffure.apps.viewer.playback import Playback
from quaffure.apps.viewer.session import MOST_DRAPES, free_path
from quaffure.apps.viewer.settings import AUTOMATIC, GUIDES, Settings
from quaffure.apps.viewer.view_state import Degrees, ViewState
from quaffure.baselines import PosedDraper
from quaffure.body import CLIP_FPS, CLIP_NAMES, bundled_clip, joint_matrices
from quaffure.body.pose_features import HEAD
from quaffure.drapers import LIVE_DRAPERS
from quaffure.energies import Loading
from quaffure.hair import DrapeSequence, Groom, GuideInterpolation
from quaffure.io import read_drape
from quaffure.model import Quaffure, load_model
from quaffure.procedural import STYLES, make_groom
from quaffure.scene import Scene
from quaffure.solvers import SOLVERS, CoherentDraper
from quaffure.types import Positions

if TYPE_CHECKING:
    from playwright.sync_api import Page as Tab

SECONDS = 60.0  # no test takes that long; one that hangs ends
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    *("--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--use-angle=gl-egl", "--ignore-gpu-blocklist"),
]
WIDTH, HEIGHT, PANEL_WIDTH = 640, 360, 330
MOST_GROWTH = 1e5
"""Growth of the memory of a tab by an interaction, in the mean of the later half of them [bytes]."""


@pytest.fixture(scope="module")
def model() -> Quaffure:
    return load_model()


def thinned(style: str, model: Quaffure) -> Groom:
    """Every eighth strand: enough to colour a picture, and few enough for a browser without a GPU."""
    whole = make_groom(style, model.body)
    return whole.select(torch.arange(0, len(whole), 8))


@pytest.fixture(scope="module")
def groom(model: Quaffure) -> Groom:
    return replace(thinned("long_straight", model), name="thinned")


@pytest.fixture(scope="module")
def catalogue(model: Quaffure, groom: Groom) -> Catalogue:
    made = Catalogue(model, groom)
    made._grooms["crew_cut"] = thinned("crew_cut", model)
    return made


@pytest.fixture(scope="module")
def state(catalogue: Catalogue) -> ViewState:
    return ViewState(catalogue.body, catalogue.groom("thinned"), catalogue.motion("nod"), catalogue.draper("neural"))


NOSE, CROWN = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)
"""Where they point at rest, seen from the head."""


def pointing(state: ViewState, part: tuple[float, float, float] = NOSE) -> torch.Tensor:
    """Where the nose or the crown points."""
    shape = torch.tensor(state.body_shape)[None]
    rotations, _ = state.body.posed_joints(state.body_pose(), shape)
    return rotations[0, state.body.joint_names.index(HEAD)] @ torch.tensor(part)


def test_without_turns_the_pose_is_the_clips(state: ViewState) -> None:
    assert torch.equal(state.at(7).body_pose()[0], state.motion.body_pose[7])


@pytest.mark.parametrize(
    ("degrees", "nose", "crown"),
    [
        ((0.0, 0.0, 90.0), (1.0, 0.0, 0.0), CROWN),
        ((90.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
        ((0.0, 90.0, 0.0), NOSE, (1.0, 0.0, 0.0)),
    ],
    ids=["turn left", "bend forward", "lean left"],
)
def test_turns_go_the_way_the_sliders_say(
    state: ViewState, catalogue: Catalogue, degrees: Degrees, nose: Degrees, crown: Degrees
) -> None:
    turned = state.playing(catalogue.motion(REST)).rotated(HEAD, degrees)
    torch.testing.assert_close(pointing(turned), torch.tensor(nose), atol=1e-5, rtol=0)
    torch.testing.assert_close(pointing(turned, CROWN), torch.tensor(crown), atol=1e-5, rtol=0)


def test_turns_come_on_top_of_the_clip(state: ViewState, catalogue: Catalogue) -> None:
    """The neck turns left in the clip; the head turns back by hand, and the other joints stay."""
    looking_left = state.playing(catalogue.motion("neck_turn")).at(60)
    back = looking_left.rotated(HEAD, (0.0, 0.0, -70.0))
    assert pointing(looking_left)[0] > 0.9
    torch.testing.assert_close(pointing(back), torch.tensor(NOSE), atol=1e-4, rtol=0)
    changed = (back.body_pose() != looking_left.body_pose()).unflatten(1, (27, 3)).any(-1)[0]
    assert changed.nonzero().flatten().tolist() == [state.body.joint_names.index(HEAD)]
    assert torch.equal(back.rotated(HEAD, (0.0, 0.0, 0.0)).body_pose(), looking_left.body_pose())


def test_a_turn_by_hand_carries_the_clips_own_turn_round(state: ViewState) -> None:
    """A head that nods down and is turned left looks down to the left: the clip turns first."""
    nodding = state.at(25)
    head = state.body.joint_names.index(HEAD)
    local = [joint_matrices(s.body_pose())[0, head] for s in (nodding, nodding.rotated(HEAD, (0.0, 0.0, 90.0)))]
    before, after = (rotation @ torch.tensor([0.0, -1.0, 0.0], dtype=rotation.dtype) for rotation in local)
    assert before[2] < -0.1
    torch.testing.assert_close(after, torch.stack([-before[1], before[0], before[2]]), atol=1e-5, rtol=0)


def test_frames_go_round_and_clips_start_again(state: ViewState, catalogue: Catalogue) -> None:
    frames = len(state.motion)
    assert state.at(frames + 3).frame == 3
    assert state.at(5).playing(catalogue.motion(REST)).frame == 0


def test_a_stage_that_cannot_be_is_refused(state: ViewState) -> None:
    with pytest.raises(InputError, match="found 90"):
        replace(state, frame=len(state.motion))
    with pytest.raises(InputError, match="'Tail'"):
        state.rotated("Tail", (1.0, 0.0, 0.0))
    with pytest.raises(InputError, match="found 3"):
        replace(state, body_shape=(0.0,) * 3)


def test_a_stage_drapes_as_the_model_does(state: ViewState, model: Quaffure) -> None:
    shaped = state.at(20).shaped(0, 1.5).rotated("Neck", (10.0, 0.0, 0.0))
    drape = shaped.drape()
    shape = torch.tensor([[1.5, *[0.0] * 9]])
    expected = model.drape(state.groom, shaped.body_pose(), shape)[0].numpy()
    np.testing.assert_allclose(drape.strands, expected, atol=1e-6)
    np.testing.assert_allclose(drape.body_vertices, model.body.pose(shaped.body_pose(), shape).vertices[0], atol=1e-6)
    assert drape.network_milliseconds is not None
    assert 0 < drape.network_milliseconds < drape.milliseconds
    assert not model.draper.network._forward_hooks
    assert drape.sequence.meta["frame"] == 20


def test_posed_hair_has_no_network_and_its_own_metrics(state: ViewState, catalogue: Catalogue) -> None:
    drape = replace(state, draper=catalogue.draper("posed")).drape()
    assert drape.network_milliseconds is None
    draped, posed = drape.metrics()
    assert draped == posed
    assert draped["length_error_percent"] < 1e-2


def test_inside_agrees_with_the_metrics(state: ViewState, catalogue: Catalogue) -> None:
    """Long hair posed on a head that looks far up goes through the back."""
    drape = replace(state, draper=PosedDraper()).rotated("Neck", (-45.0, 0.0, 0.0)).drape()
    inside = drape.inside(drape.strands)
    assert not inside[:, 0].any()
    percent = drape.metrics()[0]["body_intersection_percent"]
    assert percent > 1
    assert 100 * inside[:, 1:].mean() == pytest.approx(percent, abs=1e-3)


def test_the_catalogue_offers_everything_bundled_and_the_users_own(model: Quaffure, groom: Groom) -> None:
    clip = replace(bundled_clip("bow", model.body), name="nod")
    catalogue = Catalogue(model, replace(groom, name="bob"), clip)
    assert catalogue.groom_names == ("bob (file)", *STYLES)
    assert catalogue.motion_names == ("nod (file)", REST, *CLIP_NAMES)
    assert set(catalogue.draper_names) == {"neural", *SOLVERS}
    assert catalogue.draper_names[: len(LIVE_DRAPERS)] == LIVE_DRAPERS
    assert catalogue.motion("nod (file)") is clip
    assert catalogue.groom("bob (file)").name == "bob"
    assert catalogue.draper("adam").material == catalogue.draper("neural").material
    with pytest.raises(InputError, match="one of"):
        catalogue.groom("wig")


def test_interpolated_strands_are_kept_for_one_groom_and_count(catalogue: Catalogue, groom: Groom) -> None:
    once = catalogue.interpolation(groom, 50)
    assert len(once) == 50
    assert catalogue.interpolation(groom, 50) is once
    assert len(catalogue.interpolation(groom, 60)) == 60


def finishes(thread: DrapingThread) -> bool:
    """Whether all jobs requested so far end in time."""
    done = threading.Event()
    thread.request("last", done.set)
    return done.wait(SECONDS)


def test_the_draping_thread_forgets_what_is_stale_and_survives_errors() -> None:
    done: list[str] = []
    errors: list[Exception] = []
    thread = DrapingThread(errors.append)
    gate = threading.Event()
    thread.request("first", lambda: (gate.wait(SECONDS), done.append("first"))[-1])
    for number in range(5):
        thread.request("drag", lambda number=number: done.append(f"drag {number}"))  # type: ignore[misc]
        thread.request("broken", lambda: [][1])
    gate.set()
    assert finishes(thread)
    assert done == ["first", "drag 4"]
    assert [type(error) for error in errors] == [IndexError]
    thread.request("after", lambda: done.append("after"))
    assert finishes(thread)
    assert done[-1] == "after"
    thread.stop()


def test_the_draping_thread_survives_an_error_that_cannot_be_reported(capfd: pytest.CaptureFixture[str]) -> None:
    done: list[str] = []

    def failing_report(error: Exception) -> None:
        raise ConnectionError("no browser")

    thread = DrapingThread(failing_report)
    thread.request("broken", lambda: [][1])
    assert finishes(thread)
    thread.request("after", lambda: done.append("after"))
    assert finishes(thread)
    assert done == ["after"]
    assert "no browser" in capfd.readouterr().err
    thread.stop()


def test_a_change_is_made_before_the_drape_that_shows_it() -> None:
    """A drape waits already when the change comes; it must not be taken for the one after the change."""
    done: list[str] = []
    thread = DrapingThread(lambda error: None)
    gate = threading.Event()
    thread.request("hold", lambda: gate.wait(SECONDS) and None)
    for kind in ("drape", "frame", "drape"):
        thread.request(kind, lambda kind=kind: done.append(kind))  # type: ignore[misc]
    gate.set()
    assert finishes(thread)
    assert done == ["frame", "drape"]
    thread.stop()


def test_playback_goes_on_from_where_it_was_put() -> None:
    frames: queue.Queue[int] = queue.Queue()
    playback = Playback(frames.put)
    playback.seek(40)
    assert frames.empty()
    playback.play()
    seen = [frames.get(timeout=SECONDS) for _ in range(4)]
    playback.pause()
    playback.stop()
    assert seen[0] >= 40
    assert seen == sorted(seen)
    assert seen[-1] > 40


class SeekBetween(float):
    """A speed that, when the clock asks for it, lets another thread seek first, or try to."""

    playback: Playback

    def __rmul__(self, other: float) -> float:
        other_thread = threading.Thread(target=self.playback.seek, args=(1000,))
        self.playback.speed = 1.0
        other_thread.start()
        other_thread.join(0.2)
        return float.__rmul__(self, other)


def test_a_seek_while_the_clock_ticks_is_not_lost() -> None:
    frames: queue.Queue[int] = queue.Queue()
    playback = Playback(frames.put)
    playback.speed = between = SeekBetween(1.0)
    between.playback = playback
    playback.play()
    seen = [frames.get(timeout=SECONDS) for _ in range(3)]
    playback.stop()
    assert seen[-1] >= 1000


def test_hair_across_the_light_is_brighter_than_hair_along_it() -> None:
    key = np.array((-0.5, -0.7, 0.75), np.float32)
    across = np.cross(key, (0.0, 0.0, 1.0))
    steps = np.linspace(0, 0.2, 24, dtype=np.float32)[:, None]
    strands = np.stack([steps * key, steps * across / np.linalg.norm(across)]).astype(np.float32)
    along, crosswise = hair_colours(strands)[:, 12].astype(int)
    assert crosswise.sum() > 1.5 * along.sum()
    assert crosswise[0] > crosswise[1] > crosswise[2]


def test_vertices_inside_are_marked_and_others_are_pale() -> None:
    strands = np.random.default_rng(0).standard_normal((5, 6, 3)).astype(np.float32)
    inside = np.zeros((5, 6), bool)
    inside[2, 3] = True
    marked, plain = hair_colours(strands, inside), hair_colours(strands)
    assert tuple(marked[2, 3]) == INSIDE
    assert (marked == INSIDE).all(axis=-1).sum() == 1
    assert np.ptp(marked[~inside], axis=-1).mean() < np.ptp(plain[~inside], axis=-1).mean()


def test_segments_join_neighbours_of_one_strand_only() -> None:
    strands = np.arange(2 * 3 * 3).reshape(2, 3, 3)
    pairs = segments(strands)
    assert pairs.shape == (4, 2, 3)
    assert np.array_equal(pairs[1], strands[0, 1:])
    assert np.array_equal(pairs[2], strands[1, :2])


def test_saved_drapes_never_take_a_name_that_is_there(state: ViewState, catalogue: Catalogue, tmp_path: Path) -> None:
    named = replace(state, groom=replace(state.groom, name="my hair/2"), draper=catalogue.draper("posed")).drape()
    first = free_path(tmp_path, named)
    assert first == tmp_path / "my_hair_2_nod_0000_posed.npz"
    first.with_suffix(".png").touch()
    assert free_path(tmp_path, named).name == "my_hair_2_nod_0000_posed_2.npz"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["wig"], "wig: expected a bundled groom"),
        (["bob", "--motion", "moonwalk"], "motion 'moonwalk': expected"),
        (["--weights", "none.safetensors"], "none.safetensors: expected a checkpoint"),
        (["--folder", "nowhere"], "--folder: expected an existing folder"),
        (["--port", "70000"], "port: expected 0 to 65535, found 70000"),
        (["--host", "no.such.host.invalid"], "no.such.host.invalid:8080: expected a free address"),
    ],
)
def test_bad_input_is_refused_before_a_page_is_served(
    arguments: list[str], complaint: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["view", *arguments])
    assert stop.value.code == 2
    message = capfd.readouterr().err
    assert complaint in message
    assert message.count("\n") == 1


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"127.0.0.1:{port}"):
            check_address("127.0.0.1", port)


def no_picture(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    path.write_bytes(b"a picture")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("saved")


@pytest.fixture(scope="module")
def page(catalogue: Catalogue, saved: Path) -> Iterator[Page]:
    served = Page(catalogue, Settings("thinned", REST, strands=GUIDES), ("127.0.0.1", 0), saved, no_picture)
    assert finishes(served.session.thread)
    yield served
    served.stop()


def settled(page: Page) -> ViewState:
    """What is shown when all that was asked for is done."""
    assert finishes(page.session.thread)
    assert page.session.shown is not None
    return page.session.shown.state


def wait_until(holds: Callable[[], bool]) -> None:
    """What is clicked takes its way through the browser."""
    end = time.monotonic() + SECONDS
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_the_page_shows_its_first_drape(page: Page) -> None:
    assert settled(page).groom.name == "thinned"
    assert "ms a drape, network" in page.panel.status.content
    hair = page._nodes._hair
    assert hair is not None
    assert page.session.shown is not None
    assert np.array_equal(hair.points, segments(page.session.shown.strands))


def test_what_the_program_sets_is_no_change_by_hand(page: Page) -> None:
    shown = settled(page)
    page.panel.groom.value = "bob"
    assert settled(page) is shown
    page.panel.groom.value = "thinned"


def test_changes_send_points_and_keep_the_nodes(page: Page) -> None:
    settled(page)
    hair, before = page._nodes._hair, page.session.shown
    assert hair is not None
    assert before is not None
    page.session.ask_edit("turn", lambda state: state.rotated(HEAD, (0.0, 0.0, 30.0)))
    settled(page)
    assert page._nodes._hair is hair
    assert not np.array_equal(hair.points, segments(before.strands))
    page.session.ask_edit("turn", lambda state: replace(state, joint_rotations={}))
    settled(page)
    np.testing.assert_allclose(hair.points, segments(before.strands), atol=1e-6)


class SlowDraper:
    """The posed groom, lifted, from a draper that is not one of those that follow every change."""

    name, material = "slow", HairMaterial()

    def __init__(self, fails: bool = False) -> None:
        self.fails = fails

    def drape(self, scene: Scene) -> Positions:
        if self.fails:
            raise InputError("slow", "strands that settle", "others")
        return scene.posed + 0.01


class Follower:
    """The posed groom, from a draper that counts how often it starts anew."""

    name, material = "strand_newton", HairMaterial()

    def __init__(self, drapes_until_rest: int = 0) -> None:
        self.restarts, self.drapes_until_rest, self.drapes, self.frame_seconds = 0, drapes_until_rest, 0, 1 / 30

    @property
    def is_moving(self) -> bool:
        return self.drapes < self.drapes_until_rest

    def restart(self) -> None:
        self.restarts += 1

    def drape(self, scene: Scene) -> Positions:
        self.drapes += 1
        return scene.posed


@pytest.mark.parametrize(("until_rest", "drapes"), [(3, 3), (1000, 1 + MOST_DRAPES)])
def test_a_state_is_draped_until_its_hair_is_at_rest(
    page: Page, catalogue: Catalogue, until_rest: int, drapes: int
) -> None:
    follower = Follower(until_rest)
    page.session.ask_edit("draper", lambda state: replace(state, draper=follower))
    wait_until(lambda: follower.drapes == drapes)
    settled(page)
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("neural")))
    settled(page)
    assert follower.drapes == drapes


def test_stiffness_gravity_and_wind_reach_strand_newton_live(page: Page, catalogue: Catalogue) -> None:
    """Hair is drawn to the side, the same draper goes on, and what it reads is in the saved drape."""
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("strand_newton")))
    before = settled(page)
    put(page.panel.stiffness, 0.5)
    put(page.panel.wind[0], 6.0)
    page._load(0.0)
    after = settled(page)
    assert isinstance(after.draper, CoherentDraper)
    while after.draper.is_moving:
        settled(page)
    assert after.draper is before.draper
    assert after.loading == Loading(0.5, (6.0, 0.0, -9.81))
    shown = page.session.shown
    assert shown is not None
    assert (shown.sequence.meta["stiffness"], shown.sequence.meta["acceleration"]) == (0.5, (6.0, 0.0, -9.81))
    aside = shown.strands[:, -1, 0] - shown.sequence.posed[0, :, -1, 0]
    assert float(aside.mean()) > 0.01
    page._reset_loads()
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("neural")))
    assert settled(page).loading == Loading()
    assert page.panel.wind[0].value == 0.0


def test_hair_follows_in_a_clip_and_starts_anew_in_another(page: Page, catalogue: Catalogue) -> None:
    follower = Follower()
    page.session.ask_edit("draper", lambda state: replace(state, draper=follower))
    page.session.ask_edit("motion", lambda state: state.playing(catalogue.motion("nod")))
    settled(page)
    assert follower.restarts == 1
    page.session.ask_edit("frame", lambda state: state.at(3))
    settled(page)
    assert follower.restarts == 1
    page.session.ask_edit("motion", lambda state: state.playing(catalogue.motion(REST)))
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("neural")))
    settled(page)
    assert follower.restarts == 2


def test_a_solver_waits_for_its_button(page: Page, catalogue: Catalogue) -> None:
    """The network's drape is shown meanwhile."""
    page.session.ask_edit("draper", lambda state: replace(state, draper=SlowDraper()))
    assert settled(page).draper.name == "neural"
    assert page.panel.settle.visible
    assert page.panel.settle.label == "Settle with slow"
    assert page.session.state.draper.name == "slow"
    page.session.ask(page.session.settle)
    assert settled(page).draper.name == "slow"
    assert "**slow**" in page.panel.status.content
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("posed")))
    assert settled(page).draper.name == "posed"
    assert not page.panel.settle.visible
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("neural")))
    settled(page)


def test_a_groom_that_cannot_be_draped_does_not_stay(page: Page) -> None:
    """Two of its strands root in one texel, which the network cannot hold."""
    before = settled(page)
    twice = before.groom.select(torch.tensor([0, 0, 1]))
    page.session.ask_edit("groom", lambda state: replace(state, groom=twice))
    assert settled(page) is before
    assert page.session.state is before
    page.session.ask_edit("frame", lambda state: state.rotated(HEAD, (0.0, 0.0, 20.0)))
    assert settled(page).joint_rotations == {HEAD: (0.0, 0.0, 20.0)}
    page.session.ask_edit("frame", lambda state: replace(state, joint_rotations={}))
    settled(page)


def test_settings_of_a_link_are_shown_in_the_scene_and_in_the_widgets(page: Page) -> None:
    before = page.panel.settings()
    linked = replace(
        before, motion="nod", frame=20, mark_inside=True, joint_rotations={HEAD: (0.0, 0.0, 30.0)}, wind=(6.0, 0.0, 0.0)
    )
    page.session.ask_settings(linked)
    shown = settled(page)
    assert (shown.motion.name, shown.frame, shown.joint_rotations) == ("nod", 20, {HEAD: (0.0, 0.0, 30.0)})
    assert shown.loading.acceleration[0] == 6.0
    found = page.panel.settings()
    assert replace(found, joint_rotations=found.rotated_joints) == linked
    assert page._nodes._skin.opacity is not None
    page.session.ask_settings(before)
    assert settled(page).motion.name == REST
    assert page.panel.settings() == before
    assert page._nodes._skin.opacity is None


@pytest.mark.parametrize("change", [{"groom": "wig"}, {"motion": "moonwalk"}, {"frame": 10_000}, {"draper": "hope"}])
def test_a_link_to_what_is_not_there_changes_nothing(page: Page, change: dict[str, Any]) -> None:
    before, settings = settled(page), page.panel.settings()
    page.session.ask_settings(replace(settings, **change))
    assert settled(page).groom is before.groom
    assert page.panel.settings() == settings


def test_widgets_go_back_to_what_could_be_draped(page: Page, catalogue: Catalogue) -> None:
    """As in a browser: the picker has its new value already."""
    twice = replace(page.session.state.groom.select(torch.tensor([0, 0, 1])), name="bob")
    page.panel.groom.value = "bob"
    page.session.ask_edit("groom", lambda state: replace(state, groom=twice))
    settled(page)
    assert page.panel.groom.value == "thinned"


@pytest.mark.parametrize(
    ("most_milliseconds", "strands", "note"),
    [(1e9, ALL_STRANDS, "10,000 strands drawn"), (0.0, 0, "guides drawn: 10,000 strands would take")],
)
def test_all_hair_is_drawn_where_the_machine_does_it_in_time(
    state: ViewState, catalogue: Catalogue, most_milliseconds: float, strands: int, note: str
) -> None:
    drawing = HairDrawing(catalogue, Display(), most_milliseconds)
    drape = replace(state, draper=PosedDraper()).drape()
    points, colours = drawing.strands(drape)
    assert len(points) == len(colours) == (strands or len(state.groom))
    assert drawing.note(drape).startswith(note)


def test_guides_are_drawn_where_nothing_is_between_them(state: ViewState, catalogue: Catalogue) -> None:
    few = replace(state, groom=state.groom.select(torch.arange(2)), draper=PosedDraper()).drape()
    drawing = HairDrawing(catalogue, Display())
    assert len(drawing.strands(few)[0]) == 2
    assert drawing.note(few) == "guides drawn, too few for strands between them"


def test_a_solver_that_fails_leaves_the_page_as_it_was(page: Page, catalogue: Catalogue) -> None:
    page.session.ask_edit("draper", lambda state: replace(state, draper=SlowDraper(fails=True)))
    before, status = settled(page), page.panel.status.content
    page.session.ask(page.session.settle)
    assert settled(page) is before
    assert page.panel.status.content == status
    page.session.ask_edit("draper", lambda state: replace(state, draper=catalogue.draper("neural")))
    settled(page)


def test_strands_between_guides_and_marks(page: Page) -> None:
    guides = len(settled(page).groom)
    page.session.ask_display(Display(2 * guides, True))
    settled(page)
    hair = page._nodes._hair
    assert hair is not None
    assert len(hair.points) == 2 * guides * 23
    assert page._nodes._skin.opacity is not None
    page.session.ask_display(Display(0))
    settled(page)
    assert page._nodes._hair is not None
    assert len(page._nodes._hair.points) == guides * 23
    assert page._nodes._skin.opacity is None


@dataclass(frozen=True)
class Browser:
    """The page in Chromium, and every address that it asked for."""

    tab: "Tab"
    asked: list[str]

    def picture(self) -> np.ndarray:
        """What is left of the panel, [h, w, 3]."""
        clip = {"x": 0, "y": 0, "width": WIDTH - PANEL_WIDTH, "height": HEIGHT}
        return np.array(Image.open(io.BytesIO(self.tab.screenshot(clip=clip))).convert("RGB")).astype(int)  # type: ignore[arg-type]

    def hair_and_skin(self) -> tuple[int, int]:
        """Pixels of dark brown, and of light reddish grey."""
        red, green, blue = np.moveaxis(self.picture(), -1, 0)
        warm = (red > green) & (green > blue)
        return int((warm & (red < 130) & (red > blue + 15)).sum()), int((warm & (red > 150) & (red > blue + 15)).sum())

    def wait_for(self, seen: Callable[[int, int], bool]) -> None:
        """Until the pixels of hair and skin are as they should be: a browser takes its time."""
        end = time.monotonic() + SECONDS
        while not seen(*self.hair_and_skin()):
            assert time.monotonic() < end, self.hair_and_skin()


@pytest.fixture(scope="module")
def browser(page: Page) -> Iterator[Browser]:
    """A small window, because the processor draws it."""
    if CHROMIUM is None:
        pytest.skip("no chromium on PATH (Debian: apt-get install chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install playwright")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        context = chromium.new_context(viewport={"width": WIDTH, "height": HEIGHT})
        context.set_default_timeout(1000 * SECONDS)
        tab = context.new_page()
        opened = Browser(tab, [])
        tab.on("request", lambda request: opened.asked.append(request.url))
        tab.on("websocket", lambda websocket: opened.asked.append(websocket.url))
        tab.goto(page.url)
        tab.get_by_role("combobox", name="Groom").wait_for()
        yield opened
        chromium.close()


def test_a_browser_shows_hair_and_skin_and_asks_nobody_else(browser: Browser, page: Page) -> None:
    browser.wait_for(lambda hair, skin: hair > 2000 and skin > 2000)
    address = page.url.removeprefix("http://")
    assert f"ws://{address}/" in browser.asked
    own = (f"http://{address}/", f"ws://{address}/", f"blob:http://{address}/", "data:")
    assert [url for url in browser.asked if not url.startswith(own)] == []


def test_a_groom_picked_in_the_browser_is_draped_and_seen(browser: Browser, page: Page) -> None:
    long_hair, _ = browser.hair_and_skin()
    browser.tab.get_by_role("combobox", name="Groom").click()
    browser.tab.get_by_role("option", name="crew_cut", exact=True).click()
    browser.wait_for(lambda hair, skin: hair < long_hair / 2)
    assert settled(page).groom.name == "crew_cut"


def test_play_moves_the_frame_and_pause_stops_it(browser: Browser, page: Page, catalogue: Catalogue) -> None:
    page.session.ask_edit("motion", lambda state: state.playing(catalogue.motion("nod")))
    browser.tab.get_by_role("button", name="Play").click()
    wait_until(lambda: page.panel.frame.value > 0)
    browser.tab.get_by_role("button", name="Pause").click()
    wait_until(lambda: not page._playback.playing)
    time.sleep(2 / CLIP_FPS)  # a frame that was due already
    frame = settled(page).frame
    assert frame > 0
    assert page.panel.frame.value == frame
    time.sleep(0.3)
    assert settled(page).frame == frame


def test_an_error_is_shown_and_the_page_goes_on(
    browser: Browser, page: Page, catalogue: Catalogue, capfd: pytest.CaptureFixture[str]
) -> None:
    page.session.ask_edit("motion", lambda state: state.playing(catalogue.motion("nod")))
    settled(page)
    page.session.ask_edit("frame", lambda state: replace(state, frame=-1))
    browser.tab.get_by_text("frame: expected 0 to").wait_for()
    page.session.ask_edit("frame", lambda state: [][1])
    browser.tab.get_by_text("IndexError").wait_for()
    assert "IndexError" in capfd.readouterr().err
    page.session.ask_edit("frame", lambda state: state.at(11))
    assert settled(page).frame == 11


def test_buttons_measure_and_save(browser: Browser, page: Page, saved: Path) -> None:
    browser.tab.get_by_role("button", name="Save drape").click()
    browser.tab.get_by_text(".npz and").wait_for()
    (path,) = saved.glob("*.npz")
    assert path.with_suffix(".png").is_file()
    assert page.session.shown is not None
    assert np.array_equal(read_drape(path).strands[0], page.session.shown.strands)
    browser.tab.get_by_text("Measure", exact=True).click()
    browser.tab.get_by_role("button", name="Measure this drape").click()
    browser.tab.get_by_text("body_intersection_percent").wait_for()
    browser.tab.get_by_text("Drape", exact=True).click()


def test_keys_play_step_and_turn_the_camera(browser: Browser, page: Page, catalogue: Catalogue) -> None:
    page.session.ask_settings(Settings("thinned", "nod", strands=GUIDES))
    assert settled(page).frame == 0
    keyboard, frame = browser.tab.keyboard, page.panel.frame
    for key, expected in (("n", 1), ("n", 2), ("b", 1), ("Home", 0), ("b", len(catalogue.motion("nod")) - 1)):
        keyboard.press(key)
        wait_until(lambda expected=expected: frame.value == expected)  # type: ignore[misc]
        assert settled(page).frame == expected
    keyboard.press("m")
    wait_until(lambda: page.panel.motion.value == CLIP_NAMES[CLIP_NAMES.index("nod") + 1])
    keyboard.press("h")
    wait_until(lambda: page.panel.strands.value == AUTOMATIC)
    keyboard.press("h")
    wait_until(lambda: page.panel.strands.value == GUIDES)
    (client,) = page._server.get_clients().values()
    keyboard.press("4")
    wait_until(lambda: client.camera.position[1] > 1.0)
    keyboard.press("1")
    wait_until(lambda: client.camera.position[1] < -1.0)


def test_the_space_bar_plays_once_also_after_a_click_on_play(browser: Browser, page: Page) -> None:
    """A button that has the focus takes the space bar as a click."""
    browser.tab.get_by_role("button", name="Play", exact=True).click()
    wait_until(lambda: page._playback.playing)
    browser.tab.keyboard.press("Space")
    wait_until(lambda: not page._playback.playing)
    time.sleep(1.0)
    assert not page._playback.playing


def test_a_link_opens_the_view_again(browser: Browser, page: Page) -> None:
    page.session.ask_settings(Settings("thinned", "nod", 25, joint_rotations={HEAD: (0.0, 0.0, 40.0)}, strands=GUIDES))
    settled(page)
    browser.tab.keyboard.press("3")
    (client,) = page._server.get_clients().values()
    wait_until(lambda: client.camera.position[0] > 1.0)
    browser.tab.get_by_role("button", name="Link to this view").click()
    link = browser.tab.get_by_role("link", name="Link to this view")
    wait_until(lambda: "frame=25" in (link.get_attribute("href") or ""))
    address = link.evaluate("link => link.href")
    page.session.ask_settings(Settings("crew_cut", REST))
    assert settled(page).groom.name == "crew_cut"

    with closing(browser.tab.context.new_page()) as other:
        other.goto(address)
        wait_until(lambda: len(page._server.get_clients()) == 2)
        shown = settled(page)
        assert (shown.groom.name, shown.motion.name, shown.frame) == ("thinned", "nod", 25)
        assert shown.joint_rotations == {HEAD: (0.0, 0.0, 40.0)}
        assert page.panel.joints[HEAD][2].value == 40.0
        assert "groom" not in other.url
        camera = page._server.get_clients()[max(page._server.get_clients())].camera
        wait_until(lambda: np.allclose(camera.position, client.camera.position, atol=2e-3))
        other.goto(f"{page.url}/?groom=wig")
        other.get_by_text("found 'wig'").wait_for()
        assert settled(page) is shown
    wait_until(lambda: len(page._server.get_clients()) == 1)


def test_a_picture_of_what_the_camera_shows_is_downloaded(browser: Browser, page: Page) -> None:
    page.session.ask_settings(Settings("thinned", "nod", 25, strands=GUIDES))
    settled(page)
    with browser.tab.expect_download() as download:
        browser.tab.get_by_role("button", name="Save picture").click()
    assert download.value.suggested_filename == "thinned_nod_0025_neural.png"
    picture = Image.open(download.value.path()).convert("RGB")
    (client,) = page._server.get_clients().values()
    assert max(picture.size) == 1000
    assert picture.width / picture.height == pytest.approx(client.camera.image_width / client.camera.image_height, 0.01)
    assert np.array(picture).std() > 20


@pytest.mark.slow
@pytest.mark.parametrize("interactions", [60, pytest.param(400, marks=pytest.mark.long)])
def test_memory_of_chromium_stays_flat_over_many_interactions(browser: Browser, page: Page, interactions: int) -> None:
    """Frames, clips, views and what is drawn by keys, sliders by arrows; each drape is drawn before the next one."""
    page.session.ask_settings(Settings("thinned", "nod", strands=GUIDES))
    settled(page)
    keyboard, slider = browser.tab.keyboard, browser.tab.get_by_role("slider").first
    devtools = browser.tab.context.new_cdp_session(browser.tab)
    used = []
    for step in range(interactions):
        key = ("n", "ArrowRight", "n", f"{1 + step % 4}", "b", "ArrowLeft", "h" if step % 40 < 16 else "n", "m")[
            step % 8
        ]
        if key.startswith("Arrow"):
            slider.focus()
        keyboard.press(key)
        settled(page)
        browser.tab.evaluate("() => new Promise(drawn => requestAnimationFrame(drawn))")
        if (step + 1) % (interactions // 4) == 0:
            devtools.send("HeapProfiler.collectGarbage")
            sizes = devtools.send("Runtime.getHeapUsage")
            used.append(sum(sizes[name] for name in ("usedSize", "embedderHeapUsedSize", "backingStorageSize")))
    print("memory of the tab after every quarter of the interactions [MB]:", *(round(size / 1e6) for size in used))
    # An update that is kept is over 200 kB.
    assert used[-1] - used[len(used) // 2 - 1] < MOST_GROWTH * interactions / 2


def test_on_a_narrow_screen_the_panel_leaves_the_head_in_view(browser: Browser, page: Page) -> None:
    assert browser.tab.context.browser is not None
    with closing(browser.tab.context.browser.new_context(viewport={"width": 400, "height": 800})) as context:
        context.set_default_timeout(1000 * SECONDS)
        tab = context.new_page()
        tab.goto(page.url)
        panel = tab.get_by_text("quaffure", exact=True)
        panel.wait_for()
        wait_until(lambda: len(page._server.get_clients()) == 2)
        camera = page._server.get_clients()[max(page._server.get_clients())].camera
        head = float(page._nodes._head[2])

        def height_of(above_joint: float, window: float) -> float:
            """Of a point of the head, from the upper edge of the window, in pixels."""
            distance = float(np.linalg.norm(np.subtract(camera.position, camera.look_at)))
            share = (camera.look_at[2] - head - above_joint) / distance / np.tan(0.5 * camera.fov)
            return 0.5 * window * (1.0 + float(share))

        box = panel.bounding_box()
        assert box is not None
        chin, crown = -0.12, 0.2  # m above the joint of the head
        wait_until(lambda: 0.0 < height_of(crown, 800.0) < height_of(chin, 800.0) < box["y"])
        tab.set_viewport_size({"width": 400, "height": 500})
        wait_until(lambda: 0.0 < height_of(crown, 500.0) < height_of(chin, 500.0) < 0.4 * 500)
        tab.set_viewport_size({"width": 1280, "height": 800})
        wait_until(lambda: abs(height_of(chin, 800.0) - 400.0) < 120.0)
