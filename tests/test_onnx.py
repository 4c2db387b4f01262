"""The network as ONNX gives torch's results, for any groom and any number of drapes."""

import os
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from quaffure.errors import InputError
from quaffure.model import NetworkConfig, build_network, load_model

pytest.importorskip("onnxscript")
onnxruntime = pytest.importorskip("onnxruntime")

from quaffure.model.onnx_network import INPUTS, difference_from_torch, example_inputs, write_onnx  # noqa: E402


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The file, and what the command said. In a process of its own: torch cannot trace the checks of array shapes."""
    path = tmp_path_factory.mktemp("onnx") / "network.onnx"
    command = [sys.executable, "-m", "quaffure", "export-onnx", "--out", str(path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    return path, run.stdout


@pytest.mark.slow
def test_results_are_torchs(exported: tuple[Path, str]) -> None:
    path, said = exported
    assert "of torch's" in said
    assert [file.name for file in path.parent.iterdir()] == ["network.onnx"]
    network = load_model().draper.network
    assert difference_from_torch(path, network) < 1e-5
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert [(one.name, len(one.shape)) for one in session.get_inputs()] == [*zip(INPUTS, (1, 1, 2, 3))]
    for batch, strands in ((1, 1), (4, 33)):
        inputs = example_inputs(network, batch, strands, seed=batch)
        (found,) = session.run(None, {name: values.numpy() for name, values in zip(INPUTS, inputs)})
        assert found.shape == (batch, strands, 23, 3)
        assert np.abs(found).max() > 0.01
    network = deepcopy(network)
    network.from_strand.weight.data[0, 0] += 0.1
    assert difference_from_torch(path, network) > 1e-5


def test_the_papers_configuration_is_refused(tmp_path: Path) -> None:
    paper = build_network(NetworkConfig(output="displacement", contact=False))
    with pytest.raises(InputError, match="a network of edge directions"):
        write_onnx(tmp_path / "network.onnx", paper)
