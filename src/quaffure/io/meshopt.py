"""Decodes buffer views of glTF's EXT_meshopt_compression: vertex attributes, triangles and indices, and filters.

Written from the specification (KhronosGroup/glTF, extensions/2.0/Vendor/EXT_meshopt_compression, appendices A and B).
Decoders take a stream whose least size has been checked, and return False where it ends early or has bytes left over.
"""

import numpy as np
from jaxtyping import Shaped, UInt8
from numba import njit

Bytes = UInt8[np.ndarray, " n"]
ATTRIBUTES_HEADER, TRIANGLES_HEADER, INDICES_HEADER = 0xA0, 0xE1, 0xD1
TRIANGLES_TAIL, INDICES_TAIL = 16, 4
GROUP = 16
"""Elements whose deltas are stored in one way."""
MODES = {"ATTRIBUTES": ATTRIBUTES_HEADER, "TRIANGLES": TRIANGLES_HEADER, "INDICES": INDICES_HEADER}
FILTERS: dict[str, tuple[int, ...]] = {
    "NONE": tuple(range(4, 257, 4)),
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": tuple(range(4, 257, 4)),
}
"""Names of filters and the strides that they take [bytes]."""


def decode_meshopt(stream: Bytes, count: int, stride: int, mode: str, kind: str = "NONE") -> Bytes:
    """The `count * stride` bytes of a buffer view.

    Args:
        stream: the compressed bytes.
        count, stride: of the elements [bytes].
        mode: of `MODES`.
        kind: of `FILTERS`.

    Raises:
        ValueError: another mode, filter, stride or header than there are, or a stream of another size than its content.
    """
    if mode not in MODES:
        raise ValueError(f"mode {mode!r:.20}")
    if stride not in (FILTERS.get(kind, ()) if mode == "ATTRIBUTES" else (2, 4)):
        raise ValueError(f"stride {stride} in mode {mode} with filter {kind!r:.20}")
    if mode == "TRIANGLES" and count % 3:
        raise ValueError(f"{count} indices of triangles")
    if len(stream) < least_size(count, stride, mode):
        raise ValueError(f"{len(stream)} compressed bytes for {count} elements")
    if stream[0] != MODES[mode]:
        raise ValueError(f"a stream that begins with {stream[0]:#x} in mode {mode}")
    if mode == "ATTRIBUTES":
        decoded = np.zeros((count, stride), dtype=np.uint8)
        is_whole = _decode_attributes(stream, decoded)
    else:
        indices = np.zeros(count, dtype=np.uint32)
        is_whole = (_decode_triangles if mode == "TRIANGLES" else _decode_indices)(stream, indices)
        decoded = (indices.astype(np.uint16) if stride == 2 else indices).view(np.uint8)
    if not is_whole:
        raise ValueError("compressed bytes that end early or are left over")
    return filtered(decoded.reshape(-1), stride, kind if mode == "ATTRIBUTES" else "NONE")


def least_size(count: int, stride: int, mode: str) -> int:
    """Bytes that a stream of so many elements has at least."""
    if mode == "TRIANGLES":
        return 1 + count // 3 + TRIANGLES_TAIL
    if mode == "INDICES":
        return 1 + count + INDICES_TAIL
    block = block_size(stride)
    full, rest = divmod(count, block)
    headers = full * _header_size(block) + (_header_size(rest) if rest else 0)
    return 1 + stride * headers + max(32, stride)


def filtered(decoded: Bytes, stride: int, kind: str) -> Bytes:
    """Decoded attributes after their filter."""
    if kind == "OCTAHEDRAL":
        return _octahedral(decoded.view(np.int8 if stride == 4 else np.int16).reshape(-1, 4))
    if kind == "QUATERNION":
        return _quaternion(decoded.view(np.int16).reshape(-1, 4))
    if kind == "EXPONENTIAL":
        packed = decoded.view(np.int32)
        with np.errstate(over="ignore"):
            return np.ldexp((packed << 8 >> 8).astype(np.float32), packed >> 24).view(np.uint8)
    return decoded


def _octahedral(packed: Shaped[np.ndarray, "n 4"]) -> Bytes:
    largest = np.iinfo(packed.dtype).max
    values = packed.astype(np.float32)
    one = np.where(values[:, 2] == 0, 1, values[:, 2])
    x, y = values[:, 0] / one, values[:, 1] / one
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.minimum(z, 0)
    x, y = x - np.copysign(fold, x), y - np.copysign(fold, y)
    vectors = np.stack([x, y, z], axis=1)
    lengths = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    unpacked = packed.copy()
    unpacked[:, :3] = np.rint(vectors / lengths * largest)
    return unpacked.reshape(-1).view(np.uint8)


def _quaternion(packed: Shaped[np.ndarray, "n 4"]) -> Bytes:
    one = (packed[:, 3] | 3).astype(np.float32)
    rest = packed[:, :3] / one[:, None] * np.float32(np.sqrt(0.5))
    largest = np.sqrt(np.maximum(0, 1 - (rest * rest).sum(1)))
    place = (packed[:, 3] & 3).astype(np.int64)
    unpacked = np.empty_like(packed)
    rows = np.arange(len(packed))
    for offset, component in enumerate([largest, *rest.T]):
        limited = np.clip(np.rint(component * 32767), -32768, 32767)
        unpacked[rows, (place + offset) % 4] = limited
    return unpacked.reshape(-1).view(np.uint8)


