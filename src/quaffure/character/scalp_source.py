"""Which part of a character is its scalp: what a user names, what a hair mesh covers, or the shipped body's."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from quaffure.character.collision_surface import Triangles, distance_to
from quaffure.character.parts import Part, joined
from quaffure.character.scalp import (
    Scalp,
    TransferredScalp,
    around_roots,
    scalp_of_faces,
    scalp_of_transferred,
    under_hair,
    where_large,
)
from quaffure.character.scalp_check import face_areas, within_reach
from quaffure.errors import InputError

LEAST_COVER = 0.6
"""Share of the scalp that hair found by its name covers, from which it shows where the scalp is."""


class ScalpWish(NamedTuple):
    """What a user says of the scalp; one of them, or none.

    Attributes:
        name: of a mesh, a material, or an attribute of vertices.
        hair_mesh: name of a mesh or material of hair.
        roots: of a groom, in the body's space and the file's pose [m], its file, and how it was read.
    """

    name: str = ""
    hair_mesh: str = ""
    roots: tuple[Float[np.ndarray, "s 3"], str, str] | None = None


class HeadSurface(NamedTuple):
    """A surface on which a scalp is to be.

    Attributes:
        at_rest: in the body's rest pose.
        in_file: in the file's pose, in which parts and roots are.
        ears: vertices of its ears.
        transferred: the shipped body's scalp on `at_rest`.
    """

    at_rest: Triangles
    in_file: Triangles
    ears: Int[np.ndarray, " e"]
    transferred: TransferredScalp


def scalp_of(head: HeadSurface, parts: list[Part], wish: ScalpWish, source: str) -> tuple[Scalp, str]:
    """The scalp, and where it comes from, in words.

    Raises:
        InputError: what was asked for is no scalp.
    """
    apart = head.transferred.distance(head.at_rest.vertices[head.at_rest.faces].mean(1))
    if wish.name:
        option = f"--scalp {wish.name}"
        wanted = within_reach(_named_faces(head.in_file, parts, wish.name), apart, head.at_rest, option)
        return _asked_for(head, wanted, option, wish.name)
    if wish.roots is not None:
        roots, name, how = wish.roots
        wanted = around_roots(head.in_file, roots, apart)
        return _asked_for(head, wanted, name, f"around the roots of {name}{how}")
    shipped = scalp_of_transferred(head.transferred, head.at_rest, head.ears, source)
    hair = [part for part in parts if (part.is_called(wish.hair_mesh) if wish.hair_mesh else part.is_hair)]
    if not hair:
        return shipped, "scalp: that of the shipped body, transferred"
    inside = np.isin(np.arange(len(head.at_rest.faces)), shipped.faces)
    wanted = under_hair(head.in_file, mesh_of_parts(hair), inside, apart)
    if wish.hair_mesh:
        return _asked_for(head, wanted, f"--hair-mesh {wish.hair_mesh}", f"what {wish.hair_mesh} covers")
    return _found_by_name(head, wanted, shipped, ", ".join(dict.fromkeys(part.name for part in hair)))


def _asked_for(head: HeadSurface, wanted: Bool[np.ndarray, " k"], source: str, what: str) -> tuple[Scalp, str]:
    scalp, mended = scalp_of_faces(wanted, head.at_rest, head.ears, head.transferred, source)
    return scalp, "; ".join((f"scalp: {what}", *mended))


def _found_by_name(head: HeadSurface, covered: Bool[np.ndarray, " k"], shipped: Scalp, names: str) -> tuple[Scalp, str]:
    """The scalp under meshes that are called as hair is, if that is where a scalp can be; or else the shipped one."""
    otherwise = "scalp: that of the shipped body, transferred"
    area = face_areas(head.at_rest)[shipped.faces]
    share = float(area @ covered[shipped.faces] / area.sum())
    if share < LEAST_COVER:
        return shipped, f"{otherwise}: {names} covers {100 * share:.0f} % of it (--hair-mesh NAME takes that part)"
    try:
        return _asked_for(head, covered, names, f"what {names} covers, found by name")
    except InputError as error:
        return shipped, f"{otherwise}: {error}"


def _named_faces(surface: Triangles, parts: list[Part], name: str) -> Bool[np.ndarray, " k"]:
    """Faces of a surface where a mesh or material of a name is nearest, or an attribute of that name is large."""
    middles = surface.vertices[surface.faces].mean(1)
    named = [part for part in parts if part.is_called(name)]
    if named:
        others = [part for part in parts if part not in named]
        return distance_to(middles, mesh_of_parts(named)) <= (
            distance_to(middles, mesh_of_parts(others)) if others else np.inf
        )
    # Hair that is on the scalp would be nearer than it.
    bald = [part for part in parts if part.attribute(name) is not None or not part.is_hair]
    values = [np.zeros(len(part.vertices)) if (own := part.attribute(name)) is None else own for part in bald]
    return where_large(middles, mesh_of_parts(bald), np.concatenate(values))


def mesh_of_parts(parts: list[Part]) -> Triangles:
    """All of them as one mesh."""
    vertices, faces, _ = joined(tuple(parts))
    return Triangles(vertices, faces)
