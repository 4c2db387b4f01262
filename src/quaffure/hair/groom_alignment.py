"""What a file's strands are before they are registered: which end is the root, which strands are a beard, and where
the head is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from quaffure.body.body_model import BodyModel
from quaffure.geometry.axes import axis_name
from quaffure.hair.file_frame import FileFrame
from quaffure.hair.head_alignment import Alignment, Similarity, align
from quaffure.hair.scalp_target import ScalpTarget, scalp_target, with_lower_face

OUTER_PART = 2 / 3  # of a strand, from where on its direction shows how the hair hangs
ROOT_PART = 0.01  # of a strand from its root on, whose direction shows whether it leaves the skin [m]
# Factor on the cost of a fit in which strands start into the head: one end of an afro is as round as the other.
INWARD_PENALTY = 2.0
# Strands are turned round, and a beard is seen, where the cost of the fit falls below this share.
LESS_TURNED, LESS_WITH_BEARD = 0.8, 0.6
# A root of a beard is on the lower face within the first distance and off the scalp by the second [m].
BEARD_REACH, BEARD_CLEARANCE = 0.02, 0.02
SMALLEST_BEARD = 0.03  # of the strands
# A single strand is turned round where its tip is on the scalp, and nearer to it than its root by so much [m].
TIP_ON_SCALP, TIP_NEARER = 0.01, 0.02
# Eyebrows: at most so high above the ears, so far before them and from the scalp at least, at most so long [m].
BROW_ABOVE_EAR, BROW_BEFORE_EAR, BROW_CLEARANCE, LONGEST_BROW = 0.025, 0.04, 0.025, 0.04


@dataclass(frozen=True)
class GroomAlignment:
    """Strands with known roots, and where they belong.

    Attributes:
        alignment: from the file to our body.
        polylines: the strands, roots first [file units].
        turned: whether the file stores the tips first.
        turned_strands: strands that are stored the other way round than the others.
        beard, eyebrow: whether a strand grows on the lower face, or is an eyebrow or an eyelash.
    """

    alignment: Alignment
    polylines: Float[np.ndarray, "s n 3"]
    turned: bool
    turned_strands: Bool[np.ndarray, " s"]
    beard: Bool[np.ndarray, " s"]
    eyebrow: Bool[np.ndarray, " s"]

    @property
    def on_scalp(self) -> Bool[np.ndarray, " s"]:
        """The strands that are no beard or eyebrow."""
        return ~(self.beard | self.eyebrow)


def align_groom(polylines: Float[np.ndarray, "s n 3"], body: BodyModel, frame: FileFrame) -> GroomAlignment:
    """Fit strands [file units], evenly spaced vertices along each, to the scalp, from either end, and find a beard,
    eyebrows and single strands that begin at their tips."""
    target = scalp_target(body)
    turned = polylines[:, ::-1]
    as_stored = align(polylines[:, 0], _hang(polylines), target, frame)
    highest_cost = LESS_TURNED * _cost_with_direction(as_stored, polylines, target)
    from_tips = align(turned[:, 0], _hang(turned), target, frame, highest_cost)
    is_turned = _cost_with_direction(from_tips, turned, target) < highest_cost
    found, alignment = (turned, from_tips) if is_turned else (polylines, as_stored)
    beard = np.zeros(len(found), dtype=bool)
    off_scalp = _distance(alignment.transform(found[:, 0]), target) > BEARD_CLEARANCE
    if off_scalp.mean() >= SMALLEST_BEARD:
        with_face = with_lower_face(target, body)
        bearded = align(found[:, 0], _hang(found), with_face, frame)
        on_face = _on_face(bearded.transform, found[:, 0], with_face)
        if on_face.mean() >= SMALLEST_BEARD and bearded.cost < LESS_WITH_BEARD * alignment.cost:
            alignment, beard = bearded, on_face
    return _with_details(alignment, found, is_turned, beard, body)


def standing_groom(polylines: Float[np.ndarray, "s n 3"], frame: FileFrame) -> GroomAlignment:
    """Strands [file units] that stand on this body already."""
    unit = frame.metres_per_unit() if frame.units else 1.0
    rotation = frame.registered_rotation()
    transform = Similarity(rotation, unit, np.zeros(3))
    alignment = Alignment(transform, frame.units or "m", axis_name(rotation[2]), 0.0)
    none = np.zeros(len(polylines), dtype=bool)
    return GroomAlignment(alignment, polylines, False, none, none, none)


def _with_details(
    alignment: Alignment,
    polylines: Float[np.ndarray, "s n 3"],
    turned: bool,
    beard: Bool[np.ndarray, " s"],
    body: BodyModel,
) -> GroomAlignment:
    """The alignment with single strands turned round that begin off the scalp and end on it, and with eyebrows."""
    target = scalp_target(body)
    placed = alignment.transform(polylines)
    single = ~beard & _begins_at_tip(placed[:, 0], placed[:, -1], body)
    found = np.where(single[:, None, None], polylines[:, ::-1], polylines)
    eyebrow = ~beard & _is_eyebrow(np.where(single[:, None, None], placed[:, ::-1], placed), target, body)
    return GroomAlignment(alignment, found, turned, single, beard, eyebrow)


def _begins_at_tip(
    first: Float[np.ndarray, "s 3"], last: Float[np.ndarray, "s 3"], body: BodyModel
) -> Bool[np.ndarray, " s"]:
    """Whether strands begin off the scalp and end on it, by their first and last points [m]."""
    target = scalp_target(body)
    start, end = _distance(first, target), _distance(last, target)
    return (end < TIP_ON_SCALP) & (start > end + TIP_NEARER)


def _is_eyebrow(placed: Float[np.ndarray, "s n 3"], target: ScalpTarget, body: BodyModel) -> Bool[np.ndarray, " s"]:
    """Short strands in front of the ears, at their upper half, and far below the hairline."""
    ear = body.rest_vertices[body.ear_vertices].double().numpy()
    x, y, z = placed[:, 0].T
    level = (z > ear[:, 2].mean()) & (z < ear[:, 2].max() + BROW_ABOVE_EAR)
    front = (y < ear[:, 1].min() - BROW_BEFORE_EAR) & (np.abs(x) < ear[:, 0].max())
    length = np.linalg.norm(np.diff(placed, axis=1), axis=-1).sum(1)
    return level & front & (length < LONGEST_BROW) & (_distance(placed[:, 0], target) > BROW_CLEARANCE)


def _hang(polylines: Float[np.ndarray, "s n 3"]) -> Float[np.ndarray, "3"]:
    """Mean unit direction of the strands' outer parts."""
    outer = polylines[:, -1] - polylines[:, int(OUTER_PART * polylines.shape[1])]
    return (outer / np.maximum(np.linalg.norm(outer, axis=1, keepdims=True), np.finfo(float).tiny)).mean(0)


