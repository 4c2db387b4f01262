"""Meshes of an FBX file, on the nodes of its scene."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from quaffure.body.character import CharacterNodes, SkinnedMesh, local_matrices
from quaffure.io.distinct_names import DistinctNames
from quaffure.io.fbx_document import FbxDocument, FbxObject
from quaffure.io.fbx_geometry import BYTES_A_VERTEX, Geometry, read_geometry
from quaffure.io.fbx_nodes import FbxScene
from quaffure.io.fbx_skin import Cluster, Shares, shares_of


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
    geometries: dict[int, Geometry | None] = {}
    found = []
    for node, model in enumerate(scene.models, 1):
        for source in document.below(model, "Geometry", "Mesh")[:1]:
            if source.identity not in geometries:
                geometries[source.identity] = read_geometry(document, source)
            geometry = geometries[source.identity]
            if geometry is not None:
                shares = _shares(clusters.get(source.identity, []), geometry, source, (node, model))
                materials = [material.name for material in document.below(model, "Material")]
                mesh = _mesh(geometry, shares, node, nodes, materials)
                if not np.isfinite(mesh.vertices).all():
                    source.fail("vertices within 1e300 of one another", "others")
                found.append(FbxMesh(mesh, geometry))
    return found


def _shares(clusters: list[Cluster], geometry: Geometry, source: FbxObject, holder: tuple[int, FbxObject]) -> Shares:
    """Joints and weights of the vertices."""
    source.record.take(BYTES_A_VERTEX * len(geometry.source))
    for cluster in clusters:
        if len(cluster.vertices) and not 0 <= cluster.vertices.min() <= cluster.vertices.max() < geometry.vertex_count:
            source.fail(f"weights of vertices below {geometry.vertex_count}", "others")
    node, model = holder
    shares = shares_of(clusters, geometry.vertex_count, node, node_from_geometry(model))
    source.record.take(BYTES_A_VERTEX * shares.weights.shape[1] * geometry.vertex_count // 4)
    return shares._replace(joints=shares.joints[geometry.source], weights=shares.weights[geometry.source])


def node_from_geometry(model: FbxObject) -> Float[np.ndarray, "4 4"]:
    """The transform of a model's geometry alone, which models below it do not take on."""
    properties = model.properties
    turned = Rotation.from_euler("xyz", properties.vector("GeometricRotation"), degrees=True).as_quat()
    moved, scaled = properties.vector("GeometricTranslation"), properties.vector("GeometricScaling", 1.0)
    return local_matrices(moved[None], turned[None], scaled[None])[0]


def _mesh(geometry: Geometry, shares: Shares, node: int, nodes: CharacterNodes, materials: list[str]) -> SkinnedMesh:
    # A material that the model does not have is none.
    known = ["", *materials]
    index = np.where((geometry.face_materials >= 0) & (geometry.face_materials < len(materials)),
                     geometry.face_materials + 1, 0)  # fmt: skip
    used, face_materials = np.unique(index, return_inverse=True)
    matrices = nodes.world[shares.skin.nodes] @ shares.skin.inverse_bind
    faces = geometry.faces
    if np.linalg.slogdet(matrices[0, :3, :3]).sign < 0:  # a mirrored mesh, whose faces would point inwards
        faces = np.ascontiguousarray(faces[:, ::-1])
    distinct = DistinctNames()
    weights = [weight for channel in geometry.channels for weight in channel.weights(np.array([channel.weight]))[0]]
    mesh = SkinnedMesh(
        name=nodes.names[node],
        node=node,
        materials=tuple(known[each] for each in used),
        face_materials=face_materials,
        bind_vertices=geometry.vertices,
        vertices=geometry.vertices,
        faces=faces,
        skin=shares.skin,
        is_rigid=shares.skin.nodes.tolist() == [node],
        skin_joints=shares.joints,
        weights=shares.weights,
        uv=geometry.uv,
        morph_targets={distinct.add(name): moved for name, moved in geometry.targets},
        morph_weights=tuple(float(weight) for weight in weights),
    )
    return replace(mesh, vertices=mesh.posed(nodes.world))
