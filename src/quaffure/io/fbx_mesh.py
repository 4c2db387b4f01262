"""Meshes of an FBX file, on the nodes of its scene."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.body.character import CharacterNodes, Skin, SkinnedMesh, local_matrices
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.fbx_document import FbxDocument, FbxObject
from quaffure.io.fbx_geometry import BYTES_A_VERTEX, Geometry, read_geometry
from quaffure.io.fbx_nodes import FbxScene
from quaffure.io.fbx_records import FbxRecord
from quaffure.io.fbx_skin import Cluster, VertexWeights, vertex_weights

BYTES_A_FACE = 80  # of a mesh: its material, while materials are numbered, and its corners where it is mirrored
BYTES_A_BONE = 400  # of a mesh: its matrix, and while vertices are posed
BYTES_A_TARGET = 250  # of a mesh: its name and weight


@dataclass(frozen=True, eq=False)
class FbxMesh:
    """A mesh, and its geometry, whose channels animations move."""

    mesh: SkinnedMesh
    geometry: Geometry


def read_meshes(
    document: FbxDocument, scene: FbxScene, nodes: CharacterNodes, clusters: dict[int, list[Cluster]]
) -> list[FbxMesh]:
    """The meshes of all models that have polygons.

    Args:
        nodes: of the scene, at rest.

    Raises:
        InputError: an array of another size than the others of its geometry, or an index of what there is not.
    """
    geometries: dict[int, tuple[Geometry, VertexWeights] | None] = {}
    found = []
    for node, model in enumerate(scene.models, 1):
        for source in document.below(model, "Geometry", "Mesh")[:1]:
            if source.identity not in geometries:
                geometries[source.identity] = _geometry(document, source, clusters.get(source.identity, []))
            if (both := geometries[source.identity]) is not None:
                geometry, weights = both
                _reserve(source.record, geometry, weights)
                materials = [material.name for material in document.below(model, "Material")]
                skin = weights.skin(node, node_from_geometry(model))
                mesh = _mesh(geometry, weights, skin, node, nodes, materials)
                if not np.isfinite(mesh.vertices).all():
                    source.fail("vertices within 1e300 of one another", "others")
                found.append(FbxMesh(mesh, geometry))
    return found


def _geometry(
    document: FbxDocument, source: FbxObject, clusters: list[Cluster]
) -> tuple[Geometry, VertexWeights] | None:
    """A geometry and what moves its vertices; None of one without polygons."""
    geometry = read_geometry(document, source)
    if geometry is None:
        return None
    return geometry, vertex_weights(clusters, geometry.source, geometry.vertex_count, source)


def _reserve(record: FbxRecord, geometry: Geometry, weights: VertexWeights) -> None:
    """Account for a mesh before it is made: a small file may show one geometry by many models."""
    record.reserve(BYTES_A_VERTEX * len(geometry.source) + BYTES_A_FACE * len(geometry.faces))
    record.reserve(BYTES_A_BONE * len(weights.nodes) + BYTES_A_TARGET * len(geometry.targets))


def node_from_geometry(model: FbxObject) -> Float[np.ndarray, "4 4"]:
    """The transform of a model's geometry alone, which models below it do not take on."""
    properties = model.properties
    turned = Rotation.from_euler("xyz", properties.vector("GeometricRotation"), degrees=True).as_quat()
    moved, scaled = properties.vector("GeometricTranslation"), properties.vector("GeometricScaling", 1.0)
    return local_matrices(moved[None], turned[None], scaled[None])[0]


def _mesh(
    geometry: Geometry, weights: VertexWeights, skin: Skin, node: int, nodes: CharacterNodes, materials: list[str]
) -> SkinnedMesh:
    # A material that the model does not have is none.
    known = ["", *materials]
    index = np.where((geometry.face_materials >= 0) & (geometry.face_materials < len(materials)),
                     geometry.face_materials + 1, 0)  # fmt: skip
    used, face_materials = np.unique(index, return_inverse=True)
    matrices = nodes.world[skin.nodes[:1]] @ skin.inverse_bind[:1]
    faces = geometry.faces
    if np.linalg.slogdet(matrices[0, :3, :3]).sign < 0:  # a mirrored mesh, whose faces would point inwards
        faces = np.ascontiguousarray(faces[:, ::-1])
    distinct = DistinctNames()
    morph_weights = [
        weight for channel in geometry.channels for weight in channel.weights(np.array([channel.weight]))[0]
    ]
    mesh = SkinnedMesh(
        name=nodes.names[node],
        node=node,
        materials=tuple(known[each] for each in used),
        face_materials=face_materials,
        bind_vertices=geometry.vertices,
        vertices=geometry.vertices,
        faces=faces,
        skin=skin,
        is_rigid=skin.nodes.tolist() == [node],
        skin_joints=weights.joints,
        weights=weights.weights,
        uv=geometry.uv,
        morph_targets={distinct.add(name): moved for name, moved in geometry.targets},
        morph_weights=tuple(float(weight) for weight in morph_weights),
    )
    return replace(mesh, vertices=mesh.posed(nodes.world))
