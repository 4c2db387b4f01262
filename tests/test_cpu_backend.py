"""The compiled drape against its torch twins, and what a user relies on in it."""

from collections.abc import Iterator
from dataclasses import replace

import numba
import pytest
import torch

from quaffure import HairMaterial, InputError
from quaffure.backend import Backend
from quaffure.body import FEATURE_COUNT, BodyModel, HeadFrameBody, head_frame_body, head_frame_body_reference
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import STANDARD_LOADING, Loading, design_of
from quaffure.energies.rest_state import rest_state
from quaffure.hair import Groom, triangle_frames
from quaffure.hair.strand_blocks import rest_strands
from quaffure.model import (
    DirectionNetwork,
    InferenceNetwork,
    InitialShapeConfig,
    NetworkConfig,
    NetworkInputs,
    NeuralDraper,
    PreparedGroom,
    ProjectionConfig,
    Quaffure,
    activated_layers,
    build_network,
    load_model,
    prepare_groom,
)
from quaffure.model.activated_layers import fused
from quaffure.model.cpu_backend import BATCH
from quaffure.model.inference_network import (
    StrandTexels,
    fast_bfloat16,
    folded_doubling,
    no_features,
    texture_rows,
)
from quaffure.model.initial_shape import InitialShape, empty_shape, fill_initial_shape, initial_shape_reference
from quaffure.model.pose_code import LOADING_FEATURES
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from tests.scenes import random_bodies
from tests.training_runs import perturbed

CONFIG = NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=16, strand_width=32)
MATERIAL = HairMaterial()
SHAPE = InitialShapeConfig()
CONTACT_ROUNDING = 2e-4  # [m]: a contact rotates all that hangs on it, and with it the roundings
NO_FADING = InitialShapeConfig(least_disturbance=0.0)
ALL_FREE = torch.tensor(-10.0)  # a margin that no strand falls short of


@pytest.fixture(scope="module")
def groom(body: BodyModel) -> Groom:
    return make_groom("bob", body).select(torch.arange(0, 2400, 29))  # 83 strands: no full last packet


@pytest.fixture(scope="module")
def bodies(body: BodyModel) -> BodyBatch:
    return random_bodies(body, 3)


@pytest.fixture(scope="module")
def network() -> DirectionNetwork:
    """As if it had learnt something."""
    torch.manual_seed(0)
    network = build_network(CONFIG)
    assert isinstance(network, DirectionNetwork)
    return perturbed(network)


@pytest.fixture
def model(network: DirectionNetwork, body: BodyModel) -> Quaffure:
    return Quaffure(body, NeuralDraper(network, MATERIAL, bf16=False), {})


def prepared(groom: Groom, body: BodyModel, margin: torch.Tensor | None = None) -> PreparedGroom:
    """A groom with its own margin, or with another."""
    ready = prepare_groom(groom, body, build_network(CONFIG).encoder, CONFIG, MATERIAL)
    return ready if margin is None else replace(ready, initial_clearance=margin)


def compiled_body(bodies: BodyBatch) -> HeadFrameBody:
    return head_frame_body(bodies.body, bodies.body_pose, bodies.body_shape, bodies.joints, SHAPE.body)


def initial_shape(groom: PreparedGroom, bodies: BodyBatch, config: InitialShapeConfig = SHAPE) -> InitialShape:
    shape = empty_shape(len(bodies.body_pose), len(groom.initial_clearance), 184, torch.float32)
    fill_initial_shape(
        groom.blocks, groom.blocks.strands.strand, compiled_body(bodies), STANDARD_LOADING, config, shape
    )
    return shape


def expected_shape(groom: PreparedGroom, bodies: BodyBatch, loading: Loading = STANDARD_LOADING) -> InitialShape:
    posed = bodies.body.pose(bodies.body_pose, bodies.body_shape)
    view = head_frame_body_reference(bodies.body, bodies.body_pose, bodies.body_shape, posed, SHAPE.body)
    return initial_shape_reference(groom, view, loading, SHAPE)


