"""Reads characters from binary FBX files: models, skinned meshes and animations, in metres, y up, as in glTF.

No maintained, permissively licensed FBX reader is available as a wheel. This one reads what glTF also has; of materials
only names; no normals, cameras, lights or constraints.
"""

from pathlib import Path

from quaffure.body.character import Character
from quaffure.io.fbx_animation import read_animations
from quaffure.io.fbx_document import read_document
from quaffure.io.fbx_mesh import read_meshes
from quaffure.io.fbx_nodes import in_bind_pose, read_scene
from quaffure.io.fbx_records import open_fbx
from quaffure.io.fbx_skin import bind_pose, read_clusters


def read_fbx(path: Path) -> Character:
    """What a binary .fbx holds of a character. At rest it is in the pose in which its meshes were bound.

    Raises:
        InputError: no such file, an FBX of text or of another version, or what is damaged or contradicts itself; names
            the place.
    """
    document = read_document(open_fbx(path))
    scene = read_scene(document)
    clusters = read_clusters(document, scene)
    nodes = in_bind_pose(scene, bind_pose(document, scene, clusters))
    meshes = read_meshes(document, scene, nodes, clusters)
    animations = read_animations(document, scene, nodes, meshes)
    return Character(nodes, tuple(found.mesh for found in meshes), animations, str(path))
