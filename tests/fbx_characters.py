"""Characters written as FBX files, in other axes and units, with rotations before and after those of their joints."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from quaffure.body import Character, CharacterNodes, SkinnedMesh
from quaffure.body.character import local_matrices, world_matrices
from tests.fbx_file import Y_UP, Z_UP, FbxFile, Record, listed

ORDERS = ("xyz", "xzy", "yzx", "yxz", "zxy", "zyx")
PATHS = {"translation": "Lcl Translation", "rotation": "Lcl Rotation", "scale": "Lcl Scaling"}
Z_FROM_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From y up, facing +z, to z up, facing -y."""


@dataclass(frozen=True)
class FbxForm:
    """How a character is written.

    Attributes:
        centimetres: in a unit of the file.
        is_z_up: facing -y, or y up and facing +z.
        is_turned: joints have rotations before and after their own, whose order differs.
    """

    centimetres: float = 1.0
    is_z_up: bool = False
    is_turned: bool = False


def fbx_of(character: Character, form: FbxForm = FbxForm()) -> FbxFile:
    """A file of a character in metres, y up."""
    file = FbxFile(Z_UP if form.is_z_up else Y_UP, form.centimetres)
    factor = 100.0 / form.centimetres
    axes = Rotation.from_matrix(Z_FROM_Y) if form.is_z_up else Rotation.identity()
    nodes = character.nodes
    rotations = [_Turned(axes if parent < 0 else Rotation.identity(), node if form.is_turned else None)
                 for node, parent in enumerate(nodes.parents)]  # fmt: skip
    world = _scaled_world(nodes, axes, factor)
    rigid = {mesh.node for mesh in character.meshes}
    models: list[int] = []
    for node, name in enumerate(nodes.names):
        turned, parent = rotations[node], int(nodes.parents[node])
        properties = {
            "Lcl__Translation": tuple(factor * turned.moved(nodes.translation[node])),
            "Lcl__Rotation": tuple(turned.angles(nodes.rotation[node][None])[0]),
            "Lcl__Scaling": tuple(nodes.scale[node]), "InheritType": 1, **turned.properties,
        }  # fmt: skip
        kind = "Mesh" if node in rigid else "LimbNode"
        models.append(file.model(name, models[parent] if parent >= 0 else 0, kind, **properties))
    for mesh in character.meshes:
        _add_mesh(file, mesh, models, world, factor)
    for animation in character.animations:
        layer = file.stack(animation.name)
        for channel in (channel for channel in animation.channels if channel.path in PATHS):
            values, turned = channel.values[:, channel.values.shape[1] // 2], rotations[channel.node]
            if channel.path == "rotation":
                values = turned.angles(values)
            elif channel.path == "translation":
                values = factor * turned.moved(values)
            curves = file.curve_node(layer, models[channel.node], PATHS[channel.path])
            for axis, column in zip("XYZ", values.T):
                file.curve(curves, f"d|{axis}", channel.times, column)
    return file


class _Turned:
    """The rotation of a node, of an order and between two others."""

    def __init__(self, axes: Rotation, seed: int | None) -> None:
        self.axes, self.order = axes, ORDERS[(seed or 0) % len(ORDERS)]
        angles = np.zeros((2, 3)) if seed is None else np.random.default_rng(seed).uniform(-90, 90, (2, 3))
        self.before, self.after = (Rotation.from_euler("xyz", each, degrees=True) for each in angles)
        self.properties = {} if seed is None else {
            "RotationActive": True, "RotationOrder": ORDERS.index(self.order),
            "PreRotation": tuple(angles[0]), "PostRotation": tuple(angles[1]),
        }  # fmt: skip

    def moved(self, translation: np.ndarray) -> np.ndarray:
        return self.axes.apply(translation)

    def angles(self, rotation: np.ndarray) -> np.ndarray:
        """Angles [degrees] that follow one another without jumps, of quaternions `xyzw`."""
        own = self.before.inv() * self.axes * Rotation.from_quat(rotation) * self.after
        angles = np.degrees(np.unwrap(own.as_euler(self.order), axis=0))
        return angles[:, [self.order.index(axis) for axis in "xyz"]]


def _scaled_world(nodes: CharacterNodes, axes: Rotation, factor: float) -> np.ndarray:
    """Nodes in the axes and the unit of the file."""
    world = world_matrices(nodes.parents, local_matrices(factor * nodes.translation, nodes.rotation, nodes.scale))
    turned = np.eye(4)
    turned[:3, :3] = axes.as_matrix()
    return turned @ world


def _add_mesh(file: FbxFile, mesh: SkinnedMesh, models: list[int], world: np.ndarray, factor: float) -> None:
    layers = []
    if mesh.materials:
        for name in mesh.materials:
            file.connect(file.add("Material", "", name), models[mesh.node])
        kind = Record("MappingInformationType", ["ByPolygon"])
        layers.append(Record("LayerElementMaterial", [0], [kind, Record("Materials", [np.int32(mesh.face_materials)])]))
    if mesh.uv is not None:
        uv = np.float64(mesh.uv) * [1, -1] + [0, 1]
        kind = Record("MappingInformationType", ["ByVertice"])
        layers.append(Record("LayerElementUV", [0], [kind, Record("UV", [uv.reshape(-1)])]))
    vertices = factor * np.asarray(mesh.bind_vertices)
    geometry = file.geometry(models[mesh.node], vertices, mesh.faces.tolist(), *layers)
    if not mesh.is_rigid:
        skin = file.skin(geometry)
        bound = mesh.skin.inverse_bind.copy()
        bound[:, :3, 3] *= factor
        for joint, node in enumerate(mesh.skin.nodes):
            rows, columns = np.nonzero((mesh.skin_joints == joint) & (mesh.weights > 0))
            weights, link = mesh.weights[rows, columns], world[node]
            file.cluster(skin, models[node], rows, weights, link @ bound[joint], link)
    if mesh.morph_targets:
        blend = file.add("Deformer", "BlendShape", "shapes")
        file.connect(blend, geometry)
        for (name, target), weight in zip(mesh.morph_targets.items(), mesh.morph_weights):
            moved = np.flatnonzero(target.any(axis=1))
            shape = file.add("Geometry", "Shape", name, Record("Indexes", [np.int32(moved)]),
                             Record("Vertices", [np.float64(factor * target[moved]).reshape(-1)]))  # fmt: skip
            channel = file.add("Deformer", "BlendShapeChannel", name, listed(DeformPercent=100.0 * weight),
                               Record("FullWeights", [np.array([100.0])]))  # fmt: skip
            file.connect(channel, blend)
            file.connect(shape, channel)
