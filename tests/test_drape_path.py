"""The path of one drape: how many functions it enters, what it runs, and what it can be differentiated in."""

import sys
from dataclasses import replace
from pathlib import Path
from types import FrameType

import pytest
import torch
from numba.core.dispatcher import Dispatcher
from torch import nn

import quaffure
from quaffure import HairMaterial
from quaffure.apps.cli.main import main
from quaffure.backend import Backend
from quaffure.body import FEATURE_COUNT, BodyModel, kinematics
from quaffure.energies import Loading
from quaffure.model import (
    DirectionNetwork,
    ForwardNetwork,
    InferenceNetwork,
    InitialShapeConfig,
    NetworkConfig,
    NetworkInputs,
    NeuralDraper,
    ProjectionConfig,
    Quaffure,
    load_model,
    load_network,
    save_network,
)
from quaffure.model.network_config import from_file_values
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.types import Tensor
from tests.scenes import random_bodies
from tests.training_runs import perturbed, tiny_groom

CONFIG = NetworkConfig(pose_features=FEATURE_COUNT, texel_channels=8, strand_width=16)
MATERIAL = HairMaterial()
PACKAGE = str(Path(quaffure.__file__).parent)
MOST_FUNCTIONS, MOST_KERNELS = 35, 10
FRAMES_AT_ONCE = 8


class Swirled(DirectionNetwork):
    """Another forward of the same layers: every edge is pushed to one side."""

    def forward(self, inputs: NetworkInputs, features: Tensor) -> Tensor:
        return super().forward(inputs, features) + torch.tensor([0.5, 0.0, 0.0])


@pytest.fixture(scope="module")
def scene(body: BodyModel) -> Scene:
    return Scene(tiny_groom(body), random_bodies(body, 2))


def network_of(kind: type[DirectionNetwork]) -> DirectionNetwork:
    torch.manual_seed(0)
    return perturbed(kind(CONFIG))


def is_compiled(frame: FrameType) -> bool:
    """Whether numba reports the call of a kernel, whose frame stands for no Python code."""
    module = next(each for each in [*sys.modules.values()] if getattr(each, "__file__", "") == frame.f_code.co_filename)
    return isinstance(getattr(module, frame.f_code.co_name, None), Dispatcher)


def test_one_drape_enters_few_functions(body: BodyModel) -> None:
    model = load_model(bf16=False)
    groom, shape = make_groom("bob", body).select(torch.arange(0, 2400, 30)), torch.zeros(1, 10)
    model.drape(groom, torch.zeros(1, 81), shape)
    functions, kernels = set(), set()

    def note(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE):
            name = code.co_filename.removeprefix(PACKAGE), code.co_qualname
            (kernels if is_compiled(frame) else functions).add(name)

    sys.setprofile(note)
    try:
        model.drape(groom, torch.full((1, 81), 0.1), shape)
    finally:
        sys.setprofile(None)
    print(f"one drape enters {len(functions)} Python functions:", *sorted(functions), sep="\n  ")
    print(f"and {len(kernels)} compiled kernels:", *sorted(kernels), sep="\n  ")
    assert 10 < len(functions) <= MOST_FUNCTIONS
    assert 5 < len(kernels) <= MOST_KERNELS


def test_a_subclass_drapes_with_its_own_forward(scene: Scene) -> None:
    plain, swirled = network_of(DirectionNetwork), network_of(Swirled)
    assert isinstance(plain.for_inference(bf16=False), InferenceNetwork)
    assert isinstance(swirled.for_inference(bf16=False), ForwardNetwork)
    draper = NeuralDraper(swirled, MATERIAL)
    hair, without = draper.drape(scene), NeuralDraper(plain, MATERIAL).drape(scene)
    assert (hair - without).norm(dim=-1).mean() > 1e-3
    only_contact = replace(CONFIG, contact=False)
    swirled.config = only_contact  # no projection, to compare with what a training sees
    draper = NeuralDraper(swirled, MATERIAL)
    with torch.no_grad():
        torch.testing.assert_close(draper.drape(scene), draper.deform(scene), atol=2e-5, rtol=0)


