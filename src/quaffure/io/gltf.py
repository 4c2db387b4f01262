"""Reads characters from glTF 2.0 files (.glb, .gltf): nodes, skinned meshes and animations.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html. Read with KHR_mesh_quantization and
EXT_meshopt_compression; materials but for their names, normals, cameras and lights are left out. The documents of
pygltflib and trimesh are not used: neither decodes meshopt, sparse morph targets or animations, and both trust sizes.
"""

from pathlib import Path

from quaffure.body.character import Character
from quaffure.io.gltf_accessor import GltfArrays
from quaffure.io.gltf_animation import read_animations
from quaffure.io.gltf_document import open_gltf
from quaffure.io.gltf_mesh import read_meshes
from quaffure.io.gltf_nodes import read_scene, read_skins


def read_gltf(path: Path) -> Character:
    """What a .glb or .gltf file holds of a character.

    Raises:
        InputError: no such file, or what is damaged, contradicts itself or needs an extension that is not read (Draco
            for instance); names the place.
    """
    document = open_gltf(path)
    arrays = GltfArrays(document)
    scene = read_scene(document.root)
    skins = read_skins(document.root, arrays, scene)
    meshes = read_meshes(document.root, arrays, scene, skins)
    return Character(scene.nodes, meshes, read_animations(document.root, arrays, scene, meshes), str(path))
