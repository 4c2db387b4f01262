"""The kernel before the network, a block of strands in the lanes of the processor's vectors.

Its torch twin is `quaffure.model.initial_shape.initial_shape_reference`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from quaffure.geometry.mls_kernels import FAST, LANES, UNROLL, record_points
from quaffure.hair.block_arrays import StrandBlocks
from quaffure.model import free_rod_lanes as rod
from quaffure.model import initial_shape_lanes as lane
from quaffure.model.bend_relaxation_lanes import relax_bends


class RodBlocks(NamedTuple):
    """`quaffure.model.prepared_groom.DesignRods` in the blocks of `StrandBlocks`."""

    moment: Float[np.ndarray, "block e 3 lane"]
    support: Float[np.ndarray, "block e 3 lane"]
    upness: Float[np.ndarray, "block e lane"]
    mass: Float[np.ndarray, "block e lane"]
    bending: Float[np.ndarray, "block e lane"]
    goal: Float[np.ndarray, "block e lane"]
    compliance: Float[np.ndarray, "block e lane"]


class BodyArrays(NamedTuple):
    """A batch of bodies in the head's frame, and what is common to all strands on them.

    Attributes:
        scalp: posed vertices [m].
        pull: acceleration [g].
        points, normals: of the point-sampled body [m].
        radius, per_radius: of its points [m], and its inverse.
        stiffness: of all joints.
        least_disturbance: squared rotation at which strands comply by half.
        decay_length: see `resolve_contact_reference` [m].
        tied_share: of the compliance of tied strands.
        bend_relaxation: see `quaffure.model.bend_relaxation`.
    """

    scalp: np.ndarray
    pull: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    radius: np.float32
    per_radius: np.float32
    stiffness: np.float32
    least_disturbance: np.float32
    decay_length: np.float32
    tied_share: np.float32
    bend_relaxation: np.float32


class ShapeArrays(NamedTuple):
    """Results of `initial_shape_kernel`, see `quaffure.model.initial_shape.InitialShape`; features as bits."""

    roots: np.ndarray
    edges: np.ndarray
    compliance: np.ndarray
    features: np.ndarray


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def initial_shape_kernel(
    strands: StrandBlocks, rods: RodBlocks, row_of: np.ndarray, body: BodyArrays, passes: int, threads: int,
    shape: ShapeArrays,
) -> None:  # fmt: skip
    """Fill roots, edges, their compliance and the network's features.

    Args:
        row_of: [block, lane], row of the results for each strand.
        passes: without contact.
    """
    batch, points = body.points.shape[:2]
    records, positions = np.zeros((batch, points + 1, 8), np.float32), np.empty((batch, 3, points), np.float32)
    record_points(body.points, body.normals, body.per_radius, records, positions)
    blocks, count = len(row_of), strands.edges.shape[1]
    # Made outside of the parallel loop, where arrays are not counted: counting costs as much as evaluating.
    spaces, inputs = (
        np.empty((threads, lane.ALL_ROWS), np.float32),
        np.empty((threads, count, rod.INPUTS, LANES), np.float32),
    )
    states = np.empty((threads, count, rod.STATE, LANES), np.float32)
    passed = np.empty((threads, rod.PASSED, LANES), np.float32)
    covers, flags = np.empty((threads, 4), np.float32), np.empty((threads, points), np.uint8)
    lists = np.empty((threads, points + 1 + UNROLL), np.uint32)
    for thread in prange(threads):
        rows, cover, inside, near = spaces[thread], covers[thread], flags[thread], lists[thread]
        for item in range(thread, batch * blocks, threads):
            sample, block = item // blocks, item % blocks
            own_rows, own_records, own_positions = row_of[block], records[sample], positions[sample]
            margin, edges, features = strands.margin[block], shape.edges[sample], shape.features[sample]
            compliance, roots, own = shape.compliance[sample], shape.roots[sample], inputs[thread]
            corners, barycentric, offset = strands.corners[block], strands.barycentric[block], strands.offset[block]
            anchor, tie = strands.anchor[block], strands.tie[block]
            lane.compute_roots(corners, barycentric, offset, anchor, tie, body.scalp[sample], rows)
            for i in range(LANES):
                for axis in range(3):
                    roots[own_rows[i], axis] = rows[lane.VERTEX + axis * LANES + i]
            for edge in range(count):
                loads = rods.moment[block, edge], rods.support[block, edge], rods.upness[block, edge]
                joint = rods.mass[block, edge], rods.bending[block, edge], rods.goal[block, edge]
                lane.load(strands.edges[block, edge], loads, joint, body.pull[sample], body.stiffness, rows, own[edge])
            rod.relax(own, passes, states[thread], passed[thread])
            # A literal would be a type of its own, for which `evaluate_ends` is compiled again.
            cover[3], listed = np.float32(-1.0), int(np.int64(0))
            for edge in range(count):
                lane.aim(own[edge], rows)
                listed = lane.evaluate_ends(own_records, own_positions, body.radius, cover, listed, inside, near, rows)
                lane.deflect(margin[edge], body.radius, body.decay_length, rows)
                lane.advance(rows)
                lane.comply(rods.compliance[block, edge], own[edge], body.pull[sample], body.stiffness, rows)
                for i in range(LANES):
                    compliance[own_rows[i], edge] = rows[lane.COMPLIANCE + i]
                lane.write_local_features(rows, own_rows, edge, count, features)
            lane.fade(own_rows, anchor, body.least_disturbance, body.tied_share, rows, compliance)
            if body.bend_relaxation > 0:
                relax_bends(own, body.bend_relaxation, states[thread], passed[thread])
            lane.write_edges(own, own_rows, roots, rows, edges, features)