def test_blocks_hold_every_strand(groom: Groom, body: BodyModel) -> None:
    margin = torch.rand(groom.rest_strands.shape[:2])
    packets = prepared(groom, body, margin).blocks.strands
    strand = torch.from_numpy(packets.strand).long()
    assert sorted(strand.flatten()[: len(groom)].tolist()) == list(range(len(groom)))
    frames = triangle_frames(body.rest_vertices[body.faces[groom.root_faces]])[strand]
    edges = torch.from_numpy(packets.edges).permute(0, 3, 1, 2) @ frames.mT
    torch.testing.assert_close(edges, groom.rest_strands.diff(dim=1)[strand], atol=1e-7, rtol=1e-5)
    assert torch.equal(torch.from_numpy(packets.margin).movedim(2, 1), margin[strand][..., 1:])


def test_roots_off_the_scalp_are_refused(groom: Groom, body: BodyModel) -> None:
    toe = body.faces[:, 0].new_full((len(groom),), int(body.rest_vertices[body.faces[:, 0], 2].argmin()))
    with pytest.raises(InputError, match="roots on the scalp"):
        rest_strands(replace(groom, root_faces=toe), body)


def test_strands_that_meet_nothing_are_those_of_the_twin(groom: Groom, bodies: BodyBatch) -> None:
    ready = prepared(groom, bodies.body, ALL_FREE.expand(len(groom), 24))
    compiled, expected = initial_shape(ready, bodies), expected_shape(ready, bodies)
    for one, other in zip(compiled, expected):
        # Local features change fast where a strand is deep inside.
        torch.testing.assert_close(one, other, atol=1e-4 if one is not compiled.features else 1e-3, rtol=0)


