"""Decodes buffer views of glTF's EXT_meshopt_compression: vertex attributes, triangles and indices, and filters.

Written from the specification (KhronosGroup/glTF, extensions/2.0/Vendor/EXT_meshopt_compression, appendices A and B).
Decoders take a stream whose least size has been checked, and return False where it ends early or has bytes left over.
"""

import numpy as np
from jaxtyping import Shaped, UInt8
from numba import njit

Stream = UInt8[np.ndarray, " n"]
Bytes = UInt8[np.ndarray, " m"]
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


def decode_meshopt(stream: Stream, count: int, stride: int, mode: str, kind: str = "NONE") -> Bytes:
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
        decoded = np.zeros(count * stride, dtype=np.uint8)
        is_whole = _decode_attributes(stream, decoded.reshape(count, stride))
    else:
        indices = np.zeros(count, dtype=np.uint32)
        is_whole = (_decode_triangles if mode == "TRIANGLES" else _decode_indices)(stream, indices)
        decoded = (indices.astype(np.uint16) if stride == 2 else indices).view(np.uint8)
    if not is_whole:
        raise ValueError("compressed bytes that end early or are left over")
    return filtered(decoded, stride, kind if mode == "ATTRIBUTES" else "NONE")


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
        byte = int(np.int64(stream[at]))
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


_NEXT, _LAST, _AT, _EDGES, _VERTICES = range(5)
"""State of the decoder of triangles: the next unused index, the last one that was stored in full, the place in the
stream, and how many edges and vertices have been remembered, each in its ring of sixteen."""


@njit(cache=True)
def _decode_triangles(stream: np.ndarray, out: np.ndarray) -> bool:
    """Fill `out` with three indices a triangle, from recent edges and vertices."""
    count, end = len(out) // 3, len(stream) - 16
    edges, vertices = np.zeros((16, 2), dtype=np.int64), np.zeros(16, dtype=np.int64)
    state = np.zeros(5, dtype=np.int64)
    state[_AT] = 1 + count
    corners, is_new = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.bool_)
    for triangle in range(count):
        code = int(np.int64(stream[1 + triangle]))
        if code < 0xF0:
            _triangle_on_edge(stream, code, state, edges, vertices, corners, is_new)
        else:
            _free_triangle(stream, code, state, vertices, corners, is_new)
            _remember_edge(edges, state, corners[1], corners[0])
        if state[_AT] < 0:
            return False
        _remember_edge(edges, state, corners[2], corners[1])
        _remember_edge(edges, state, corners[0], corners[2])
        for corner in range(3):
            if is_new[corner]:
                vertices[state[_VERTICES] & 15] = corners[corner]
                state[_VERTICES] += 1
            out[3 * triangle + corner] = corners[corner]
    return bool(state[_AT] == end)


@njit(cache=True)
def _triangle_on_edge(
    stream: np.ndarray, code: int, state: np.ndarray, edges: np.ndarray, vertices: np.ndarray, corners: np.ndarray,
    is_new: np.ndarray,
) -> None:  # fmt: skip
    """A triangle on a recent edge."""
    edge, low = (state[_EDGES] - 1 - (code >> 4)) & 15, code & 15
    corners[0], corners[1] = edges[edge, 0], edges[edge, 1]
    is_new[0] = is_new[1] = False
    is_new[2] = low == 0 or low >= 13
    if low == 0:
        corners[2] = state[_NEXT]
        state[_NEXT] += 1
    elif low < 13:
        corners[2] = vertices[(state[_VERTICES] - 1 - low) & 15]
    elif low < 15:
        state[_LAST] = (state[_LAST] + 2 * low - 27) & 0xFFFFFFFF  # 13 is one less, 14 one more
        corners[2] = state[_LAST]
    else:
        corners[2] = _stored_index(stream, state)


@njit(cache=True)
def _free_triangle(
    stream: np.ndarray, code: int, state: np.ndarray, vertices: np.ndarray, corners: np.ndarray, is_new: np.ndarray
) -> None:
    """A triangle on no recent edge."""
    end = len(stream) - 16
    if code < 0xFE:
        pair = int(np.int64(stream[end + (code & 15)]))
    elif state[_AT] < end:
        pair = int(np.int64(stream[state[_AT]]))
        state[_AT] += 1
        if pair == 0:
            state[_NEXT] = 0
    else:
        state[_AT] = -1
        return
    for corner, how in enumerate((15 if code == 0xFF else 0, int(pair >> 4), int(pair & 15))):
        if how == 0:
            corners[corner] = state[_NEXT]
            state[_NEXT] += 1
        elif how < 15 or code < 0xFE:
            corners[corner] = vertices[(state[_VERTICES] - how) & 15]
        else:
            corners[corner] = _stored_index(stream, state)
        is_new[corner] = how == 0 or how == 15


@njit(cache=True)
def _stored_index(stream: np.ndarray, state: np.ndarray) -> int:
    """An index that is stored as the difference to the last one."""
    if state[_AT] < 0:
        return 0
    delta, state[_AT] = _read_varint(stream, state[_AT], len(stream) - 16)
    state[_LAST] = (state[_LAST] + _zigzag(delta)) & 0xFFFFFFFF
    return int(state[_LAST])


@njit(cache=True)
def _remember_edge(edges: np.ndarray, state: np.ndarray, a: int, b: int) -> None:
    place = state[_EDGES] & 15
    edges[place, 0], edges[place, 1] = a, b
    state[_EDGES] += 1
