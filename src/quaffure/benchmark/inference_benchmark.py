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
from quaffure.body.head_frame import HeadFrameBody, head_frame_body
from quaffure.body.kinematics import pose_joints
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.model.cpu_backend import BATCH, CpuBackend
from quaffure.model.inference_network import InferenceNetwork
from quaffure.model.pose_code import pose_code
from quaffure.model.quaffure_model import Quaffure
from quaffure.scene import BodyBatch
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


def inference_layout(model: Quaffure) -> InferenceNetwork:
    """The network as it is laid out for speed on the CPU.

    Raises:
        InputError: it is not laid out for speed.
    """
    backend = model.draper.backend()
    layout = backend.layout if isinstance(backend, CpuBackend) else None
    if not isinstance(layout, InferenceNetwork):
        raise InputError("weights", "a network that is compiled to drape", "another configuration")
    return layout


def time_parts(model: Quaffure, groom: Groom) -> dict[str, float]:
    """Processor time [s] of the parts of one drape in a full batch, in the order in which they run."""
    backend, prepared = model.draper.backend(), model.draper.prepared(groom, model.body)
    assert isinstance(backend, CpuBackend)
    bodies = BodyBatch(model.body, _poses(model, BATCH), torch.zeros(BATCH, 10))
    code, config = torch.stack([prepared.code] * BATCH), backend.config.initial_shape.body

    def pose(collides: bool) -> HeadFrameBody:
        joints = pose_joints(bodies.body, bodies.body_pose, bodies.body_shape)
        return head_frame_body(bodies.body, bodies.body_pose, bodies.body_shape, joints, config, collides)

    batch, (_, posed) = pose(False), next(backend.posed([prepared], bodies.rows(slice(0, 1))))
    codes = pose_code(backend.config, batch, model.draper.loading)
    shape = backend.initial_shape(prepared, posed)
    changes = backend.network(prepared, posed, shape)
    hair = backend.integrate(prepared, posed, shape, changes)
    parts: dict[str, tuple[Callable[[], object], int]] = {
        "body": (lambda: pose(False), BATCH),
        "texture": (lambda: backend.layout.decode_texture(code, codes), BATCH),
        "strands_before": (lambda: backend.initial_shape(prepared, posed), 1),
        "strand_layers": (lambda: backend.network(prepared, posed, shape), 1),
        "strands_after": (lambda: backend.integrate(prepared, posed, shape, changes), 1),
        "skin": (lambda: pose(True), BATCH),
        "out_of_skin": (lambda: backend.project(prepared, posed, hair), 1),
    }
    times = {name: _timed(part, repeats=20)[1] / drapes for name, (part, drapes) in parts.items()}
    return times | {"skin": max(times["skin"] - times["body"], 0.0)}  # posed together


def time_fitting(model: Quaffure, groom: Groom) -> float:
    """Processor time [s] of what is done once for a groom, before its first drape."""
    every = torch.arange(len(groom))
    return _timed(lambda: model.draper.prepared(groom.select(every), model.body).blocks, repeats=5)[1]


def floor(model: Quaffure, groom: Groom) -> Floor:
    """See `Floor`; of one groom, which stands for all."""
    network = inference_layout(model)
    prepared = model.draper.prepared(groom, model.body)
    rows = prepared.blocks.rows.size
    left, right = torch.randn(2, _MATRIX, _MATRIX, dtype=network.dtype)
    product = torch.empty_like(left)
    source = torch.ones(_COPIED // 4)
    target = torch.empty_like(source)
    multiply = _timed(lambda: torch.mm(left, right, out=product), repeats=5)[0]
    copy = _timed(lambda: target.copy_(source), repeats=5)[0]
    groom_bytes = prepared.blocks.nbytes
    weight_bytes = sum(values.nbytes for values in network.weights())
    activation_bytes = 2 * network.activations(rows) * network.dtype.itemsize
    moved = weight_bytes / BATCH + activation_bytes + groom_bytes
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
        "machine": machine_facts() | {"precision": str(inference_layout(model).dtype).removeprefix("torch.")},
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


def _peak_megabytes() -> float | None:
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)
