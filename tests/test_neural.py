from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.body import FEATURE_COUNT, BodyModel, Motion, head_frame_body_reference, load_body
from quaffure.body.mls_body import mls_body
from quaffure.body.pose_features import pose_features
from quaffure.energies import STANDARD_LOADING, Loading, design_of
from quaffure.geometry import (
    axis_angle_from_matrix,
    integrate_directions,
    matrix_from_axis_angle,
    resolve_contact_reference,
)
from quaffure.hair import Groom
from quaffure.model import (
    DisplacementNetwork,
    InitialShapeConfig,
    NetworkConfig,
    NeuralDraper,
    build_network,
    initial_clearance,
    load_groom_encoder,
    load_model,
    load_network,
    prepare_groom,
    prepared_groom,
    save_network,
)
from quaffure.model.initial_shape import initial_shape_reference
from quaffure.model.prepared_groom import balanced_depth, limit_slope
from quaffure.model.weights_file import read_weights
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from tests.training_runs import perturbed

MATERIAL = HairMaterial()
SHAPE = InitialShapeConfig()
DIRECTIONS = NetworkConfig(pose_features=FEATURE_COUNT)
DISPLACEMENT = NetworkConfig(output="displacement")


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("bob", body).select(torch.arange(0, 2400, 30))


@pytest.fixture
def scene(body: BodyModel, groom: Groom) -> Scene:
    generator = torch.Generator().manual_seed(0)
    pose = 0.2 * torch.randn(3, 81, generator=generator)
    return Scene(groom, BodyBatch(body, pose, torch.randn(3, 10, generator=generator)))


def shaken(config: NetworkConfig, strength: float = 0.05) -> NeuralDraper:
    """A network whose last layer is not zero, as if it had learnt something."""
    torch.manual_seed(0)
    return NeuralDraper(perturbed(build_network(config), strength), MATERIAL)


def test_untrained_directions_are_the_initial_shape(scene: Scene, body: BodyModel) -> None:
    prepared = prepare_groom(scene.groom, body, build_network(DIRECTIONS).encoder, DIRECTIONS, MATERIAL)
    bodies = scene.bodies
    view = head_frame_body_reference(body, bodies.body_pose, bodies.body_shape, bodies.posed, SHAPE.body)
    shape = initial_shape_reference(prepared, view, STANDARD_LOADING, SHAPE)
    edges = shape.edges @ view.world_from_head[:, None].mT
    expected = integrate_directions(scene.posed[:, :, 0], edges, scene.groom.rest_lengths)
    drape = NeuralDraper(build_network(DIRECTIONS), MATERIAL).deform(scene)
    torch.testing.assert_close(drape, expected, atol=1e-4, rtol=0)
    assert (expected - scene.posed).norm(dim=-1).max() > 0.01


def test_upright_a_network_leaves_the_design(groom: Groom, body: BodyModel) -> None:
    """Whatever it has learnt: what rests already is not moved."""
    upright = Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))
    assert (shaken(DIRECTIONS, 0.1).drape(upright) - upright.posed).norm(dim=-1).max() < 1e-3


def test_hair_starts_no_further_out_than_it_is_at_rest(groom: Groom, body: BodyModel) -> None:
    posed = Scene(groom, BodyBatch(body, torch.zeros(1, 81), torch.zeros(1, 10)))
    surface = mls_body(body, posed.bodies.posed, SHAPE.body)
    margin = initial_clearance(groom, design_of(groom, body, MATERIAL).collision_margin.float(), body, SHAPE)
    lengths = groom.rest_lengths
    edges, _ = resolve_contact_reference(posed.posed[:, :, 0], posed.director, lengths, margin, surface)
    torch.testing.assert_close(edges, posed.director, atol=1e-3, rtol=0)


def test_margins_rise_along_a_strand_by_a_share_of_the_way() -> None:
    margin = torch.tensor([[-9.0, -9.0, 0.02, 0.0, 0.02, 0.02]])
    lengths = torch.full((1, 5), 0.01)
    expected = torch.tensor([[-9.0, -9.0, 0.005, 0.0, 0.005, 0.01]])
    torch.testing.assert_close(limit_slope(margin, lengths, 0.5), expected)


