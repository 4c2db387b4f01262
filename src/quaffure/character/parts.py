"""The meshes of a character, part by part: which are its skin, and what else there is."""

from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay, QhullError, cKDTree

from quaffure.body.character import Character
from quaffure.body.hair_names import is_hair_name
from quaffure.body.joint_map import SIDES
from quaffure.body.pose_features import HEAD
from quaffure.character.skeleton import FittedSkeleton
from quaffure.errors import InputError

REGIONS = {
    "head": (HEAD,),
    "torso": ("Neck", "Spine1", "Spine", "LowerBack"),
    "arms": tuple(f"{side}{joint}" for side in SIDES for joint in ("Arm", "ForeArm", "Hand", "FingerBase")),
    "legs": tuple(f"{side}{joint}" for side in SIDES for joint in ("UpLeg", "Leg", "Foot")),
}
"""Regions of the skin, and the joints that move them, in the order in which parts are chosen."""
LEAST_AREA = 0.02
"""Least area of skin on a head [m^2]."""
ENOUGH = 0.5
"""Share of the area of the part that covers most of a region, from which a part that is skin already is enough."""
SEAM, LEAST_SEAM = 1e-5, 3
"""Distance of vertices that two materials of a mesh share [m], and how many they share where they are one skin."""
LARGEST_INNER, INNER_SHARE = 0.5, 0.6
"""Extent of eyes, teeth and tongues, in extents of the head, and the share of their vertices in the convex hull of its
skin. Upper teeth with a palate take 0.4."""


