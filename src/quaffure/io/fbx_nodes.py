"""Models of an FBX file as nodes: their transforms at rest, in the axes and the unit of glTF.

A model's transform is T Roff Rp Rpre R Rpost^-1 Rp^-1 Soff Sp S Sp^-1 (Autodesk, "Computing transformation matrices"):
translation, rotation and scale about pivots, with rotations before and after it. As a matrix that is a rotation
Rpre R Rpost^-1, factors along its own axes, and a translation.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.body.character import CharacterNodes, decomposed, local_matrices, parents_first
from quaffure.io.character_limits import MOST_NODES
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.fbx_document import SCENE, FbxDocument, FbxObject

ORDERS = ("xyz", "xzy", "yzx", "yxz", "zxy", "zyx")
"""Axes of a rotation by number, in the order in which the figure is turned about those of its parent."""
ROOT = "RootNode"
"""Name of the node above all models, which takes the file's axes and unit to those of glTF."""
INHERIT_RRSS, INHERIT_RSRS, INHERIT_RRS = 0, 1, 2
"""How a model inherits scale (InheritType): RrSs, along its own axes; RSrs, along those of the models above, by matrix
multiplication; Rrs, without the scale of its parent."""
SCALE_TOLERANCE = 1e-3
ANY, UNIFORM, CONSTANT = range(3)
"""How scales may be animated above nodes that do not inherit them by matrix multiplication."""

Vectors = Float[np.ndarray, "f 3"]