def test_an_assigned_method_is_noticed(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    network = network_of(DirectionNetwork)
    assert isinstance(network.for_inference(bf16=False), InferenceNetwork)
    monkeypatch.setattr(network, "rotations", lambda texels, features: features.new_ones(*features.shape[:2], 23, 3))
    assert isinstance(network.for_inference(bf16=False), ForwardNetwork)


@pytest.mark.parametrize("where", ["strand", "decoder"])
def test_a_replaced_layer_is_noticed(scene: Scene, where: str) -> None:
    network = network_of(DirectionNetwork)
    network.config = replace(CONFIG, contact=False)
    draper = NeuralDraper(network, MATERIAL)
    before = draper.drape(scene)
    if where == "strand":
        network.strand[2] = nn.Tanh()
    else:
        network.decoder.dense[1] = nn.ReLU()
    hair = draper.drape(scene)
    assert (hair - before).norm(dim=-1).max() > 1e-4
    with torch.no_grad():
        torch.testing.assert_close(hair, draper.deform(scene), atol=2e-5, rtol=0)


def test_a_subclass_drapes_in_bfloat16(scene: Scene) -> None:
    network = network_of(Swirled)
    exact, rounded = (NeuralDraper(network, MATERIAL, bf16).drape(scene) for bf16 in (False, True))
    assert 0 < (exact - rounded).norm(dim=-1).mean() < 1e-3


def test_both_backends_drape_alike(scene: Scene) -> None:
    few = Scene(scene.groom.select(torch.arange(0, 40, 8)), scene.bodies)
    network = network_of(DirectionNetwork)
    in_torch = NeuralDraper(network, MATERIAL, backend=Backend.TORCH)
    hair = in_torch.drape(few)
    assert (NeuralDraper(network, MATERIAL).drape(few) - hair).norm(dim=-1).quantile(0.95) < 1e-4
    rows = in_torch.drape_grooms([few.groom, few.groom.select(torch.arange(2))], scene.bodies)
    torch.testing.assert_close(rows[0], hair[:1], atol=1e-5, rtol=0)
    assert rows[1].shape == (1, 2, 24, 3)


@pytest.mark.parametrize("varied", ["pose", "shape", "stiffness"])
def test_torch_drapes_are_differentiable(body: BodyModel, varied: str) -> None:
    """Central differences through the whole drape but the projection, in double precision."""
    network, bodies = network_of(DirectionNetwork).double(), body.to("cpu", torch.float64)
    groom = tiny_groom(body).select(torch.arange(0, 40, 5)).to(torch.float64)
    generator = torch.Generator().manual_seed(1)
    values = {
        "pose": 0.15 * torch.randn(1, 81, generator=generator, dtype=torch.float64),
        "shape": torch.randn(1, 10, generator=generator, dtype=torch.float64),
        "stiffness": 0.5 + torch.rand(8, 23, generator=generator, dtype=torch.float64),
    }
    weights = torch.randn(1, 8, 24, 3, generator=generator, dtype=torch.float64)
    direction = torch.randn(values[varied].shape, generator=generator, dtype=torch.float64)

    def loss(step: float | Tensor) -> Tensor:
        now = values | {varied: values[varied] + step * direction}
        scene = Scene(groom, BodyBatch(bodies, now["pose"], now["shape"]))
        draper = NeuralDraper(network, MATERIAL).with_loading(Loading(now["stiffness"]))
        return (draper.deform(scene) * weights).sum()

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(loss(step), step)
    with torch.no_grad():
        difference = (loss(1e-6) - loss(-1e-6)) / 2e-6
    assert abs(float(difference)) > 1e-3
    assert float(gradient) == pytest.approx(float(difference), rel=1e-4)


def test_frames_are_posed_once(tiny_groom_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draping, writing and measuring share the joints; in batches of frames."""
    posed: list[int] = []
    compiled = kinematics.forward_kinematics
    monkeypatch.setattr(
        kinematics, "forward_kinematics", lambda pose, *rest: (posed.append(len(pose)), compiled(pose, *rest))[1]
    )
    # The network's groom is prepared at the rest pose, once, and not here.
    in_torch = BodyModel.forward_kinematics
    at_rest: list[bool] = []

    def torch_kinematics(body: BodyModel, pose: Tensor, joints: Tensor) -> tuple[Tensor, Tensor]:
        at_rest.append(bool((pose == 0).all()))
        return in_torch(body, pose, joints)

    monkeypatch.setattr(BodyModel, "forward_kinematics", torch_kinematics)
    outs = [str(tmp_path / name) for name in ("hair.npz", "hair.usda")]
    frames = FRAMES_AT_ONCE + 3
    main(
        [
            "drape",
            str(tiny_groom_file),
            "--draper",
            "neural",
            "--frames",
            f"0:{frames}",
            "--out",
            outs[0],
            "--out",
            outs[1],
            "--json",
        ]
    )
    assert posed == [FRAMES_AT_ONCE, 3]
    assert all(at_rest)


def test_settings_are_kept_with_the_weights(tmp_path: Path, scene: Scene) -> None:
    shape = InitialShapeConfig(passes=1, load_share=0.5)
    config = replace(CONFIG, initial_shape=shape, projection=ProjectionConfig(clearance_share=0.25, max_push=2.0))
    network = DirectionNetwork(config).eval()
    save_network(tmp_path / "n.safetensors", network, MATERIAL, {})
    loaded, *_ = load_network(tmp_path / "n.safetensors")
    assert loaded.config == config
    default = DirectionNetwork(CONFIG).eval()
    hair, other = (NeuralDraper(one, MATERIAL).drape(scene) for one in (loaded, default))
    assert (hair - other).norm(dim=-1).max() > 1e-3


def test_files_without_settings_have_those_of_before() -> None:
    config = from_file_values({"output": "directions", "views": False, "slides": False})
    assert config == NetworkConfig(skin_features=False, contact=False)
    assert "views=False, slides=False" in repr(config)
    with pytest.raises(ValueError, match="unknown"):
        from_file_values({"views": True, "sights": 3})


@pytest.mark.slow
def test_the_model_runs_on_the_backend_of_its_weights(scene: Scene) -> None:
    model = load_model()
    torch_draper = NeuralDraper(model.draper.network, model.draper.material, backend=Backend.TORCH)
    other = Quaffure(model.body, torch_draper, {})
    pose = scene.bodies.body_pose.clone().requires_grad_()
    hair = other.draper.deform(Scene(scene.groom, BodyBatch(model.body, pose, scene.bodies.body_shape)))
    (gradient,) = torch.autograd.grad(hair.square().sum(), pose)
    assert gradient.isfinite().all()
    assert gradient.abs().max() > 0
