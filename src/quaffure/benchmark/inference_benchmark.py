"""What a drape by the network costs: time against the number of grooms, its parts, and the floor of its arithmetic."""

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import cycle, islice

import torch

from quaffure.benchmark.machine_facts import machine_facts
from quaffure.body.clips import bundled_clip
from quaffure.body.collision_skin import collision_skin
from quaffure.body.head_frame import head_frame_body, posed_skin
from quaffure.geometry.mls_surface import mls_points
from quaffure.hair.groom import Groom
from quaffure.model.compiled_drape import BATCH, CompiledDrape
from quaffure.model.inference_network import InferenceNetwork
from quaffure.model.prepared_groom import PackedGroom
from quaffure.model.projection import project
from quaffure.model.quaffure_model import Quaffure
from quaffure.types import BodyPose

COUNTS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000)
QUICK_COUNTS = (1, 2, 4)
CLIP = "bow"
_MATRIX, _COPIED = 2048, 1 << 26  # side of the multiplied matrices; bytes of the copied array


@dataclass(frozen=True)
class Timing:
    """What so many drapes took, from codes and poses in to world-space strands out.

    Attributes:
        strands: of all grooms together.
        seconds, cpu_seconds: median wall and mean processor time of all of them.
        peak_megabytes: memory of the whole process at its highest so far; None where the system has no such counter.
    """

    grooms: int
    strands: int
    seconds: float
    cpu_seconds: float
    peak_megabytes: float | None


@dataclass(frozen=True)
class Floor:
    """What one drape would take if the network's arithmetic, or the moving of its numbers, were all [s].

    Attributes:
        operations: floating-point operations of the network.
        bytes_moved: weights, shared by a batch, what is known of the groom, every activation once in and once out.
        operations_per_second, bytes_per_second: measured here, multiplying and copying large matrices.
    """

    operations: float
    bytes_moved: float
    operations_per_second: float
    bytes_per_second: float

    @property
    def seconds(self) -> float:
        return max(self.operations / self.operations_per_second, self.bytes_moved / self.bytes_per_second)


