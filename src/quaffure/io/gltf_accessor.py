"""Arrays of a glTF file: accessors on views of its buffers, sparse, normalized, interleaved or compressed."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Shaped

from quaffure.errors import refused
from quaffure.io.character_limits import LARGEST_NUMBER
from quaffure.io.gltf_document import Bytes, GltfDocument
from quaffure.io.gltf_entry import Entry
from quaffure.io.meshopt import decode_meshopt, least_size

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MESHOPT = "EXT_meshopt_compression"


@dataclass
class GltfArrays:
    """The arrays of a file, by the index of their accessors; each is decoded once."""

    document: GltfDocument
    _views: dict[int, Bytes] = field(default_factory=dict)
    _arrays: dict[int, np.ndarray] = field(default_factory=dict)

    @cached_property
    def accessors(self) -> list[Entry]:
        return self.document.root.entries("accessors")

    @cached_property
    def views(self) -> list[Entry]:
        return self.document.root.entries("bufferViews")

    def floats(self, index: int, kind: str, most: float = LARGEST_NUMBER) -> Float[np.ndarray, "n c"]:
        """Real numbers, normalized ones of -1 to 1 or 0 to 1, in single precision.

        Raises:
            InputError: another kind of accessor, or numbers that are not finite or beyond `most`.
        """
        entry, values = self.accessors[index], self._array(index, (kind,))
        self.document.take(8 * values.size, entry)  # converted, and compared
        if values.dtype.kind != "f":
            largest = np.iinfo(values.dtype).max
            is_normalized = entry.flag("normalized")
            values = values.astype(np.float32)
            if is_normalized:
                values = np.maximum(values / np.float32(largest), -1)
        if not (np.abs(values) <= most).all():
            entry.fail(f"numbers within {most:g}", "others")
        return values

    def integers(self, index: int, kinds: tuple[str, ...], below: int) -> Int[np.ndarray, "n c"]:
        """Whole numbers from 0, such as indices.

        Raises:
            InputError: another kind of accessor, or numbers from `below` up.
        """
        entry, values = self.accessors[index], self._array(index, kinds)
        if values.dtype.kind == "f":
            entry.fail("whole numbers", "real ones")
        self.document.take(8 * values.size, entry)
        integers = values.astype(np.int64)
        if len(integers) and not 0 <= int(integers.min()) <= int(integers.max()) < below:
            entry.fail(f"indices below {below}", f"{int(integers.min())} to {int(integers.max())}")
        return integers

    def _array(self, index: int, kinds: tuple[str, ...]) -> Shaped[np.ndarray, "n c"]:
        entry = self.accessors[index]
        if (kind := entry.text("type")) not in kinds:
            entry.fail(f"type {' or '.join(kinds)}", f"{kind[:20]!r}")
        if index not in self._arrays:
            self._arrays[index] = self._decoded(entry, WIDTHS[kind])
        return self._arrays[index]

    def _decoded(self, entry: Entry, width: int) -> Shaped[np.ndarray, "n c"]:
        count = entry.integer("count", least=1)
        dtype = _component(entry)
        sparse = entry.entry("sparse")
        if "bufferView" not in entry or sparse is not None:
            self.document.take(2 * count * width * dtype.itemsize, entry)
        if "bufferView" in entry:
            values = self._strided(entry, dtype, count, width)
        else:
            values = np.zeros((count, width), dtype)
        if sparse is None:
            return values
        changed = sparse.integer("count", least=1, most=count)
        indices, replaced = sparse.required("indices"), sparse.required("values")
        places = self._strided(indices, _component(indices), changed, 1)[:, 0]
        if places.dtype.kind != "u" or int(places.max()) >= count:
            indices.fail(f"indices below {count}", "others")
        values = values.copy()
        values[places] = self._strided(replaced, dtype, changed, width)
        return values

    def _strided(
        self, entry: Entry, dtype: "np.dtype[np.generic]", count: int, width: int
    ) -> Shaped[np.ndarray, "n c"]:
        """Elements of a view, without a copy where they follow one another."""
        index = entry.index("bufferView", len(self.views))
        content, size = self._view(index), width * dtype.itemsize
        stride = self.views[index].integer("byteStride", size, most=256) or size
        offset = entry.integer("byteOffset", 0)
        if stride < size:
            entry.fail(f"elements of at most {stride} bytes, their stride", f"{size} bytes")
        end = offset + stride * (count - 1) + size
        if end > len(content):
            entry.fail(f"{end} bytes in its buffer view", f"{len(content)}")
        return np.ndarray((count, width), dtype, content.data, offset, (stride, dtype.itemsize))

    def _view(self, index: int) -> Bytes:
        if index not in self._views:
            entry = self.views[index]
            meshopt = entry.extension(MESHOPT)
            self._views[index] = self._part(entry) if meshopt is None else self._decompressed(entry, meshopt)
        return self._views[index]

    def _part(self, entry: Entry) -> Bytes:
        """The bytes of its buffer that an entry names."""
        buffer = self.document.buffer(entry.index("buffer", len(self.document.root.entries("buffers"))))
        offset, length = entry.integer("byteOffset", 0), entry.integer("byteLength", least=1)
        if offset + length > len(buffer):
            entry.fail(f"{offset + length} bytes in its buffer", f"{len(buffer)}")
        return buffer[offset : offset + length]

    def _decompressed(self, view: Entry, entry: Entry) -> Bytes:
        count, stride = entry.integer("count", least=1), entry.integer("byteStride", least=2, most=256)
        mode, kind = entry.text("mode"), entry.text("filter", "NONE")
        stream = self._part(entry)
        if count * stride > view.integer("byteLength", least=1):
            view.fail(f"{count * stride} bytes, as it is decompressed", f"{view.integer('byteLength')}")
        if len(stream) < least_size(count, stride, mode):
            entry.fail(f"at least {least_size(count, stride, mode)} compressed bytes", f"{len(stream)}")
        self.document.take(2 * count * stride, view)
        with refused(f"{view.path}, {entry.place}", "a meshopt stream", ValueError):
            return decode_meshopt(stream, count, stride, mode, kind)


def _component(entry: Entry) -> "np.dtype[np.generic]":
    component = entry.integer("componentType")
    if component not in COMPONENTS:
        entry.fail(f"a componentType of {', '.join(map(str, COMPONENTS))}", f"{component}")
    return np.dtype(COMPONENTS[component])
