"""A character as a body: its skeleton, its skin as one closed surface, and its scalp."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int

from quaffure.body.body_model import SHAPE_COUNT, BodyModel
from quaffure.body.body_origin import BodyOrigin
from quaffure.body.character import Character
from quaffure.body.joint_map import JointMap
from quaffure.body.pose_features import HEAD
from quaffure.body.scalp import ScalpChart
from quaffure.character.collision_surface import CELL, Triangles, check_extent, closed_surface, closest_on, distance_to
from quaffure.character.groom_roots import roots_on
from quaffure.character.head_fit import HeadFit, fit_head
from quaffure.character.parts import Part, Parts, choose_parts, joined, parts_of
from quaffure.character.scalp import Scalp, ears_of, transferred_scalp
from quaffure.character.scalp_source import HeadSurface, ScalpWish, scalp_of
from quaffure.character.skeleton import FittedSkeleton, fit_skeleton
from quaffure.errors import InputError

MOST_JOINTS = 8
"""That move a vertex."""
FAR = 0.002
"""Distance from the skin beyond which the surface is said to be across an opening [m]."""
NEAR_HAIR = 0.5
"""Radius around the middle of the head in which the surface is compared with the skin [m]."""


@dataclass(frozen=True)
class ImportSettings:
    """What a user says of a character.

    Attributes:
        joint_map: which joints are which; by their names without one.
        scalp: name of a mesh or material that is the scalp, or of an attribute of vertices that is above
            `scalp.LEAST_VALUE` there.
        hair_mesh: name of a mesh or material of hair: the scalp is what it covers.
        roots: of a groom that was made on the character, in the axes and unit of either file, and its file.
        collide: names of meshes or materials that hair collides with, besides the skin.
        cell: of the grid on which the surface is made [m].
    """

    joint_map: JointMap | None = None
    scalp: str = ""
    hair_mesh: str = ""
    roots: tuple[Float[np.ndarray, "s 3"], str] | None = None
    collide: tuple[str, ...] = field(default=())
    cell: float = CELL


@dataclass(frozen=True)
class ImportedBody:
    """A body of a character, and what was guessed.

    Attributes:
        body: the body.
        joint_map: which joints are which.
        notes: the rest, in words.
    """

    body: BodyModel
    joint_map: JointMap
    notes: tuple[str, ...]


def import_body(
    character: Character,
    digest: str,
    template: BodyModel,
    settings: ImportSettings | None = None,
    on_step: Callable[[str], None] = lambda step: None,
) -> ImportedBody:
    """Make a body of a character.

    Args:
        digest: SHA-256 of the file.
        template: the shipped body.
        on_step: called with what is done next.

    Raises:
        InputError: no skin or head, joints of unknown names, or a scalp that is no disc.
    """
    settings = settings or ImportSettings()
    skeleton = fit_skeleton(character, template, settings.joint_map)
    all_parts = parts_of(character, skeleton)
    parts = choose_parts(all_parts, template.joint_names, character.source, settings.collide)
    _check_names(all_parts, settings, character.source)
    for part in (*parts.skin, *parts.inner, *parts.worn):
        check_extent(part.name, part.vertices, skeleton.file_joints, character.source)
    on_step("making one closed surface of the skin")
    middle, head_joint = _middle_of_head(parts, template), template.joint_names.index(HEAD)
    bare = (*parts.skin, *parts.inner)
    skin, surface, dense = _surface((*bare, *parts.worn), middle, settings.cell)
    on_step("placing the scalp")
    at_rest = Triangles(skeleton.to_rest_pose(surface.vertices, dense), surface.faces)
    on_head = dense[:, head_joint] > 0.5
    head_at_rest, of_head = at_rest, on_head
    hats = [part.name for part in parts.worn if (part.weights[:, head_joint] > 0.5).any()]
    if hats:
        # The size of a hat is not the head's.
        _, bald, moved_by = _surface(bare, middle, settings.cell)
        head_at_rest = Triangles(skeleton.to_rest_pose(bald.vertices, moved_by), bald.faces)
        of_head = moved_by[:, head_joint] > 0.5
    fit = fit_head(template, head_at_rest, of_head, character.source)
    ears = ears_of(at_rest, on_head, template, fit)
    head = HeadSurface(at_rest, surface, ears, transferred_scalp(template, at_rest, ears, fit))
    wish = _wish(settings, skeleton, Triangles(surface.vertices, surface.faces[on_head[surface.faces].all(1)]))
    scalp, scalp_note = scalp_of(head, all_parts, wish, character.source)
    hat_notes = [f"hair grows on the outside of {', '.join(hats)}"] if hats else []
    notes = (*_notes(skeleton, fit, surface, skin, middle), *parts.notes, scalp_note, *hat_notes)
    body = _body(template, at_rest, _strongest(dense), skeleton, ears, scalp, _origin(skeleton, character, digest))
    return ImportedBody(body, skeleton.joint_map, notes)


def _wish(settings: ImportSettings, skeleton: FittedSkeleton, head: Triangles) -> ScalpWish:
    if settings.roots is None:
        return ScalpWish(settings.scalp, settings.hair_mesh)
    roots, name = settings.roots
    placed, how = roots_on(head, roots, skeleton.in_body_space, name)
    return ScalpWish(roots=(placed, name, how))


def _surface(
    parts: tuple[Part, ...], middle: Float[np.ndarray, "3"], cell: float
) -> tuple[Triangles, Triangles, Float[np.ndarray, "v 27"]]:
    """Parts as one mesh, one closed surface of it, and the share of each joint in its vertices."""
    vertices, faces, weights = joined(parts)
    mesh = Triangles(vertices, faces)
    surface = closed_surface(mesh, middle, cell)
    face, barycentric, _ = closest_on(surface.vertices, mesh)
    joints, shares = _strongest((barycentric[..., None] * weights[faces[face]]).sum(1))
    dense = np.zeros((len(joints), weights.shape[1]))
    np.put_along_axis(dense, joints, shares, axis=1)
    return mesh, surface, dense


def _middle_of_head(parts: Parts, template: BodyModel) -> Float[np.ndarray, "3"]:
    head = template.joint_names.index(HEAD)
    points = np.concatenate([part.vertices[part.weights[:, head] > 0.5] for part in parts.skin])
    return 0.5 * (points.min(0) + points.max(0))


def _strongest(weights: Float[np.ndarray, "v 27"]) -> tuple[Int[np.ndarray, "v 8"], Float[np.ndarray, "v 8"]]:
    order = np.argsort(-weights, axis=1, kind="stable")[:, :MOST_JOINTS]
    shares = np.take_along_axis(weights, order, axis=1)
    return order, shares / shares.sum(1, keepdims=True)


def _check_names(parts: list[Part], settings: ImportSettings, source: str) -> None:
    """Refuse names that nothing has, before the work.

    Raises:
        InputError: lists those that there are.
    """
    meshes = ", ".join(dict.fromkeys(part.name for part in parts))
    if settings.hair_mesh and not any(part.is_called(settings.hair_mesh) for part in parts):
        raise InputError("--hair-mesh", f"a mesh or material of {source}: {meshes}", repr(settings.hair_mesh))
    name = settings.scalp
    if name and not any(part.is_called(name) or part.attribute(name) is not None for part in parts):
        known = ", ".join(dict.fromkeys(attribute for part in parts for attribute in part.attributes)) or "none"
        expected = f"a mesh or material of {source} ({meshes}) or an attribute of its vertices ({known})"
        raise InputError("--scalp", expected, repr(name))


def _notes(
    skeleton: FittedSkeleton, fit: HeadFit, surface: Triangles, skin: Triangles, middle: Float[np.ndarray, "3"]
) -> tuple[str, ...]:
    middles = surface.vertices[surface.faces].mean(1)
    near = np.linalg.norm(middles - middle, axis=1) < NEAR_HAIR
    distance = distance_to(middles[near], skin)
    scale = " x ".join(f"{value:.2f}" for value in fit.scale)
    unit = "" if skeleton.metres == 1 else f"; a unit of the file is {skeleton.metres:.3g} m"
    return (
        f"height {np.ptp(surface.vertices[:, 2]):.2f} m{unit}; the head is {scale} the shipped body's in width, depth, "
        "height",
        f"surface: {len(surface.vertices)} vertices; within {NEAR_HAIR:g} m of the head "
        f"{100 * (distance < FAR).mean():.1f} % of its triangles are within {1e3 * FAR:g} mm of the skin, the others "
        "across openings of it",
    )


def _origin(skeleton: FittedSkeleton, character: Character, digest: str) -> BodyOrigin:
    return BodyOrigin(
        scale=1.0 / skeleton.metres,
        rotation=skeleton.body_from_file.T,
        translation=skeleton.origin,
        source=Path(character.source).name,
        digest=digest,
        joint_nodes=skeleton.joint_nodes,
    )


def _body(
    template: BodyModel,
    surface: Triangles,
    skin: tuple[Int[np.ndarray, "v 8"], Float[np.ndarray, "v 8"]],
    skeleton: FittedSkeleton,
    ears: Int[np.ndarray, " e"],
    scalp: Scalp,
    origin: BodyOrigin,
) -> BodyModel:
    joints, shares = skin
    meta = {"source": origin.source, "units": "metres, z up, facing -y", "imported_by": "quaffure body import"}
    return BodyModel(
        rest_vertices=torch.from_numpy(surface.vertices).float(),
        shape_directions=torch.zeros(SHAPE_COUNT, len(surface.vertices), 3),
        rest_joints=torch.from_numpy(skeleton.rest_joints).float(),
        joint_shape_directions=torch.zeros(SHAPE_COUNT, len(skeleton.rest_joints), 3),
        joint_parents=template.joint_parents,
        joint_names=template.joint_names,
        skin_joints=torch.from_numpy(joints),
        skin_weights=torch.from_numpy(shares).float(),
        faces=torch.from_numpy(surface.faces.astype(np.int64)),
        ear_vertices=torch.from_numpy(ears.astype(np.int64)),
        scalp=ScalpChart(torch.from_numpy(scalp.faces), torch.from_numpy(scalp.uv).float()),
        meta=json.dumps(meta, ensure_ascii=False),
        origin=origin,
    )
