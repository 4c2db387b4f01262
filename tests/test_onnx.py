"""The network as ONNX gives torch's results, for any groom and any number of drapes."""

import os
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch

from quaffure import HairMaterial, InputError, load_groom, load_motion
from quaffure.body import load_body
from quaffure.model import NetworkConfig, NeuralDraper, build_network, load_model
from quaffure.model.drape_constants import write_drape_constants
from tests.training_runs import tiny_groom

pytest.importorskip("onnxscript")
onnxruntime = pytest.importorskip("onnxruntime")

from quaffure.model.onnx_network import (  # noqa: E402
    INPUTS,
    difference_from_torch,
    example_inputs,
    graphs_of,
    write_onnx,
)

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The file, and what the command said. In a process of its own: torch cannot trace the checks of array shapes."""
    path = tmp_path_factory.mktemp("onnx") / "network.onnx"
    command = [sys.executable, "-m", "quaffure", "export-onnx", "--groom", "bob", "--out", str(path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    return path, run.stdout


@pytest.mark.slow
def test_results_are_torchs(exported: tuple[Path, str]) -> None:
    path, said = exported
    assert "of torch's" in said
    network = load_model().draper.network
    names = [f"network.refinement_{number + 1}.onnx" for number in range(len(network.refinements))]
    assert sorted(file.name for file in path.parent.iterdir()) == ["network.npz", "network.onnx", *names]
    first, *_ = graphs_of(network)
    assert difference_from_torch(path, first) < 1e-5
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert [(one.name, len(one.shape)) for one in session.get_inputs()] == [*zip(INPUTS, (1, 1, 2, 3))]
    for batch, strands in ((1, 1), (4, 33)):
        inputs = example_inputs(network, batch, strands, seed=batch)
        found, channels = session.run(None, {name: values.numpy() for name, values in zip(INPUTS, inputs)})
        assert found.shape == (batch, strands, 23, 3)
        assert channels.shape == (batch, strands, network.config.texel_channels)
        assert np.abs(found).max() > 0.01
    network = deepcopy(network)
    network.from_strand.weight.data[0, 0] += 0.1
    assert difference_from_torch(path, graphs_of(network)[0]) > 1e-5


def test_the_papers_configuration_is_refused(tmp_path: Path) -> None:
    paper = build_network(NetworkConfig(output="displacement", contact=False))
    with pytest.raises(InputError, match="a network of edge directions"):
        write_onnx(tmp_path / "network.onnx", paper)


WITHOUT_TORCH = """
import sys
from pathlib import Path
import numpy as np
from examples import drape_without_torch
rows = np.load(sys.argv[2])
hair = [drape_without_torch.main(Path(sys.argv[1]), pose[None], shape[None]) for pose, shape in zip(*rows.values())]
assert not {"torch", "quaffure.model.neural"} & {*sys.modules}
np.save(sys.argv[3], np.stack(hair))
"""


@pytest.mark.slow
def test_a_drape_without_torch_is_that_of_the_model(exported: tuple[Path, str], tmp_path: Path) -> None:
    path, said = exported
    assert "the constants of a drape of bob" in said.replace("\n", " ")
    model, motion = load_model(bf16=False), load_motion("neck_turn")
    poses, generator = motion.body_pose[[0, 36]], torch.Generator().manual_seed(0)
    shapes = torch.randn(2, 10, generator=generator)
    np.savez(tmp_path / "rows.npz", body_pose=poses.numpy(), body_shape=shapes.numpy())
    command = [sys.executable, "-c", WITHOUT_TORCH, str(path), str(tmp_path / "rows.npz"), str(tmp_path / "hair.npy")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    found, expected = np.load(tmp_path / "hair.npy"), model.drape(load_groom("bob"), poses, shapes).numpy()
    assert np.abs(found - expected).max() < 5e-5
    assert np.abs(expected[0] - expected[1]).max() > 0.01


def test_networks_without_contact_have_no_constants(tmp_path: Path) -> None:
    draper = NeuralDraper(build_network(NetworkConfig(contact=False)), HairMaterial())
    body = load_body()
    with pytest.raises(InputError, match="contact and surroundings"):
        write_drape_constants(tmp_path / "constants.npz", draper, tiny_groom(body), body)
    assert list(tmp_path.iterdir()) == []