@dataclass(frozen=True, eq=False)
class Part:
    """The faces of a mesh that share a material.

    Attributes:
        mesh, material: names.
        vertices: in the body's space, in the file's rest pose [m].
        faces: triangles.
        weights: share of each joint of the body.
        attributes: further numbers of the vertices, by name.
    """

    mesh: str
    material: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "k 3"]
    weights: Float[np.ndarray, "v 27"]
    attributes: dict[str, Float[np.ndarray, " v"]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.mesh if not self.material else f"{self.mesh} ({self.material})"

    def is_called(self, pattern: str) -> bool:
        """Whether the mesh or the material has this name; * and ? stand for any letters, and case does not matter."""
        return any(fnmatchcase(name.lower(), pattern.lower()) for name in (self.mesh, self.material))

    def attribute(self, pattern: str) -> Float[np.ndarray, " v"] | None:
        """Numbers of the vertices that have this name, with or without the underscore that glTF puts before it; * and ?
        stand for any letters, and case does not matter."""
        for name, values in self.attributes.items():
            if any(fnmatchcase(each.lower(), pattern.lower()) for each in (name, name.removeprefix("_"))):
                return values
        return None

    @property
    def is_hair(self) -> bool:
        """Whether mesh or material are called as hair is."""
        return is_hair_name(self.mesh) or is_hair_name(self.material)

    def area(self, joints: list[int]) -> float:
        """Area of the triangles, each times the share of these joints in it [m^2]."""
        corners = self.vertices[self.faces]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return float(area @ self.weights[:, joints].sum(1)[self.faces].mean(1))


@dataclass(frozen=True)
class Parts:
    """Parts by what they are.

    Attributes:
        skin: of the figure.
        inner: eyes, teeth and tongue, which fill the cavities of the skin.
        worn: what hair collides with besides them.
        notes: what was chosen, in words.
    """

    skin: tuple[Part, ...]
    inner: tuple[Part, ...]
    worn: tuple[Part, ...]
    notes: tuple[str, ...]


def parts_of(character: Character, skeleton: FittedSkeleton) -> list[Part]:
    """All parts of all meshes with faces."""
    parts = []
    for mesh in character.meshes:
        vertices = skeleton.in_body_space(mesh.vertices)
        weights = skeleton.dense_weights(mesh.joints, mesh.weights)
        for index, material in enumerate(mesh.materials):
            used, faces = np.unique(mesh.faces[mesh.face_materials == index], return_inverse=True)
            if len(used):
                attributes = {name: values[used] for name, values in mesh.attributes.items()}
                parts.append(Part(mesh.name, material, vertices[used], faces.reshape(-1, 3), weights[used], attributes))
    return parts


def choose_parts(parts: list[Part], joint_names: tuple[str, ...], source: str, collide: tuple[str, ...] = ()) -> Parts:
    """Skin by the weights of head, torso, arms and legs; hair by its name; eyes and teeth by where they are.

    Args:
        source: the file, for errors.
        collide: names of further meshes or materials that hair collides with.

    Raises:
        InputError: no mesh that the head moves, or a name to collide with that nothing has.
    """
    hair = [part for part in parts if part.is_hair]
    candidates = [part for part in parts if not part.is_hair]
    skin: list[Part] = []
    notes = []
    for region, names in REGIONS.items():
        areas = {part: part.area([joint_names.index(name) for name in names]) for part in candidates}
        largest = max(areas, key=lambda part: areas[part], default=None)
        if region == "head" and (largest is None or areas[largest] < LEAST_AREA):
            found = ", ".join(part.name for part in parts) or "no meshes"
            raise InputError(source, "a skinned mesh that the head moves, other than hair", found)
        if largest is None or any(areas[part] > ENOUGH * areas[largest] for part in skin) or not areas[largest]:
            continue
        skin.append(largest)
    skin += _connected(candidates, skin)
    inner = _inner([part for part in candidates if part not in skin], skin, joint_names.index(HEAD))
    worn: list[Part] = []
    for pattern in collide:
        named = [part for part in parts if part.is_called(pattern)]
        if not named:
            raise InputError("--collide", f"a mesh or material of {source}: {_names(parts)}", repr(pattern))
        worn += [part for part in named if part not in (*skin, *inner, *worn)]
    others = [part for part in candidates if part not in (*skin, *inner)]
    groups = {
        "skin": skin, "in the head": inner, "hair collides with": worn, "hair, left out": hair,
        "left out (--collide NAME)": others,
    }  # fmt: skip
    for what, group in groups.items():
        left = [part for part in group if part not in worn or group is worn]
        if left:
            notes.append(f"{what}: {_names(left)}")
    return Parts(tuple(skin), tuple(inner), tuple(worn), tuple(notes))


def joined(parts: tuple[Part, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [v, 3], faces [k, 3] and weights [v, 27] of several parts."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return (
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts)]),
        np.concatenate([part.weights for part in parts]),
    )


def _connected(parts: list[Part], skin: list[Part]) -> list[Part]:
    """Further materials of meshes that are skin, which continue it: a scalp of its own, for instance."""
    found: list[Part] = []
    while True:
        known = [*skin, *found]
        places = cKDTree(np.concatenate([part.vertices for part in known]))
        meshes = {part.mesh for part in known}
        more = [part for part in parts if part.mesh in meshes and part not in known and _touches(part, places)]
        if not more:
            return found
        found += more


def _touches(part: Part, places: cKDTree) -> bool:
    distance, _ = places.query(part.vertices, distance_upper_bound=SEAM)
    return bool((distance < SEAM).sum() >= LEAST_SEAM)


def _inner(parts: list[Part], skin: list[Part], head: int) -> list[Part]:
    """The parts that are small and inside the head."""
    points = np.concatenate([each.vertices[each.weights[:, head] > 0.5] for each in skin])
    try:
        hull = Delaunay(points)
    except QhullError:
        return []
    largest = LARGEST_INNER * np.ptp(points, axis=0).max()
    small = [part for part in parts if np.ptp(part.vertices, axis=0).max() < largest]
    return [part for part in small if (hull.find_simplex(part.vertices) >= 0).mean() > INNER_SHARE]


def _names(parts: list[Part]) -> str:
    return ", ".join(dict.fromkeys(part.name for part in parts))