def time_grooms(
    model: Quaffure,
    grooms: Sequence[Groom],
    counts: Sequence[int],
    on_count: Callable[[int], None] = lambda count: None,
) -> list[Timing]:
    """Drape so many grooms, taken in turn from `grooms` and prepared before, in poses spread over a clip.

    Args:
        on_count: called with what is about to run.
    """
    _warm_up(model, grooms)
    timings = []
    for count in counts:
        on_count(count)
        chosen, poses = list(islice(cycle(grooms), count)), _poses(model, count)

        def drape(chosen: Sequence[Groom] = chosen, poses: BodyPose = poses) -> None:
            for _ in model.drape_many(chosen, poses, torch.zeros(1, 10)):
                pass

        seconds, cpu_seconds = _timed(drape, repeats=max(3, 32 // count))
        timings.append(Timing(count, sum(map(len, chosen)), seconds, cpu_seconds, _peak_megabytes()))
    return timings


def time_strands(model: Quaffure, groom: Groom, shares: Sequence[float] = (0.25, 0.5, 1.0)) -> list[Timing]:
    """One drape of ever more strands of a groom."""
    timings = []
    for share in shares:
        strands = torch.linspace(0, len(groom) - 1, max(1, round(share * len(groom)))).long()
        timings += time_grooms(model, [groom.select(strands)], [1])
    return timings


def time_parts(model: Quaffure, groom: Groom) -> dict[str, float]:
    """Processor time [s] of the parts of one drape in a full batch, in the order in which they run."""
    compiled, packed = model.draper.compiled(), model.draper.packed(groom, model.body)
    poses, shapes = _poses(model, BATCH), torch.zeros(BATCH, 10)
    batch, view = [packed] * BATCH, head_frame_body(model.body, poses, shapes)
    one = head_frame_body(model.body, poses[:1], shapes[:1])
    records, texture = mls_points(one.surface), compiled.textures(batch, view)[0]
    buffers = compiled.buffers(len(packed.texels))
    start, draped = compiled.start(packed, one, records, buffers), torch.empty(groom.rest_strands.shape)
    answers = compiled.network.answers(texture, packed.texels, start.told[0])
    (vertices, heads), out = posed_skin(model.body, poses, shapes), torch.empty_like(draped)
    skin = (vertices[0], packed.rest_length, packed.clearance, collision_skin(model.body), heads[0])
    compiled.end(packed, start, answers, one, draped)
    parts: dict[str, tuple[Callable[[], object], int]] = {
        "body": (lambda: mls_points(head_frame_body(model.body, poses, shapes).surface), BATCH),
        "texture": (lambda: compiled.textures(batch, view), BATCH),
        "strands_before": (lambda: compiled.start(packed, one, records, buffers), 1),
        "strand_layers": (lambda: compiled.network.answers(texture, packed.texels, start.told[0]), 1),
        "strands_after": (lambda: compiled.end(packed, start, answers, one, draped), 1),
        "skin": (lambda: posed_skin(model.body, poses, shapes), BATCH),
        "out_of_skin": (lambda: project(draped, *skin, out), 1),
    }
    return {name: _timed(part, repeats=20)[1] / drapes for name, (part, drapes) in parts.items()}


def time_fitting(model: Quaffure, groom: Groom) -> float:
    """Processor time [s] of what is done once for a groom, before its first drape."""
    return _timed(lambda: model.draper.packed(groom.select(torch.arange(len(groom))), model.body), repeats=5)[1]


def floor(compiled: CompiledDrape, groom: PackedGroom) -> Floor:
    """See `Floor`; of one groom, which stands for all."""
    network, rows = compiled.network, len(groom.texels)
    dtype = network.dtype
    left, right = torch.randn(2, _MATRIX, _MATRIX, dtype=dtype)
    product = torch.empty_like(left)
    source = torch.ones(_COPIED // 4)
    target = torch.empty_like(source)
    multiply = _timed(lambda: torch.mm(left, right, out=product), repeats=5)[0]
    copy = _timed(lambda: target.copy_(source), repeats=5)[0]
    moved = _weight_bytes(network) / BATCH + _activation_bytes(network, rows) + groom.nbytes
    return Floor(network.operations(rows), moved, 2 * _MATRIX**3 / multiply, 2 * _COPIED / copy)


def report(
    model: Quaffure,
    timings: Sequence[Timing],
    strands: Sequence[Timing],
    parts: dict[str, float],
    fitting: float,
    least: Floor,
) -> dict[str, object]:
    """What `bench.json` holds."""
    return {
        "version": version("quaffure"),
        "machine": machine_facts() | {"precision": str(model.draper.compiled().network.dtype).removeprefix("torch.")},
        "grooms": [asdict(timing) for timing in timings],
        "strands": [asdict(timing) for timing in strands],
        "parts_cpu_milliseconds": {name: 1000 * seconds for name, seconds in parts.items()},
        "fitting_cpu_milliseconds": 1000 * fitting,
        "floor": asdict(least) | {"milliseconds": 1000 * least.seconds},
    }


def _warm_up(model: Quaffure, grooms: Sequence[Groom]) -> None:
    """Compile, prepare and encode before the clock starts."""
    for _ in model.drape_many(grooms, torch.zeros(1, 81), torch.zeros(1, 10)):
        pass


def _poses(model: Quaffure, count: int) -> BodyPose:
    poses = bundled_clip(CLIP, model.body).body_pose
    return poses[torch.linspace(0, len(poses) - 1, count).long()]


def _timed(run: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median wall time and mean processor time [s]."""
    run()
    walls, begun = [], time.process_time()
    for _ in range(repeats):
        wall = time.perf_counter()
        run()
        walls.append(time.perf_counter() - wall)
    # Of all together: what other threads take is counted some milliseconds late.
    return statistics.median(walls), (time.process_time() - begun) / repeats


def _weight_bytes(network: InferenceNetwork) -> int:
    return sum(values.nbytes for values in network.weights())


def _activation_bytes(network: InferenceNetwork, rows: int) -> int:
    return 2 * network.activations(rows) * network.dtype.itemsize


def _peak_megabytes() -> float | None:
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)