def block_size(stride: int) -> int:
    """Elements of a block of attributes."""
    return min((8192 // stride) & ~(GROUP - 1), 256)


def _header_size(elements: int) -> int:
    groups = -(-elements // GROUP)
    return -(-groups // 4)


@njit(cache=True)
def _decode_attributes(stream: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out` [count, stride] from deltas to the element before, byte by byte."""
    count, stride = out.shape
    tail = max(32, stride)
    end = len(stream) - tail
    previous = stream[len(stream) - stride :].copy()
    block = min((8192 // stride) & ~15, 256)
    deltas = np.zeros(16, dtype=np.uint8)
    at = 1
    for first in range(0, count, block):
        elements = min(block, count - first)
        groups = (elements + 15) // 16
        for byte in range(stride):
            header = at
            at += (groups + 3) // 4
            if at > end:
                return False
            value = previous[byte]
            for group in range(groups):
                how = (stream[header + group // 4] >> (2 * (group % 4))) & 3
                at = _read_group(stream, at, end, how, deltas)
                if at < 0:
                    return False
                for i in range(min(16, elements - 16 * group)):
                    delta = deltas[i]
                    signed = (delta >> 1) ^ (0xFF if delta & 1 else 0)
                    value = np.uint8((value + signed) & 0xFF)
                    out[first + 16 * group + i, byte] = value
            previous[byte] = value
    return at == end


@njit(cache=True)
def _read_group(stream: np.ndarray, at: int, end: int, how: int, deltas: np.ndarray) -> int:
    """Sixteen deltas of a group that begins at `at`; where it ends, or -1 beyond the stream."""
    if how == 0:
        deltas[:] = 0
        return at
    if how == 3:
        if at + 16 > end:
            return -1
        deltas[:] = stream[at : at + 16]
        return at + 16
    bits = 2 * how
    sentinel, per_byte = (1 << bits) - 1, 8 // bits
    extra = at + 16 // per_byte
    if extra > end:
        return -1
    for i in range(16):
        delta = (stream[at + i // per_byte] >> (bits * (per_byte - 1 - i % per_byte))) & sentinel
        if delta == sentinel:
            if extra >= end:
                return -1
            delta = stream[extra]
            extra += 1
        deltas[i] = delta
    return extra


@njit(cache=True)
def _read_varint(stream: np.ndarray, at: int, end: int) -> tuple[int, int]:
    """An unsigned LEB128 of 32 bits, and where it ends; -1 beyond the stream."""
    value, shift = 0, 0
    while at < end and shift < 35:
        byte = np.int64(stream[at])
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFF, at
        shift += 7
    return 0, -1


@njit(cache=True)
def _zigzag(value: int) -> int:
    return -(value >> 1) - 1 if value & 1 else value >> 1


@njit(cache=True)
def _decode_indices(stream: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out` from deltas to one of two indices."""
    end = len(stream) - 4
    last = np.zeros(2, dtype=np.int64)
    at = 1
    for i in range(len(out)):
        value, at = _read_varint(stream, at, end)
        if at < 0:
            return False
        baseline = value & 1
        last[baseline] = (last[baseline] + _zigzag(value >> 1)) & 0xFFFFFFFF
        out[i] = last[baseline]
    return at == end


@njit(cache=True)
def _decode_triangles(stream: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out` with three indices a triangle, from recent edges and vertices."""
    count, end = len(out) // 3, len(stream) - 16
    edges, edge_end = np.zeros((16, 2), dtype=np.int64), 0
    vertices, vertex_end = np.zeros(16, dtype=np.int64), 0
    following, last = 0, 0
    at = 1 + count
    corners, is_pushed = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.bool_)
    for triangle in range(count):
        code = np.int64(stream[1 + triangle])
        is_pushed[:] = False
        if code < 0xF0:
            edge = (edge_end - 1 - (code >> 4)) & 15
            a, b = edges[edge, 0], edges[edge, 1]
            low = code & 15
            is_pushed[2] = low == 0 or low >= 13
            if low == 0:
                c, following = following, following + 1
            elif low < 13:
                c = vertices[(vertex_end - 1 - low) & 15]
            elif low < 15:
                last = (last + 2 * low - 27) & 0xFFFFFFFF
                c = last
            else:
                delta, at = _read_varint(stream, at, end)
                if at < 0:
                    return False
                last = (last + _zigzag(delta)) & 0xFFFFFFFF
                c = last
            corners[0], corners[1], corners[2] = a, b, c
        else:
            if code >= 0xFE:
                if at >= end:
                    return False
                pair = np.int64(stream[at])
                at += 1
                if pair == 0:
                    following = 0
            else:
                pair = np.int64(stream[end + (code & 15)])
            first = 15 if code == 0xFF else 0
            for corner, how in enumerate((first, pair >> 4, pair & 15)):
                if how == 0:
                    corners[corner], following = following, following + 1
                elif how < 15 or code < 0xFE:
                    corners[corner] = vertices[(vertex_end - how) & 15]
                else:
                    delta, at = _read_varint(stream, at, end)
                    if at < 0:
                        return False
                    last = (last + _zigzag(delta)) & 0xFFFFFFFF
                    corners[corner] = last
                is_pushed[corner] = how == 0 or how == 15
            edges[edge_end & 15, 0], edges[edge_end & 15, 1] = corners[1], corners[0]
            edge_end += 1
        edges[edge_end & 15, 0], edges[edge_end & 15, 1] = corners[2], corners[1]
        edges[(edge_end + 1) & 15, 0], edges[(edge_end + 1) & 15, 1] = corners[0], corners[2]
        edge_end += 2
        for corner in range(3):
            if is_pushed[corner]:
                vertices[vertex_end & 15] = corners[corner]
                vertex_end += 1
            out[3 * triangle + corner] = corners[corner]
    return at == end
