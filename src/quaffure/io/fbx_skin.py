"""Skins of an FBX file: which models move which vertices of a geometry, and where they were when it was bound."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from quaffure.body.character import Skin
from quaffure.io.fbx_document import FbxDocument, FbxObject
from quaffure.io.fbx_nodes import FbxScene
from quaffure.io.fbx_records import FbxRecord

MOST_JOINTS = 32
"""Most joints per vertex; the strongest are kept."""
BYTES_A_SHARE = 100  # of a cluster, while shares are sorted
BYTES_A_JOINT = 32  # of a vertex: its index and its weight, and the same once more by the vertices of the file
BIND_TOLERANCE = 1e-3
"""Within which two matrices say the same, in proportion to their largest number."""
MOST_SCALE = 2.0
"""By which a pose may be larger than that in which a mesh was bound; beyond it, the mesh was bound in another unit."""
LEAST_WEIGHT = -1e-3
"""Weights that are smaller are refused; others below 0 are a rounding."""


class Cluster(NamedTuple):
    """What one joint moves.

    Attributes:
        node: the joint.
        vertices: indices among those of the geometry in the file.
        weights: of these vertices, not below `LEAST_WEIGHT`; those of a vertex need not sum to 1.
        joint_from_mesh: when it was bound, from the space of the mesh's node [units of the file].
        file_from_joint: when it was bound [units of the file].
    """

    node: int
    vertices: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, " n"]
    joint_from_mesh: Float[np.ndarray, "4 4"]
    file_from_joint: Float[np.ndarray, "4 4"]


class VertexWeights(NamedTuple):
    """What moves the vertices of a geometry, whichever models show it.

    Attributes:
        nodes: joints; -1 is the node of a mesh, which moves the vertices that no cluster does.
        joint_from_mesh: when they were bound [units of the file].
        joints: indices among `nodes`, of each vertex.
        weights: of these joints; they sum to 1.
    """

    nodes: Int[np.ndarray, " s"]
    joint_from_mesh: Float[np.ndarray, "s 4 4"]
    joints: Int[np.ndarray, "v w"]
    weights: Float[np.ndarray, "v w"]

    def skin(self, node: int, node_from_geometry: Float[np.ndarray, "4 4"]) -> Skin:
        """The joints of a mesh with this geometry, which hangs on a node."""
        return Skin(np.where(self.nodes < 0, node, self.nodes), self.joint_from_mesh @ node_from_geometry)


def read_clusters(document: FbxDocument, scene: FbxScene) -> dict[int, list[Cluster]]:
    """The clusters of every geometry that has some, by its number.

    Raises:
        InputError: one without matrices, with another number of weights than vertices, or of the additive mode.
    """
    found = {}
    for geometry in document.objects_of_type("Geometry"):
        clusters = [
            _cluster(cluster, scene.node_of_model[joint.identity])
            for deformer in document.below(geometry, "Deformer", "Skin")
            for cluster in document.below(deformer, "Deformer", "Cluster")
            for joint in document.below(cluster, "Model")[:1]
        ]
        if clusters:
            found[geometry.identity] = clusters
    return found


def bind_pose(
    document: FbxDocument, scene: FbxScene, clusters: dict[int, list[Cluster]]
) -> dict[int, Float[np.ndarray, "4 4"]]:
    """`scene_from_node` of the nodes when meshes were bound to them; none where the file contradicts itself.

    Clusters say it of joints, and a pose of the kind BindPose of other nodes.
    """
    bound: dict[int, Float[np.ndarray, "4 4"]] = {}
    for of_mesh in clusters.values():
        placed = [cluster.file_from_joint @ cluster.joint_from_mesh for cluster in of_mesh]
        if not all(_is_same(placed[0], matrix) for matrix in placed):
            return {}
        for cluster in of_mesh:
            bound.setdefault(cluster.node, cluster.file_from_joint)
    places = np.array([matrix[:3, 3] for matrix in bound.values()])
    if len(bound) < 2 or not np.ptp(places, axis=0).any():  # a file of one joint, or without matrices of use
        return {}
    joints = {node: document.scene_from_file @ matrix for node, matrix in bound.items()}
    scale = _scale(joints, scene.nodes.world)
    if not 1 / MOST_SCALE < scale < MOST_SCALE:
        return _resized(joints, scale, scene.nodes.world)
    posed = _posed(document, scene)
    if all(_is_same(bound[node], posed[node]) for node in bound.keys() & posed.keys()):
        joints = {node: document.scene_from_file @ matrix for node, matrix in posed.items()} | joints
    return joints


def vertex_weights(
    clusters: list[Cluster], source: Int[np.ndarray, " v"], vertex_count: int, geometry: FbxObject
) -> VertexWeights:
    """What moves the vertices of a geometry.

    Args:
        clusters: of the geometry.
        source: vertex of the file that each vertex is.
        vertex_count: vertices of the file.
        geometry: its object, for messages.

    Raises:
        InputError: clusters of vertices that there are not, or more memory than a file of this size should need.
    """
    for cluster in clusters:
        if len(cluster.vertices) and not 0 <= cluster.vertices.min() <= cluster.vertices.max() < vertex_count:
            geometry.fail(f"weights of vertices below {vertex_count}", "others")
    vertices = np.concatenate([np.arange(0), *(cluster.vertices for cluster in clusters)])
    weights = np.concatenate([np.zeros(0), *(cluster.weights for cluster in clusters)])
    joints = np.repeat(np.arange(len(clusters)), [len(cluster.vertices) for cluster in clusters])
    vertices, joints, weights = vertices[weights > 0], joints[weights > 0], weights[weights > 0]
    left = np.setdiff1d(np.arange(vertex_count), vertices)
    nodes, bound = [cluster.node for cluster in clusters], [cluster.joint_from_mesh for cluster in clusters]
    if len(left):
        vertices, weights = np.concatenate([vertices, left]), np.concatenate([weights, np.ones(len(left))])
        joints = np.concatenate([joints, np.full(len(left), len(clusters))])
        nodes, bound = [*nodes, -1], [*bound, np.eye(4)]
    order = np.lexsort((-weights, vertices))
    vertices, joints, weights = vertices[order], joints[order], weights[order]
    rank = np.arange(len(vertices)) - np.searchsorted(vertices, vertices)
    width = min(int(rank.max(initial=0)) + 1, MOST_JOINTS)
    geometry.record.reserve(BYTES_A_JOINT * width * (vertex_count + len(source)))
    kept = rank < width
    skin_joints, shares = np.zeros((vertex_count, width), np.int64), np.zeros((vertex_count, width))
    skin_joints[vertices[kept], rank[kept]] = joints[kept]
    shares[vertices[kept], rank[kept]] = weights[kept]
    shares /= shares.sum(axis=1, keepdims=True)
    return VertexWeights(np.array(nodes), np.array(bound), skin_joints[source], shares[source])


def matrix_of(record: FbxRecord) -> Float[np.ndarray, "4 4"]:
    """A matrix that a record holds, for columns of coordinates.

    Raises:
        InputError: not 16 numbers, or no inverse.
    """
    rows = record.floats(16)
    matrix = rows.reshape(-1, 4, 4)[0].T if len(rows) == 1 else record.fail("16 numbers", f"{rows.size}")
    matrix[3] = (0, 0, 0, 1)
    with np.errstate(all="ignore"):  # numbers near the limits of float64
        has_inverse = abs(np.linalg.det(matrix)) > 0
    if not has_inverse:
        record.fail("a matrix with an inverse", "none")
    return matrix


def _cluster(cluster: FbxObject, node: int) -> Cluster:
    record = cluster.record
    mode = record.child("Mode")
    if mode is not None and mode.text(0) == "Additive":
        mode.fail("a cluster whose weights share a vertex (Normalize, Total1)", "Additive")
    vertices, weights = np.zeros(0, np.int64), np.zeros(0)
    if (indexes := record.child("Indexes")) is not None:
        vertices, weights = indexes.integers(), record.required("Weights").floats(1)[:, 0]
        if len(weights) != len(vertices):
            record.fail(f"{len(vertices)} weights, as many as vertices", f"{len(weights)}")
        if not (weights >= LEAST_WEIGHT).all():
            record.fail("weights from 0 up", f"{weights.min():.3g}")
        record.reserve(BYTES_A_SHARE * len(weights))
    transform, link = (matrix_of(record.required(name)) for name in ("Transform", "TransformLink"))
    return Cluster(node, vertices, weights, transform, link)


def _posed(document: FbxDocument, scene: FbxScene) -> dict[int, Float[np.ndarray, "4 4"]]:
    """`file_from_node` of the nodes in the bind poses that the file lists."""
    nodes: dict[int, Float[np.ndarray, "4 4"]] = {}
    for pose in (pose for pose in document.objects_of_type("Pose") if pose.kind == "BindPose"):
        for record in (record for record in pose.record.children if record.name == "PoseNode"):
            node = scene.node_of_model.get(record.required("Node").integer(0))
            if node is not None:
                nodes.setdefault(node, matrix_of(record.required("Matrix")))
    return nodes


def _scale(bound: dict[int, Float[np.ndarray, "4 4"]], world: Float[np.ndarray, "n 4 4"]) -> float:
    """How much larger models are than when they were bound: the median of all joints; 1 without one of any size."""
    sizes = np.abs([[np.linalg.det(world[node, :3, :3]), np.linalg.det(of[:3, :3])] for node, of in bound.items()])
    usable = (sizes > 1e-30).all(axis=1)
    return float(np.median(np.cbrt(sizes[usable, 0] / sizes[usable, 1]))) if usable.any() else 1.0


def _resized(
    bound: dict[int, Float[np.ndarray, "4 4"]], scale: float, world: Float[np.ndarray, "n 4 4"]
) -> dict[int, Float[np.ndarray, "4 4"]]:
    """The pose of bound joints as large as the models are, its first joint where that is now.

    Meshes that are bound in centimetres to joints that are scaled to metres are exported so.
    """
    top = min(bound)
    resized = np.diag([scale, scale, scale, 1.0])
    resized[:3, 3] = world[top, :3, 3] - scale * bound[top][:3, 3]
    return {node: resized @ matrix for node, matrix in bound.items()}


def _is_same(first: Float[np.ndarray, "4 4"], second: Float[np.ndarray, "4 4"]) -> bool:
    return bool(np.abs(first - second).max() <= BIND_TOLERANCE * max(np.abs(first).max(), 1e-12))