@pytest.mark.parametrize("name", ["crew_cut", "long_straight"])
def test_very_short_hair_is_not_bent_where_the_point_sampled_skin_is_less_exact_than_it_is_stiff(
    body: BodyModel, name: str
) -> None:
    groom = make_groom(name, body).select(torch.arange(0, 2400, 40))
    depth = balanced_depth(design_of(groom, body, MATERIAL), groom.rest_lengths, MATERIAL, SHAPE)
    assert (depth.median() > 2e-3) == (name == "crew_cut")
    assert depth.min() > 0
    assert depth.max() <= SHAPE.max_depth


def test_untrained_displacements_are_zero(scene: Scene) -> None:
    torch.testing.assert_close(NeuralDraper(build_network(DISPLACEMENT), MATERIAL).drape(scene), scene.posed)


def test_directions_keep_lengths_and_roots(scene: Scene) -> None:
    draped = shaken(DIRECTIONS).drape(scene)
    assert (draped - scene.posed).norm(dim=-1).max() > 0.02
    torch.testing.assert_close(draped[:, :, 0], scene.posed[:, :, 0])
    lengths = draped.diff(dim=2).norm(dim=-1)
    torch.testing.assert_close(lengths, scene.groom.rest_lengths.expand(3, -1, -1), atol=2e-6, rtol=1e-4)


def test_displacements_leave_the_roots(scene: Scene) -> None:
    draped = shaken(DISPLACEMENT).drape(scene)
    assert (draped - scene.posed).norm(dim=-1).max() > 1e-3
    torch.testing.assert_close(draped[:, :, 0], scene.posed[:, :, 0], atol=1e-6, rtol=0)


@pytest.mark.parametrize("config", [DIRECTIONS, DISPLACEMENT], ids=["directions", "displacement"])
def test_turning_the_whole_body_turns_the_drape(config: NetworkConfig, scene: Scene, body: BodyModel) -> None:
    draper = shaken(config)
    turned_pose = scene.bodies.body_pose.clone()
    angle = torch.tensor(0.9)
    c, s = angle.cos(), angle.sin()
    turn = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned_pose[:, :3] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(turned_pose[:, :3]))
    turned = Scene(scene.groom, BodyBatch(body, turned_pose, scene.bodies.body_shape))
    hips = scene.bodies.posed.joint_positions[:, None, None, 0]
    expected = (draper.drape(scene) - hips) @ turn.T + hips
    torch.testing.assert_close(draper.drape(turned), expected, atol=1e-3, rtol=0)


