"""The network as ONNX, for runtimes without torch: decoder and strand layers, for any groom and any number of drapes.

`network.onnx` is the network before its refinements; inputs and outputs by name:

    groom_code [16]       code of the groom
    texels     [S]        int64, flat index of each strand's texel, row times 64 plus column
    pose_code  [B, C]     beta, theta without heading, pose features, loading (see `quaffure.model.pose_code`)
    features   [B, S, K]  each strand before the network (`quaffure.model.initial_shape.InitialShape`)
    rotations  [B, S, 23, 3]  of the joint before every edge, in units of its compliance
    channels   [B, S, T]  of each strand's texel

`network.refinement_1.onnx` and so on are the refinements, which read where hair is after the rotations so far:

    channels, rotations   as above
    features   [B, S, K]  after these rotations (`TorchBackend.features_after`)
    change     [B, S, 23, 3]  to be added to the rotations
"""

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnxruntime
import torch
from torch import nn

from quaffure.config import EDGES_PER_STRAND, TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.io.atomic import replacing_together
from quaffure.model.groom_encoder import CODE_SIZE
from quaffure.model.inference_network import NetworkInputs, no_features
from quaffure.model.pose_code import code_size
from quaffure.model.quaffure_network import DirectionNetwork, QuaffureNetwork
from quaffure.model.strand_layers import feature_size
from quaffure.types import Float, Int, Tensor

INPUTS, OUTPUTS = ("groom_code", "texels", "pose_code", "features"), ("rotations", "channels")
REFINEMENT_INPUTS, REFINEMENT_OUTPUT = ("channels", "features", "rotations"), "change"
OPSET = 20
MOST_DIFFERENCE = 3e-5
"""Largest difference from torch, relative to the largest number or to 1."""

Arrays = tuple[Tensor, ...]


def refinement_path(path: Path, number: int) -> Path:
    """File of a refinement, from 1."""
    return path.with_suffix(f".refinement_{number}.onnx")


def write_onnx(path: Path, network: QuaffureNetwork) -> tuple[list[Path], float]:
    """Write a network and its refinements, and compare each file's results with torch's before it appears.

    Returns:
        The files, and the largest difference, relative to the largest number or to 1.

    Raises:
        InputError: the paper's configuration, not writable, or results that differ by more than `MOST_DIFFERENCE`.
    """
    if not isinstance(network, DirectionNetwork):
        raise InputError("--weights", "a network of edge directions", "the paper's configuration")
    graphs = graphs_of(network)
    paths = [path, *(refinement_path(path, number) for number in range(1, len(graphs)))]
    with replacing_together(*paths) as temporaries:
        return paths, max(_write(*file) for file in zip(paths, temporaries, graphs))


class Graph(NamedTuple):
    """A part of the network that is a file of its own.

    Attributes:
        inputs: random ones of the sizes that drapes have, for a batch, a number of strands and a seed.
        dynamic: axes of each input whose size is any: 0 of the batch, 1 of the strands.
    """

    module: nn.Module
    names: tuple[str, ...]
    outputs: tuple[str, ...]
    dynamic: tuple[dict[int, str], ...]
    inputs: Callable[[int, int, int], Arrays]


def graphs_of(network: DirectionNetwork) -> list[Graph]:
    """The network before its refinements, and these."""
    batch, both = {0: "batch"}, {0: "batch", 1: "strands"}
    first = Graph(_First(network), INPUTS, OUTPUTS, ({}, {0: "strands"}, batch, both), partial(example_inputs, network))
    refinements = [
        Graph(
            refinement,
            REFINEMENT_INPUTS,
            (REFINEMENT_OUTPUT,),
            (both, both, both),
            partial(_refinement_inputs, network),
        )
        for refinement in network.refinements
    ]
    return [first, *refinements]


def _write(path: Path, temporary: Path, graph: Graph) -> float:
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about torch itself
        program = torch.onnx.export(
            graph.module.eval(),
            graph.inputs(2, 5, 0),
            dynamo=True,
            input_names=graph.names,
            output_names=graph.outputs,
            dynamic_shapes=tuple(dict.fromkeys(axes, torch.export.Dim.DYNAMIC) for axes in graph.dynamic),
            opset_version=OPSET,
            verbose=False,
        )
        assert program is not None
        program.save(temporary)
        difference = difference_from_torch(temporary, graph)
        if not difference <= MOST_DIFFERENCE:
            raise InputError(path, f"results within {MOST_DIFFERENCE:g} of torch's", f"{difference:.1e}")
    return difference


def difference_from_torch(path: Path, graph: Graph) -> float:
    """Largest difference of a file's results from those of the layers, relative to the largest number or to 1."""
    inputs = graph.inputs(3, 200, 1)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    found = session.run(list(graph.outputs), {name: values.numpy() for name, values in zip(graph.names, inputs)})
    with torch.no_grad():
        results = graph.module.eval()(*inputs)
    expected = [values.numpy() for values in (results if isinstance(results, tuple) else (results,))]
    return max(float(np.abs(a - b).max() / max(1.0, np.abs(b).max())) for a, b in zip(found, expected))


def example_inputs(network: DirectionNetwork, batch: int, strands: int, seed: int = 0) -> Arrays:
    """Random inputs of the sizes that drapes have."""
    generator = torch.Generator().manual_seed(seed)
    return (
        torch.randn(CODE_SIZE, generator=generator),
        torch.randint(0, TEXTURE_SIZE**2, (strands,), generator=generator),
        torch.rand(batch, code_size(network.config), generator=generator) - 0.5,
        0.6 * torch.rand(batch, strands, feature_size(network.config), generator=generator) - 0.3,
    )


def _refinement_inputs(network: DirectionNetwork, batch: int, strands: int, seed: int) -> Arrays:
    generator, config = torch.Generator().manual_seed(seed), network.config
    return (
        torch.randn(batch, strands, config.texel_channels, generator=generator),
        0.6 * torch.rand(batch, strands, feature_size(config), generator=generator) - 0.3,
        torch.randn(batch, strands, EDGES_PER_STRAND, 3, generator=generator),
    )


class _First(nn.Module):
    """The network before its refinements, with its inputs one by one."""

    def __init__(self, network: DirectionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self,
        groom_code: Float[Tensor, "16"],
        texels: Int[Tensor, " s"],
        pose_code: Float[Tensor, "b code"],
        features: Float[Tensor, "b s columns"],
    ) -> tuple[Float[Tensor, "b s e 3"], Float[Tensor, "b s channels"]]:
        channels = self.network.texels(NetworkInputs(groom_code, texels, pose_code, no_features))
        return self.network.rotations(channels, features), channels