@dataclass(frozen=True, eq=False)
class FbxTransform:
    """The transform of a model.

    Attributes:
        translation: at rest [units of the file]. Translation, rotation and scale can be animated.
        rotation: at rest, about three axes [degrees].
        scale: factors at rest.
        order: of the rotations about these axes, one of `ORDERS`.
        before, after: rotations before and after it: Rpre and the inverse of Rpost.
        rotation_pivot, scaling_pivot: points that rotation and scale leave where they are [units of the file].
        rotation_offset, scaling_offset: translations before the pivots [units of the file].
        parent_scale: factor by which the scale is divided.
    """

    translation: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3"]
    scale: Float[np.ndarray, "3"]
    order: str
    before: Rotation
    after: Rotation
    rotation_pivot: Float[np.ndarray, "3"]
    rotation_offset: Float[np.ndarray, "3"]
    scaling_pivot: Float[np.ndarray, "3"]
    scaling_offset: Float[np.ndarray, "3"]
    parent_scale: float = 1.0

    @property
    def has_pivots(self) -> bool:
        """Whether rotation and scale move the origin."""
        return bool(self.rotation_pivot.any() or self.scaling_pivot.any() or self.scaling_offset.any())

    def local(
        self, translation: Vectors, rotation: Vectors, scale: Vectors
    ) -> tuple[Vectors, Float[np.ndarray, "f 4"], Vectors]:
        """Translation [units of the file], rotation (`xyzw`) and scale relative to the parent.

        Args:
            translation, rotation, scale: the model's own in some frames [units of the file, degrees, factors].
        """
        angles = rotation[:, ["xyz".index(axis) for axis in self.order]]
        turned = self.before * Rotation.from_euler(self.order, angles, degrees=True) * self.after
        inner = self.scaling_offset + self.scaling_pivot - self.rotation_pivot - scale * self.scaling_pivot
        moved = translation + self.rotation_offset + self.rotation_pivot + turned.apply(inner)
        return moved, turned.as_quat(), scale / self.parent_scale

    @property
    def at_rest(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"], Float[np.ndarray, "3"]]:
        """`local` of the model's own transform."""
        translation, rotation, scale = self.local(self.translation[None], self.rotation[None], self.scale[None])
        return translation[0], rotation[0], scale[0]


@dataclass(frozen=True, eq=False)
class FbxScene:
    """The nodes of a file, parents first: the root, and all models.

    Attributes:
        nodes: at rest.
        models: of all nodes but the first.
        transforms: the same.
        node_of_model: by the number of the model.
    """

    nodes: CharacterNodes
    models: list[FbxObject]
    transforms: list[FbxTransform]
    node_of_model: dict[int, int]


def read_scene(document: FbxDocument) -> FbxScene:
    """The models of a file as nodes.

    Raises:
        InputError: no models or too many, a model with two parents or below itself, a transform that no node has.
    """
    models = document.objects_of_type("Model")
    if not 1 <= len(models) <= MOST_NODES:
        document.fail(f"1 to {MOST_NODES} models", f"{len(models)}")
    number = {model.identity: index for index, model in enumerate(models)}
    parents = np.full(len(models), -1)
    children: list[list[int]] = [[] for _ in models]
    for parent in (SCENE, *number):
        for model in dict.fromkeys(document.below(parent, "Model")):
            child = number[model.identity]
            if parents[child] >= 0:
                model.fail("a model with one parent", "two")
            if parent != SCENE:
                parents[child] = number[parent]
                children[number[parent]].append(child)
    sequence = parents_first(parents, children)
    if len(sequence) < len(models):
        document.fail("models in trees", "models below themselves")
    node_of_model = {models[index].identity: node for node, index in enumerate(sequence, 1)}
    ordered = [models[index] for index in sequence]
    above = np.array([-1, *(node_of_model[models[parents[i]].identity] if parents[i] >= 0 else 0 for i in sequence)])
    transforms = _with_scales([_transform(model) for model in ordered], ordered, above)
    root = decomposed(document.scene_from_file)
    translation, rotation, scale = map(np.array, zip(root, *(each.at_rest for each in transforms)))
    names = DistinctNames()
    named = [names.add(model.name or f"node{node}") for node, model in enumerate(ordered, 1)]
    nodes = CharacterNodes((names.add(ROOT), *named), above, translation, rotation, scale)
    if not np.isfinite(nodes.world).all():
        document.fail("models within 1e300 of one another", "others")
    return FbxScene(nodes, ordered, transforms, node_of_model)


def in_bind_pose(scene: FbxScene, bound: dict[int, Float[np.ndarray, "4 4"]]) -> CharacterNodes:
    """The nodes with some of them where meshes were bound to them, and others as they are relative to their parents.

    Models are written where they are in the current frame of an animation; a character is at rest in its bind pose.
    Where that pose shears a node, all are left as they are.

    Args:
        bound: `scene_from_node` by node.
    """
    nodes = scene.nodes
    translation, rotation, scale = nodes.translation.copy(), nodes.rotation.copy(), nodes.scale.copy()
    world = nodes.world.copy()
    for node, parent in enumerate(nodes.parents):
        if node in bound and parent >= 0:
            try:
                local = np.linalg.solve(world[parent], bound[node])
                translation[node], rotation[node], scale[node] = decomposed(local)
            except (np.linalg.LinAlgError, ValueError):
                return nodes
        if parent >= 0:
            world[node] = world[parent] @ local_matrices(translation[[node]], rotation[[node]], scale[[node]])[0]
    found = CharacterNodes(nodes.names, nodes.parents, translation, rotation, scale)
    return found if np.isfinite(found.world).all() else nodes


def _transform(model: FbxObject) -> FbxTransform:
    properties = model.properties
    # RotationActive: without it, rotations before and after and the order are not used.
    is_active = bool(properties.integer("RotationActive", 0))
    order = properties.integer("RotationOrder", 0) if is_active else 0
    if not 0 <= order < len(ORDERS):
        model.fail(f"a rotation about three axes (RotationOrder 0 to {len(ORDERS) - 1})", f"{order}")
    before, after = (
        Rotation.from_euler("xyz", properties.vector(name) if is_active else np.zeros(3), degrees=True)
        for name in ("PreRotation", "PostRotation")
    )
    return FbxTransform(
        translation=properties.vector("Lcl Translation"),
        rotation=properties.vector("Lcl Rotation"),
        scale=properties.vector("Lcl Scaling", 1.0),
        order=ORDERS[order],
        before=before,
        after=after.inv(),
        rotation_pivot=properties.vector("RotationPivot"),
        rotation_offset=properties.vector("RotationOffset"),
        scaling_pivot=properties.vector("ScalingPivot"),
        scaling_offset=properties.vector("ScalingOffset"),
    )


def _with_scales(own: list[FbxTransform], models: list[FbxObject], above: np.ndarray) -> list[FbxTransform]:
    """Transforms of all models as matrices are multiplied, whichever way they take on scales from above.

    The three ways are the same but for a factor where the scales above are even.

    Raises:
        InputError: they are not, or a way that there is not.
    """
    is_uniform = np.ones(len(above), dtype=bool)
    found = []
    for node, (transform, model) in enumerate(zip(own, models), 1):
        parent = above[node]
        is_uniform[node] = (
            is_uniform[parent] and np.ptp(transform.scale) <= SCALE_TOLERANCE * np.abs(transform.scale).max()
        )
        how = inherited_scale(model)
        if how != INHERIT_RSRS and not is_uniform[parent]:
            model.fail("the same scale along all axes above a model of InheritType 0 or 2", "others")
        if how == INHERIT_RRS and parent > 0:
            parent_scale = float(own[parent - 1].scale[0])
            if parent_scale == 0:
                model.fail("a scale above a model of InheritType 2", "0")
            transform = replace(transform, parent_scale=parent_scale)
        found.append(transform)
    return found


def scale_limits(scene: FbxScene) -> list[int]:
    """What scales of each node may do in an animation: anything, be the same along all axes, or stay."""
    limits = [ANY] * len(scene.nodes)
    for node in range(len(limits) - 1, 0, -1):
        how, parent = inherited_scale(scene.models[node - 1]), scene.nodes.parents[node]
        of_parent = {INHERIT_RSRS: ANY, INHERIT_RRSS: UNIFORM, INHERIT_RRS: CONSTANT}[how]
        limits[parent] = max(limits[parent], of_parent, min(limits[node], UNIFORM))
    return limits


def inherited_scale(model: FbxObject) -> int:
    """One of the three ways in which a model takes on scales from above.

    Raises:
        InputError: another one.
    """
    how = model.properties.integer("InheritType", INHERIT_RSRS)
    if how not in (INHERIT_RRSS, INHERIT_RSRS, INHERIT_RRS):
        model.fail("InheritType 0, 1 or 2", f"{how}")
    return how
