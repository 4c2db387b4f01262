"""The network as ONNX, for runtimes without torch: decoder and strand layers, for any groom and any number of drapes.

Inputs and output are those of `DirectionNetwork.forward`, by name:

    groom_code [16]       code of the groom
    texels     [S]        int64, flat index of each strand's texel, row times 64 plus column
    pose_code  [B, C]     beta, theta without heading, pose features, loading (see `quaffure_network.pose_code`)
    features   [B, S, K]  each strand before the network (`quaffure.model.initial_shape.InitialShape`)
    rotations  [B, S, 23, 3]  of the joint before every edge, in units of its compliance
"""

import warnings
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

from quaffure.config import TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.io.atomic import replacing
from quaffure.model.groom_encoder import CODE_SIZE
from quaffure.model.inference_network import NetworkInputs
from quaffure.model.loading_features import LOADING_FEATURES
from quaffure.model.network_config import POSE_SIZE, SHAPE_SIZE
from quaffure.model.quaffure_network import DirectionNetwork, QuaffureNetwork, feature_size
from quaffure.types import Float, Int, Tensor

INPUTS, OUTPUT = ("groom_code", "texels", "pose_code", "features"), "rotations"
OPSET = 20
MOST_DIFFERENCE = 1e-5
"""Largest difference from torch, relative to the largest rotation or to 1."""

NetworkArrays = tuple[Tensor, Tensor, Tensor, Tensor]


def write_onnx(path: Path, network: QuaffureNetwork) -> float:
    """Write a network, and compare the file's results with torch's before it appears.

    Returns:
        The largest difference, relative to the largest rotation or to 1.

    Raises:
        InputError: the paper's configuration, not writable, or results that differ by more than `MOST_DIFFERENCE`.
    """
    if not isinstance(network, DirectionNetwork):
        raise InputError("--weights", "a network of edge directions", "the paper's configuration")
    with replacing(path) as temporary, torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about torch itself
        batch, strands = torch.export.Dim.DYNAMIC, torch.export.Dim.DYNAMIC
        program = torch.onnx.export(
            _Positional(network).eval(),
            example_inputs(network, batch=2, strands=5),
            dynamo=True,
            input_names=INPUTS,
            output_names=[OUTPUT],
            dynamic_shapes=({}, {0: strands}, {0: batch}, {0: batch, 1: strands}),
            opset_version=OPSET,
            verbose=False,
        )
        assert program is not None
        program.save(temporary)
        difference = difference_from_torch(temporary, network)
        if not difference <= MOST_DIFFERENCE:
            raise InputError(path, f"results within {MOST_DIFFERENCE:g} of torch's", f"{difference:.1e}")
    return difference


def difference_from_torch(path: Path, network: DirectionNetwork) -> float:
    """Largest difference of a file's results from the network's, relative to the largest rotation or to 1."""
    inputs = example_inputs(network, batch=3, strands=200, seed=1)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    (found,) = session.run([OUTPUT], {name: values.numpy() for name, values in zip(INPUTS, inputs)})
    with torch.no_grad():
        expected = _Positional(network).eval()(*inputs).numpy()
    return float(np.abs(found - expected).max() / max(1.0, np.abs(expected).max()))


def example_inputs(network: DirectionNetwork, batch: int, strands: int, seed: int = 0) -> NetworkArrays:
    """Random inputs of the sizes that drapes have."""
    generator = torch.Generator().manual_seed(seed)
    columns = SHAPE_SIZE + POSE_SIZE + network.config.pose_features + LOADING_FEATURES
    return (
        torch.randn(CODE_SIZE, generator=generator),
        torch.randint(0, TEXTURE_SIZE**2, (strands,), generator=generator),
        torch.rand(batch, columns, generator=generator) - 0.5,
        0.6 * torch.rand(batch, strands, feature_size(network.config), generator=generator) - 0.3,
    )


class _Positional(nn.Module):
    """The network with its inputs one by one."""

    def __init__(self, network: DirectionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        groom_code: Float[Tensor, "16"],
        texels: Int[Tensor, " s"],
        pose_code: Float[Tensor, "b code"],
        features: Float[Tensor, "b s columns"],
    ) -> Float[Tensor, "b s e 3"]:
        rotations: Tensor = self.network(NetworkInputs(groom_code, texels, pose_code), features)
        return rotations