def test_threads_make_no_difference(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba has one thread only")
    drapes, before = [], numba.get_num_threads()
    for threads in (1, 2):
        numba.set_num_threads(threads)
        try:
            drapes.append(model.drape(groom, bodies.body_pose, bodies.body_shape))
        finally:
            numba.set_num_threads(before)
    torch.testing.assert_close(*drapes, atol=1e-6, rtol=0)


def test_two_vertices_in_one_place_stay_there(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    strands = groom.rest_strands.clone()
    strands[7, 12] = strands[7, 11]
    folded = replace(groom, rest_strands=strands)
    # Below the checks, which refuse such a groom: kernels may come by such edges of their own.
    draped = torch.cat(model.draper.drape_grooms([folded] * len(bodies.body_pose), bodies))
    assert draped.isfinite().all()
    torch.testing.assert_close(draped[:, 7, 12], draped[:, 7, 11])


@pytest.mark.parametrize(("style", "every"), [("bob", 30), ("bob", 8), ("half_up", 30)])
def test_compiled_start_is_that_of_the_twin(bodies: BodyBatch, style: str, every: int) -> None:
    groom = make_groom(style, bodies.body).select(torch.arange(0, 2400, every))
    ready = prepared(groom, bodies.body)
    compiled, expected = initial_shape(ready, bodies), expected_shape(ready, bodies)
    torch.testing.assert_close(compiled.roots, expected.roots, atol=2e-6, rtol=0)
    # Local features amplify what rounding there is: a strand that stands on its root bends to either side.
    for one, other in zip(compiled[1:], expected[1:]):
        assert (one - other).abs().quantile(0.99) < 1e-4
        assert (one - other).abs().max() < 5e-3


def test_edges_without_length_push_nothing(groom: Groom, bodies: BodyBatch) -> None:
    strands = groom.rest_strands.clone()
    strands[::3, 12] = strands[::3, 11]
    groom = replace(groom, rest_strands=strands)
    ready = prepared(groom, bodies.body, torch.full(strands.shape[:2], 0.01))
    compiled, expected = initial_shape(ready, bodies), expected_shape(ready, bodies)
    lengths = groom.rest_strands.diff(dim=1).norm(dim=-1) > 0
    apart = (compiled.edges - expected.edges).norm(dim=-1)[:, lengths]
    assert apart.quantile(0.99) < 1e-4
    assert apart.max() < 5e-3


def test_joints_comply_with_the_weight_beyond_them(groom: Groom, bodies: BodyBatch) -> None:
    ready = prepared(groom, bodies.body, ALL_FREE.expand(len(groom), 24))
    free = initial_shape(ready, bodies, NO_FADING)
    rest, design = rest_state(groom.rest_strands.double(), MATERIAL), design_of(groom, bodies.body, MATERIAL)
    edge, strands = 9, groom.rest_strands.double()
    load = rest.mass[:, edge + 1 :].clone()
    load[:, -1] += SHAPE.load_share * rest.mass.sum(1)
    arm = (strands[:, edge + 1 :] - strands[:, edge, None]).norm(dim=-1)
    stiffness = design.rod.bending_stiffness[:, edge]
    alone = STANDARD_GRAVITY * (load * arm).sum(1) / stiffness
    tense = (STANDARD_GRAVITY * rest.rest_length[:, edge] * load.sum(1) / stiffness).sqrt()
    expected = torch.minimum(alone, tense).clamp(max=1).float()
    assert (alone < tense).any()
    assert (alone > tense).any()
    torch.testing.assert_close(free.compliance[:, :, edge], expected.expand(3, -1), rtol=1e-3, atol=1e-5)


def test_joints_comply_with_what_the_skin_has_bent(groom: Groom, bodies: BodyBatch) -> None:
    margins = ALL_FREE.expand(len(groom), 24), torch.full((len(groom), 24), 0.02)
    kept = replace(NO_FADING, bend_relaxation=0.0)
    free, deflected = (initial_shape(prepared(groom, bodies.body, margin), bodies, kept) for margin in margins)
    turned = torch.nn.functional.pad(deflected.edges - free.edges, (0, 0, 1, 0)).diff(dim=2).norm(dim=-1)
    assert turned.max() > 0.1
    torch.testing.assert_close(deflected.compliance, (free.compliance + turned).clamp(max=1), rtol=1e-3, atol=2e-3)


def test_stiffness_of_every_edge_is_that_of_all(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    rows = bodies.body_pose, bodies.body_shape
    each, all_alike = Loading(torch.full((len(groom), 23), 2.5, requires_grad=True)), Loading(2.5)
    draped = model.with_loading(each).drape(groom, *rows)
    torch.testing.assert_close(model.with_loading(all_alike).drape(groom, *rows), draped, atol=2e-5, rtol=0)
    assert (draped - model.drape(groom, *rows)).norm(dim=-1).max() > 5e-3
    in_torch = NeuralDraper(model.draper.network, MATERIAL, backend=Backend.TORCH)
    scene = Scene(groom.select(torch.arange(8)), bodies)
    with torch.no_grad():
        one, other = (
            in_torch.with_loading(Loading(each.stiffness[:8])).deform(scene),
            in_torch.with_loading(all_alike).deform(scene),
        )
    torch.testing.assert_close(one, other, atol=2e-5, rtol=0)


def test_start_under_a_loading_is_that_of_the_twin(groom: Groom, bodies: BodyBatch) -> None:
    ready, loading = prepared(groom, bodies.body), Loading(2.5, (4.0, -3.0, -7.0))
    shape = empty_shape(len(bodies.body_pose), len(groom), 184, torch.float32)
    fill_initial_shape(ready.blocks, ready.blocks.strands.strand, compiled_body(bodies), loading, SHAPE, shape)
    expected = expected_shape(ready, bodies, loading)
    assert (shape.edges - expected.edges).abs().quantile(0.99) < 1e-4
    assert (shape.compliance - expected.compliance).abs().quantile(0.99) < 1e-4
    assert (shape.edges - initial_shape(ready, bodies).edges).norm(dim=-1).max() > 0.1


def test_loadings_that_no_hair_has_are_refused(model: Quaffure) -> None:
    for loading in (Loading(0.0), Loading(float("nan")), Loading(1.0, (0.0, 0.0, float("inf")))):
        with pytest.raises(InputError, match=r"stiffness|acceleration"):
            model.with_loading(loading)


def test_features_are_rounded_to_nearest(groom: Groom, bodies: BodyBatch) -> None:
    ready = prepared(groom, bodies.body, torch.full(groom.rest_strands.shape[:2], 0.004))
    exact = initial_shape(ready, bodies)
    rounded = exact._replace(features=torch.zeros(3, len(groom), 200, dtype=torch.bfloat16))
    fill_initial_shape(
        ready.blocks, ready.blocks.strands.strand, compiled_body(bodies), STANDARD_LOADING, SHAPE, rounded
    )
    assert torch.equal(rounded.features[..., :184], exact.features.bfloat16())
    assert rounded.features[..., 184:].count_nonzero() == 0


def test_a_folded_doubling_is_a_doubling_and_a_convolution() -> None:
    torch.manual_seed(0)
    texture, weight = torch.randn(2, 5, 8, 8), torch.randn(7, 5, 3, 3)
    doubled = torch.nn.functional.interpolate(texture, scale_factor=2)
    expected = torch.nn.functional.conv2d(doubled, weight, padding=1)
    folded = torch.nn.functional.conv_transpose2d(texture, folded_doubling(weight), stride=2, padding=1)
    torch.testing.assert_close(folded, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("is_fused", [True, False])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.bfloat16, 0.03)])
def test_the_network_laid_out_for_speed_is_the_same(
    network: DirectionNetwork, dtype: torch.dtype, tolerance: float, is_fused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if is_fused and not fused(dtype):
        pytest.skip("no fused layers here")
    monkeypatch.setattr(activated_layers, "fused", lambda dtype: is_fused)
    torch.manual_seed(1)
    inputs = NetworkInputs(
        torch.randn(16), torch.randperm(4096)[:50], torch.randn(2, 91 + FEATURE_COUNT + LOADING_FEATURES), no_features
    )
    features = 0.1 * torch.randn(2, 50, 184)
    fast = network.for_inference(dtype == torch.bfloat16)
    assert isinstance(fast, InferenceNetwork)
    textures = fast.decode_texture(inputs.groom_code.expand(2, -1), inputs.pose_code)
    texels = StrandTexels(inputs.texels, texture_rows(inputs.texels, 64), torch.arange(50))
    for sample, expected in enumerate(network(inputs, features)):
        memory = torch.empty(50, fast.columns, dtype=fast.dtype)
        memory[:, :184] = features[sample]
        changes = fast.changes(textures[sample], texels, memory, no_features)
        assert expected.abs().mean() > 0.05
        torch.testing.assert_close(changes.float(), expected.flatten(1), atol=tolerance, rtol=tolerance)


def test_a_torch_without_fused_layers_does_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(activated_layers, "_SILU", ("swish", [], "", "one more"))
    assert not fused.__wrapped__(torch.float32)


def test_operations_are_those_of_the_layers(network: DirectionNetwork) -> None:
    fast, (first, second, third) = network.for_inference(bf16=False), network.decoder.stages
    assert isinstance(fast, InferenceNetwork)
    dense = sum(layer.weight.numel() for layer in network.decoder.dense if isinstance(layer, torch.nn.Linear))
    convolutions = 64 * (first[1].weight.numel() + first[3].weight.numel())
    convolutions += 256 * (4 * second[1].weight.numel() // 9 + second[3].weight.numel())
    convolutions += 1024 * (4 * third[1].weight.numel() // 9 + third[3].weight.numel())
    convolutions += 1024 * network.decoder.to_texels[0].weight.numel()
    assert fast.operations(0) == 2 * (dense + convolutions)
    assert fast.operations(1) - fast.operations(0) == 2 * ((184 + 16) * 32 + 32 * 32 + 32 * 69)


def test_drape_is_deform(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    scene = Scene(groom, bodies)
    with torch.no_grad():
        expected = model.draper.deform(scene, projects=True)
    draped = model.drape(groom, bodies.body_pose, bodies.body_shape)
    assert (draped - scene.posed).norm(dim=-1).max() > 0.01
    torch.testing.assert_close(draped, expected, atol=CONTACT_ROUNDING, rtol=0)
    torch.testing.assert_close(draped[:, :, 0], scene.posed[:, :, 0], atol=2e-6, rtol=0)


def test_bfloat16_moves_vertices_by_fractions_of_a_millimetre(
    network: DirectionNetwork, groom: Groom, bodies: BodyBatch
) -> None:
    exact, rounded = (NeuralDraper(network, MATERIAL, bf16).drape(Scene(groom, bodies)) for bf16 in (False, True))
    moved = (exact - rounded).norm(dim=-1)
    assert 0 < moved.mean() < 1e-4


def test_a_drape_does_not_depend_on_what_else_is_draped(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    fewer = groom.select(torch.arange(0, 80, 3))
    grooms = [groom, fewer, groom]
    mixed = list(model.drape_many(grooms, bodies.body_pose, bodies.body_shape))
    for sample, (one, draped) in enumerate(zip(grooms, mixed)):
        row = slice(sample, sample + 1)
        alone = model.drape(one, bodies.body_pose[row], bodies.body_shape[row])[0]
        torch.testing.assert_close(draped, alone, atol=1e-6, rtol=0)


def test_many_grooms_are_draped_as_they_come(model: Quaffure, groom: Groom) -> None:
    taken = []

    def grooms() -> Iterator[Groom]:
        for index in range(3 * BATCH):
            taken.append(index)
            yield groom

    first = next(model.drape_many(grooms(), torch.zeros(1, 81), torch.zeros(1, 10)))
    assert len(taken) == BATCH
    torch.testing.assert_close(first, model.drape(groom, torch.zeros(1, 81), torch.zeros(1, 10))[0], atol=1e-6, rtol=0)


def test_rows_that_do_not_fit_are_refused(model: Quaffure, groom: Groom) -> None:
    with pytest.raises(InputError, match="a row for each groom, 3 or more, or a single one, found 2"):
        list(model.drape_many([groom] * 3, torch.zeros(2, 81), torch.zeros(1, 10)))
    with pytest.raises(InputError, match="a row for each groom, 1, or a single one, found 5"):
        list(model.drape_many([groom], torch.zeros(5, 81), torch.zeros(1, 10)))
    with pytest.raises(InputError, match="body_shape"):
        model.drape_many([groom], torch.zeros(1, 81), torch.zeros(1, 9))
    with pytest.raises(InputError, match="float32"):
        model.drape(replace(groom, rest_strands=groom.rest_strands.double()), torch.zeros(1, 81), torch.zeros(1, 10))
    with pytest.raises(InputError, match="texel"):
        list(model.drape_many([groom.select(torch.tensor([0, 0]))], torch.zeros(1, 81), torch.zeros(1, 10)))


def test_drapes_can_be_worked_on_with_gradients(model: Quaffure, groom: Groom, bodies: BodyBatch) -> None:
    draped = model.drape(groom, bodies.body_pose, bodies.body_shape).requires_grad_()
    draped.square().sum().backward()
    assert draped.grad is not None


def test_whatever_changes_is_seen_by_the_next_drape(groom: Groom, bodies: BodyBatch) -> None:
    torch.manual_seed(3)
    # One push: each further one enlarges the roundings.
    network = build_network(replace(CONFIG, projection=ProjectionConfig(pushes=1, push_relaxation=0.0)))
    draper, scene = NeuralDraper(network, MATERIAL), Scene(groom, bodies)
    drapes = [draper.drape(scene)]

    def moved() -> float:
        drapes.append(draper.drape(scene))
        with torch.no_grad():
            torch.testing.assert_close(drapes[-1], draper.deform(scene, projects=True), atol=CONTACT_ROUNDING, rtol=0)
        return float((drapes[-1] - drapes[-2]).norm(dim=-1).mean())

    with torch.no_grad():
        network.strand[-1].bias.add_(0.1)
    assert moved() > 1e-3
    halved = 0.5 * torch.nn.utils.parameters_to_vector(network.parameters())
    torch.nn.utils.vector_to_parameters(halved, network.parameters())
    assert moved() > 1e-3
    before = draper.drape(scene)
    draper.bf16 = True
    assert (draper.drape(scene) - before).norm(dim=-1).max() > 1e-6


def test_a_network_made_for_inference_drapes(groom: Groom, bodies: BodyBatch) -> None:
    with torch.inference_mode():
        draper = NeuralDraper(build_network(CONFIG), MATERIAL)
        inside = draper.drape(Scene(groom, bodies))
    torch.testing.assert_close(draper.drape(Scene(groom, bodies)), inside)


def test_a_torch_that_cannot_tell_of_amx_drapes_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(torch.cpu, "_is_amx_tile_supported", raising=False)
    assert not fast_bfloat16()
    assert load_model().draper.bf16 is False