def test_a_drape_does_not_depend_on_the_batch_or_the_order_of_strands(scene: Scene, body: BodyModel) -> None:
    draper = shaken(DIRECTIONS)
    whole = draper.drape(scene)
    one = Scene(scene.groom, BodyBatch(body, scene.bodies.body_pose[1:2], scene.bodies.body_shape[1:2]))
    torch.testing.assert_close(draper.drape(one)[0], whole[1], atol=1e-5, rtol=0)
    order = torch.randperm(len(scene.groom), generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(
        draper.drape(Scene(scene.groom.select(order), scene.bodies)), whole[:, order], atol=1e-5, rtol=0
    )


def test_a_groom_is_fitted_to_a_body_once(groom: Groom, body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[Groom] = []
    at_rest = prepared_groom.rest_strands
    monkeypatch.setattr(prepared_groom, "rest_strands", lambda *of: (fitted.append(groom), at_rest(*of))[1])
    model = load_model()
    for _ in range(2):
        model.drape(groom, torch.zeros(1, 81), torch.zeros(1, 10))
    assert len(fitted) == 1
    model.draper.drape(Scene(groom, BodyBatch(replace(body), torch.zeros(1, 81), torch.zeros(1, 10))))
    assert len(fitted) == 2


def test_pose_features_do_not_change_with_heading_and_do_with_the_head(body: BodyModel) -> None:
    poses = torch.zeros(3, 81)
    poses[1, 2] = 1.0  # the hips, about the vertical
    poses[2, 3 * body.joint_names.index("Head")] = 0.4
    features = pose_features(body, *body.posed_joints(poses, torch.zeros(3, 10)))
    assert features.shape == (3, FEATURE_COUNT)
    torch.testing.assert_close(features[1], features[0], atol=1e-5, rtol=0)
    assert (features[2] - features[0]).abs().max() > 0.1
    torch.testing.assert_close(features[0, :3], torch.tensor([0.0, 0.0, -1.0]))


def test_checkpoints_round_trip_in_half_precision(tmp_path: Path, scene: Scene) -> None:
    draper = shaken(DIRECTIONS)
    material = HairMaterial(k_cosserat=1e-7)
    save_network(tmp_path / "n.safetensors", draper.network, material, {"step": "7"})
    network, loaded_material, notes = load_network(tmp_path / "n.safetensors")
    assert (loaded_material, notes["step"], network.config) == (material, "7", DIRECTIONS)
    again = NeuralDraper(network, MATERIAL).drape(scene)
    torch.testing.assert_close(again, draper.drape(scene), atol=5e-3, rtol=0)


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    with pytest.raises(InputError, match="no such file"):
        load_network(path)
    path.write_bytes(b"\x80\x04K\x01.")
    with pytest.raises(InputError, match="checkpoint"):
        load_network(path)


def test_the_shipped_model_drapes(groom: Groom) -> None:
    model = load_model()
    assert model.drape(groom, torch.zeros(2, 81), torch.zeros(2, 10)).shape == (2, len(groom), 24, 3)


def test_grooms_are_coded_again_by_another_encoder(groom: Groom) -> None:
    model = load_model()
    network = deepcopy(model.draper.network)
    draper = NeuralDraper(network, model.draper.material)
    scene = Scene(groom, BodyBatch(model.body, torch.zeros(1, 81), torch.zeros(1, 10)))
    draper.drape(scene)
    kept = draper.prepared(groom, model.body)
    for part, stays in ((network.decoder, True), (network.encoder, False)):
        with torch.no_grad():
            next(part.parameters()).mul_(1.5)
        draper.drape(scene)
        assert (draper.prepared(groom, model.body) is kept) == stays


def test_the_papers_configuration_is_shipped_and_knows_one_loading(groom: Groom) -> None:
    model = load_model("paper")
    assert isinstance(model.draper.network, DisplacementNetwork)
    pose, shape = torch.zeros(1, 81), torch.zeros(1, 10)
    moved = (model.drape(groom, pose, shape)[0] - groom.rest_strands).norm(dim=-1)
    assert moved[:, 0].max() < 1e-5
    assert 1e-3 < moved[:, -1].mean() < 0.1
    with pytest.raises(InputError, match="the paper's configuration"):
        model.with_loading(Loading(0.5))


def test_weights_of_the_shipped_encoder_are_not_written_again(tmp_path: Path) -> None:
    network = build_network(DISPLACEMENT)
    network.encoder.load_state_dict(load_groom_encoder().state_dict())
    save_network(tmp_path / "same.safetensors", network, HairMaterial(), {})
    torch.nn.init.zeros_(network.encoder.to_code.bias)
    save_network(tmp_path / "other.safetensors", network, HairMaterial(), {})
    names = [read_weights(tmp_path / f"{name}.safetensors", "weights")[0].keys() for name in ("same", "other")]
    assert {name for name in names[1] if name.startswith("encoder.")} == {"encoder.to_code.bias"}
    assert names[1] - names[0] == {"encoder.to_code.bias"}
    again = load_network(tmp_path / "other.safetensors")[0].state_dict()
    for name, value in network.encoder.state_dict().items():
        assert torch.equal(again[f"encoder.{name}"], value)


def test_the_shipped_model_refuses_what_does_not_fit(groom: Groom) -> None:
    model = load_model()
    with pytest.raises(InputError, match="body_pose"):
        model.drape(groom, torch.zeros(2, 72), torch.zeros(2, 10))
    with pytest.raises(InputError, match="body_shape"):
        model.drape(groom, torch.zeros(2, 81), torch.zeros(1, 10))
    with pytest.raises(InputError, match="texel"):
        model.drape(groom.select(torch.tensor([0, 0])), torch.zeros(2, 81), torch.zeros(2, 10))


def test_motion_frames_are_checked() -> None:
    with pytest.raises(InputError, match="A = 5"):
        Motion(torch.zeros(4, 81), 30.0, "m").frames("5:9")
