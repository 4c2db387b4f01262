"""The simplest streams of EXT_meshopt_compression: every delta in full."""

import numpy as np

from tests.gltf_files import COMPONENTS, KINDS, GltfFile


def encoded_attributes(rows: np.ndarray) -> bytes:
    """A stream of at most 256 rows of bytes [count, stride]."""
    count, stride = rows.shape
    deltas = np.diff(rows.astype(np.int16), axis=0, prepend=rows[:1].astype(np.int16)).astype(np.int8)
    zigzag = ((deltas.astype(np.int16) << 1) ^ (deltas >> 7)).astype(np.uint8)
    groups = -(-count // 16)
    padded = np.zeros((16 * groups, stride), np.uint8)
    padded[:count] = zigzag
    header = bytes([255] * (groups // 4) + ([4 ** (groups % 4) - 1] if groups % 4 else []))
    body = b"".join(header + padded[:, byte].tobytes() for byte in range(stride))
    return b"\xa0" + body + rows[0].tobytes().rjust(max(32, stride), b"\0")


def encoded_triangles(corners: list[int]) -> bytes:
    """A stream of three indices a triangle, none of them known before."""
    deltas = np.diff(corners, prepend=0)
    data = b"".join(
        (b"\xff" if place % 3 == 0 else b"") + _varint(2 * delta if delta >= 0 else -2 * delta - 1)
        for place, delta in enumerate(int(delta) for delta in deltas)
    )
    return b"\xe1" + b"\xff" * (len(corners) // 3) + data + bytes(16)


def compressed(file: GltfFile, values: np.ndarray, mode: str = "ATTRIBUTES") -> int:
    """An accessor of a view that is compressed; its buffer holds nothing else."""
    width = values.reshape(len(values), -1).shape[1]
    if mode == "ATTRIBUTES":
        stream = encoded_attributes(np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1))
    else:
        stream = encoded_triangles(values.tolist())
    packed = file.document["bufferViews"][file.view(stream)]
    stride = values.nbytes // len(values)
    extension = {"buffer": 0, "byteOffset": packed["byteOffset"], "byteLength": len(stream), "byteStride": stride,
                 "count": len(values), "mode": mode}  # fmt: skip
    packed.clear()
    packed |= {"buffer": 1, "byteLength": values.nbytes, "extensions": {"EXT_meshopt_compression": extension}}
    file.document["buffers"] = [{"byteLength": values.nbytes}]
    file.document["extensionsRequired"] = ["EXT_meshopt_compression", "KHR_mesh_quantization"]
    return file.add("accessors", bufferView=len(file.document["bufferViews"]) - 1, count=len(values),
                    componentType=COMPONENTS[values.dtype.name], type=KINDS[width])  # fmt: skip


def _varint(value: int) -> bytes:
    content = bytearray()
    while value >= 128:
        content.append(value & 127 | 128)
        value >>= 7
    return bytes([*content, value])