def _cost_with_direction(alignment: Alignment, polylines: Float[np.ndarray, "s n 3"], target: ScalpTarget) -> float:
    """Cost of a fit, higher where strands start into the head on average."""
    placed = alignment.transform(polylines)
    edge = np.linalg.norm(placed[:, 1] - placed[:, 0], axis=1)
    vertex = np.clip(np.round(ROOT_PART / np.maximum(edge, np.finfo(float).tiny)), 1, placed.shape[1] - 1).astype(int)
    start = placed[np.arange(len(placed)), vertex] - placed[:, 0]
    normals = target.normals[target.tree.query(placed[:, 0])[1]]
    outwards = (start * normals).sum(1) / np.maximum(np.linalg.norm(start, axis=1), np.finfo(float).tiny)
    return alignment.cost * (INWARD_PENALTY if outwards.mean() < 0 else 1.0)


def _distance(points: Float[np.ndarray, "p 3"], target: ScalpTarget) -> Float[np.ndarray, " p"]:
    return target.tree.query(points)[0]


def _on_face(transform: Similarity, roots: Float[np.ndarray, "s 3"], with_face: ScalpTarget) -> Bool[np.ndarray, " s"]:
    placed = transform(roots)
    distance, nearest = with_face.tree.query(placed)
    near_scalp = cKDTree(with_face.scalp_points).query(placed)[0]
    return with_face.face[nearest] & (distance < BEARD_REACH) & (near_scalp > BEARD_CLEARANCE)
