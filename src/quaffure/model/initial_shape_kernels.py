"""The kernels before the network, a block of strands in the lanes of the processor's vectors.

`_estimate_contact_force` resolves contact of the cluster representatives alone, and `_resolve_contact` that of all
strands under these forces; their torch twin is in `quaffure.model.initial_shape`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from quaffure.geometry.mls_surface import FAST, LANES, UNROLL, record_points
from quaffure.hair.strand_blocks import StrandBlocks
from quaffure.model import initial_shape_lanes as lane


class BodyArrays(NamedTuple):
    """A batch of bodies in the head's frame, and what is common to all strands on them.

    Attributes:
        scalp: posed vertices [m].
        down: gravity's direction.
        points, normals: of the point-sampled body [m].
        radius, per_radius: of its points [m], and its inverse.
        weight: of a strand over k_Cosserat [1/m^2].
        propagated_share, load_share: see `quaffure.model.network_config.InitialShapeConfig`.
    """

    scalp: np.ndarray
    down: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    radius: np.float32
    per_radius: np.float32
    weight: np.float32
    propagated_share: np.float32
    load_share: np.float32


class _Points(NamedTuple):
    """Filled by `record_points`."""

    records: np.ndarray
    positions: np.ndarray


class ShapeArrays(NamedTuple):
    """Results of `resolve_contact`, see `quaffure.model.initial_shape.InitialShape`; features as bits."""

    roots: np.ndarray
    edges: np.ndarray
    compliance: np.ndarray
    features: np.ndarray


@njit(cache=True, error_model="numpy")
def initial_shape_kernel(
    strands: StrandBlocks, representatives: StrandBlocks, representative: np.ndarray, row_of: np.ndarray,
    body: BodyArrays, threads: int, shape: ShapeArrays,
) -> None:  # fmt: skip
    """Fill roots, edges, their compliance and the network's features.

    Args:
        representatives: strands of which contact forces are estimated.
        representative: [block, lane], lane among those of `representatives` of each strand's own.
        row_of: [block, lane], row of the results for each strand.
    """
    batch, count = body.points.shape[:2]
    points = _Points(np.zeros((batch, count + 1, 8), np.float32), np.empty((batch, 3, count), np.float32))
    record_points(body.points, body.normals, body.per_radius, points.records, points.positions)
    blocks, edges = representatives.edges.shape[:2]
    force = np.empty((batch, blocks, edges, 3 * LANES), np.float32)
    _estimate_contact_force(representatives, body, points, threads, force)
    _resolve_contact(strands, body, points, threads, force, representative, row_of, shape)


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _estimate_contact_force(
    strands: StrandBlocks, body: BodyArrays, points: _Points, threads: int, force: np.ndarray
) -> None:
    """Resolve contact as if nothing pushed, and fill the force of the skin on each edge (`propagate_contact_force`).

    Args:
        force: [body, block, edge, axis and lane], over k_Cosserat [1/m].
    """
    batch, blocks, count = len(body.scalp), len(strands.edges), strands.edges.shape[1]
    # Made outside of the parallel loop, where arrays are not counted: counting costs as much as evaluating.
    spaces = np.empty((threads, lane.ALL_ROWS), np.float32)
    contacts = np.empty((threads, count, lane.CONTACT_SIZE), np.float32)
    covers, flags = np.empty((threads, 4), np.float32), np.empty((threads, points.positions.shape[2]), np.uint8)
    lists, none = np.empty((threads, points.records.shape[1] + UNROLL), np.uint32), np.zeros(3 * LANES, np.float32)
    for thread in prange(threads):
        rows, contact, cover = spaces[thread], contacts[thread], covers[thread]
        inside, near = flags[thread], lists[thread]
        for item in range(thread, batch * blocks, threads):
            sample, block = item // blocks, item % blocks
            rest_edges, margin, down = strands.edges[block], strands.margin[block], body.down[sample]
            records, positions = points.records[sample], points.positions[sample]
            corners, barycentric, offset = strands.corners[block], strands.barycentric[block], strands.offset[block]
            lane.compute_roots(corners, barycentric, offset, body.scalp[sample], rows)
            lane.compute_lengths(rest_edges, rows)
            cover[3], listed = np.float32(-1.0), 0
            for edge in range(count):
                lane.aim(rest_edges[edge], down, body.weight, body.propagated_share, body.load_share, none, rows)
                listed = lane.evaluate_ends(records, positions, body.radius, cover, listed, inside, near, rows)
                lane.deflect(margin[edge], body.radius, rows)
                lane.record_contact(contact[edge], rows)
                lane.advance(rows)
            lane.propagate(contact, force[sample, block])


@njit(cache=True, parallel=True, fastmath=FAST, error_model="numpy")
def _resolve_contact(
    strands: StrandBlocks, body: BodyArrays, points: _Points, threads: int, force: np.ndarray,
    representative: np.ndarray, row_of: np.ndarray, shape: ShapeArrays,
) -> None:  # fmt: skip
    """Fill `shape` under the forces of the representatives, see `initial_shape_kernel`."""
    batch, blocks, count = len(body.scalp), len(row_of), strands.edges.shape[1]
    spaces, forces = np.empty((threads, lane.ALL_ROWS), np.float32), np.empty((threads, count, 3 * LANES), np.float32)
    covers, flags = np.empty((threads, 4), np.float32), np.empty((threads, points.positions.shape[2]), np.uint8)
    lists = np.empty((threads, points.records.shape[1] + UNROLL), np.uint32)
    for thread in prange(threads):
        rows, own_force, cover = spaces[thread], forces[thread], covers[thread]
        inside, near = flags[thread], lists[thread]
        for item in range(thread, batch * blocks, threads):
            sample, block = item // blocks, item % blocks
            own_rows, records, positions = row_of[block], points.records[sample], points.positions[sample]
            rest_edges, margin, down = strands.edges[block], strands.margin[block], body.down[sample]
            edges, features = shape.edges[sample], shape.features[sample]
            compliance, roots = shape.compliance[sample], shape.roots[sample]
            corners, barycentric, offset = strands.corners[block], strands.barycentric[block], strands.offset[block]
            lane.compute_roots(corners, barycentric, offset, body.scalp[sample], rows)
            for i in range(LANES):
                for axis in range(3):
                    roots[own_rows[i], axis] = rows[lane.VERTEX + axis * LANES + i]
            lane.gather(force[sample], representative[block], own_force)
            lane.compute_lengths(rest_edges, rows)
            cover[3], listed = np.float32(-1.0), 0
            for edge in range(count):
                pushed = own_force[edge]
                lane.aim(rest_edges[edge], down, body.weight, body.propagated_share, body.load_share, pushed, rows)
                listed = lane.evaluate_ends(records, positions, body.radius, cover, listed, inside, near, rows)
                lane.deflect(margin[edge], body.radius, rows)
                lane.advance(rows)
                lane.add_deflection(rows)
                for i in range(LANES):
                    compliance[own_rows[i], edge] = rows[lane.COMPLIANCE + i]
                    for axis in range(3):
                        edges[own_rows[i], edge, axis] = rows[lane.DIRECTION + axis * LANES + i]
                lane.write_features(rows, own_rows, edge, count, features)
