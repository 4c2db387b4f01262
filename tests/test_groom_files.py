"""Strand files: what is written is read back, hand-built bytes are read right, and damage is always an InputError."""

import contextlib
import os
import re
import struct
import tempfile
import tracemalloc
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quaffure import InputError
from quaffure.hair import Strands
from quaffure.io import replacing
from quaffure.io.read_strands import read_strands

RAGGED = [np.arange(6.0).reshape(2, 3), 10 + np.arange(12.0).reshape(4, 3), 30 + np.arange(9.0).reshape(3, 3)]
EVEN = [np.arange(6.0).reshape(2, 3), -np.arange(6.0).reshape(2, 3), 0.5 + np.arange(6.0).reshape(2, 3)]


def floats(numbers) -> bytes:
    numbers = np.ravel(numbers).tolist()
    return struct.pack(f"<{len(numbers)}f", *numbers)


def hair_bytes(strands, flags, default_segments=0, points=None) -> bytes:
    total = sum(map(len, strands))
    out = b"HAIR" + struct.pack("<4I", len(strands), total if points is None else points, flags, default_segments)
    out += floats([0.1, 0.2, 0.3, 0.4, 0.5]) + b"test".ljust(88, b"\0")
    if flags & 1:
        out += struct.pack(f"<{len(strands)}H", *(len(strand) - 1 for strand in strands))
    out += b"".join(map(floats, strands))
    for flag, width in ((4, 1), (8, 1), (16, 3)):
        out += floats([7.0] * total * width) if flags & flag else b""
    return out


def data_bytes(strands) -> bytes:
    return struct.pack("<i", len(strands)) + b"".join(struct.pack("<i", len(s)) + floats(s) for s in strands)


def bin_bytes(strands) -> bytes:
    wide = [np.hstack([strand, np.full((len(strand), 4), np.nan)]) for strand in strands]
    return struct.pack("<i", len(strands)) + b"".join(struct.pack("<i", len(s)) + floats(s) for s in wide)


def tfx3_bytes(strands, both_ends=0, offset=296, version=3.0) -> bytes:
    out = struct.pack("<f3Ii", version, len(strands), len(strands[0]) if strands else 16, 0, both_ends) + bytes(124)
    out += struct.pack("<6I", offset, 0, 0, 0, 0, 0) + bytes(128)
    return out.ljust(offset, b"\xff") + b"".join(map(floats, strands))


def tfx4_bytes(strands, offset=160, version=4.0) -> bytes:
    out = struct.pack("<f2I", version, len(strands), len(strands[0]) if strands else 16)
    out += struct.pack("<5I", offset, 0, 0, 0, 0) + bytes(128)
    pinned = [np.hstack([strand, [[0.0]] + [[1.0]] * (len(strand) - 1)]) for strand in strands]
    return out.ljust(offset, b"\xff") + b"".join(map(floats, pinned))


def npz_bytes(**members) -> bytes:
    buffer = BytesIO()
    np.savez(buffer, **members)
    return buffer.getvalue()


def ragged_npz(strands) -> bytes:
    return npz_bytes(
        points=np.concatenate([np.empty((0, 3)), *strands]), counts=np.array(list(map(len, strands)), dtype=np.int32)
    )


# suffix, a file of that format, the strands that it holds
GOOD = {
    "hair ragged": (".hair", hair_bytes(RAGGED, 1 | 2), RAGGED),
    "hair default segments": (".hair", hair_bytes(EVEN, 2, default_segments=1), EVEN),
    "hair segments before default": (".hair", hair_bytes(RAGGED, 1 | 2, default_segments=9), RAGGED),
    "hair thickness": (".hair", hair_bytes(RAGGED, 1 | 2 | 4), RAGGED),
    "hair transparency": (".hair", hair_bytes(EVEN, 2 | 8, default_segments=1), EVEN),
    "hair colours": (".hair", hair_bytes(RAGGED, 1 | 2 | 16), RAGGED),
    "hair all": (".hair", hair_bytes(RAGGED, 31), RAGGED),
    "data": (".data", data_bytes(RAGGED), RAGGED),
    "bin": (".bin", bin_bytes(RAGGED), RAGGED),
    "tfx 3": (".tfx", tfx3_bytes(EVEN), EVEN),
    "tfx 3 both ends pinned": (".tfx", tfx3_bytes(EVEN, both_ends=1), EVEN),
    "tfx 3 offset": (".tfx", tfx3_bytes(EVEN, offset=312), EVEN),
    "tfx 3.1": (".tfx", tfx3_bytes(EVEN, version=3.1), EVEN),
    "tfx 4": (".tfx", tfx4_bytes(EVEN), EVEN),
    "tfx 4 offset": (".tfx", tfx4_bytes(EVEN, offset=176), EVEN),
    "npz ragged": (".npz", ragged_npz(RAGGED), RAGGED),
    "npz even": (".npz", npz_bytes(strands=np.float32(EVEN)), EVEN),
}
every_format = pytest.mark.parametrize(("suffix", "content", "strands"), GOOD.values(), ids=GOOD.keys())


def saved(folder: Path, suffix: str, content: bytes) -> Path:
    path = folder / f"groom{suffix}"
    path.write_bytes(content)
    return path


def refusal(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_strands(path)
    assert "\n" not in str(caught.value)
    return caught.value


@every_format
def test_hand_built_files_are_read(tmp_path, suffix, content, strands):
    path = saved(tmp_path, suffix.upper(), content)
    found = read_strands(path)
    assert found.points.dtype == np.float32
    assert found.source == str(path)
    np.testing.assert_array_equal(found.counts, list(map(len, strands)))
    np.testing.assert_array_equal(found.points, np.concatenate(strands).astype(np.float32))
    np.testing.assert_array_equal(found.roots, [strand[0] for strand in strands])


@every_format
def test_every_truncation_is_refused_and_counts_bytes(tmp_path, suffix, content, strands):
    for length in range(len(content)):
        error = refusal(saved(tmp_path, suffix, content[:length]))
        if suffix != ".npz":  # a zip file keeps its sizes at its end
            expected = re.fullmatch(r"at least (\d+) bytes to hold its .*", error.expected)
            assert error.found == f"{length} bytes"
            assert length < int(expected[1]) <= len(content)


@every_format
def test_bytes_after_the_end_are_refused_unless_offsets_name_the_content(tmp_path, suffix, content, strands):
    path = saved(tmp_path, suffix, content + b"trailing")
    if suffix in (".tfx", ".npz"):
        assert len(read_strands(path)) == len(strands)
    else:
        assert f"found {len(content) + 8} bytes" in str(refusal(path))


@settings(deadline=None, max_examples=150)
@given(data=st.data(), name=st.sampled_from(sorted(GOOD)))
def test_damaged_bytes_never_raise_anything_else(data, name):
    suffix, content, _ = GOOD[name]
    damaged = bytearray(content)
    for _ in range(data.draw(st.integers(1, 8))):
        damaged[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = saved(Path(folder), suffix, bytes(damaged))
        with contextlib.suppress(InputError):
            assert len(read_strands(path)) > 0


def npz_claiming(name: str, shape: tuple[int, ...], payload: bytes = b"") -> bytes:
    header, archive = BytesIO(), BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": shape})
    with ZipFile(archive, "w", ZIP_DEFLATED) as file:
        file.writestr(f"{name}.npy", header.getvalue() + payload)
    return archive.getvalue()


def npz_claiming_its_size_too(name: str, shape: tuple[int, ...]) -> bytes:
    """The same, with the uncompressed size in the archive's directory made to agree with the claim."""
    content = bytearray(npz_claiming(name, shape))
    directory = content.index(b"PK\1\2")
    (size,) = struct.unpack_from("<I", content, directory + 24)
    struct.pack_into("<I", content, directory + 24, size + 4 * int(np.prod(shape)))
    return bytes(content)


ABSURD = {
    "hair strands": (".hair", b"HAIR" + struct.pack("<4I", 2**31, 6, 3, 0) + bytes(108) + bytes(72)),
    "hair strands of no points": (".hair", b"HAIR" + struct.pack("<4I", 2**31, 0, 2, 0) + bytes(108)),
    "hair strands and points": (".hair", b"HAIR" + struct.pack("<4I", 2**31, 2**31, 2, 0) + bytes(108)),
    "hair default segments": (".hair", hair_bytes(EVEN, 2, default_segments=2**32 - 1)),
    "hair points": (".hair", hair_bytes(EVEN, 3, points=2**32 - 1)),
    "data strands": (".data", struct.pack("<i", 2**31 - 1) + bytes(64)),
    "data negative": (".data", struct.pack("<i", -1) + bytes(64)),
    "data points": (".data", struct.pack("<2i", 1, 2**31 - 1) + bytes(64)),
    "data negative points": (".data", struct.pack("<2i", 1, -5) + bytes(64)),
    "bin points": (".bin", struct.pack("<2i", 1, 2**31 - 1) + bytes(64)),
    "tfx 3": (".tfx", struct.pack("<f2I", 3.0, 2**31, 16) + tfx3_bytes(EVEN)[12:]),
    "tfx 4": (".tfx", struct.pack("<f2I", 4.0, 2**31, 2**31) + tfx4_bytes(EVEN)[12:]),
    "tfx 4 of no points": (".tfx", struct.pack("<f2I", 4.0, 2**31, 0) + tfx4_bytes(EVEN)[12:]),
    "tfx 4 offset beyond": (".tfx", tfx4_bytes([])[:12] + struct.pack("<I", 2**32 - 1) + tfx4_bytes([])[16:]),
    "npz strands": (".npz", npz_claiming("strands", (2**31, 16, 3), bytes(64))),
    "npz strands of no points": (".npz", npz_claiming("strands", (2**33, 0, 3))),
    "npz strands and size": (".npz", npz_claiming_its_size_too("strands", (2**24, 16, 3))),
    "npz negative": (".npz", npz_claiming("strands", (-1, -8, 3), bytes(96))),
}


@pytest.mark.parametrize(("suffix", "content"), ABSURD.values(), ids=ABSURD.keys())
def test_absurd_sizes_are_refused_before_allocating(tmp_path, suffix, content):
    path = saved(tmp_path, suffix, content)
    tracemalloc.start()
    refusal(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


BUILDERS = {
    "hair": (".hair", lambda strands: hair_bytes(strands, 3)),
    "data": (".data", data_bytes),
    "bin": (".bin", bin_bytes),
    "tfx 3": (".tfx", tfx3_bytes),
    "tfx 4": (".tfx", tfx4_bytes),
    "npz": (".npz", ragged_npz),
}
every_builder = pytest.mark.parametrize(("suffix", "build"), BUILDERS.values(), ids=BUILDERS.keys())


@every_builder
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_coordinates_that_are_not_finite_are_refused(tmp_path, suffix, build, bad):
    strands = [strand.copy() for strand in EVEN]
    strands[1][1, 2] = bad
    assert "in 1 of 6 points" in refusal(saved(tmp_path, suffix, build(strands))).found


@every_builder
def test_zero_strands_are_refused(tmp_path, suffix, build):
    assert refusal(saved(tmp_path, suffix, build([]))).found == "no strands"


@pytest.mark.parametrize(("suffix", "build"), [BUILDERS["data"], BUILDERS["bin"], BUILDERS["npz"], BUILDERS["hair"]])
def test_bald_roots_are_dropped(tmp_path, suffix, build):
    found = read_strands(saved(tmp_path, suffix, build([RAGGED[0][:1], RAGGED[1], RAGGED[2][:1], RAGGED[0]])))
    np.testing.assert_array_equal(found.counts, [4, 2])
    np.testing.assert_array_equal(found.points, np.concatenate([RAGGED[1], RAGGED[0]]))
    assert refusal(saved(tmp_path, suffix, build([RAGGED[0][:1]]))).found == "no strands"


CONTRADICTIONS = {
    "hair magic": (".hair", b"HARE" + hair_bytes(EVEN, 3)[4:], "begins with b'HAIR', found b'HARE'"),
    "hair without points": (".hair", hair_bytes(EVEN, 1), "flag 2"),
    "hair counts": (".hair", hair_bytes(RAGGED, 3, points=8)[:-12], "9 points for its 3 strands, found 8"),
    "tfx version": (".tfx", tfx4_bytes(EVEN, version=2.0), "version 3 or 4, found version 2"),
    "tfx version NaN": (".tfx", tfx4_bytes(EVEN, version=np.nan), "version 3 or 4, found version nan"),
    "tfx offset in header": (".tfx", tfx4_bytes(EVEN, offset=40), "from byte 160 on, found their offset 40"),
    "tfx one point": (".tfx", tfx4_bytes([EVEN[0][:1]]), "at least 2 points a strand, found 1"),
    "npz frames": (".npz", npz_bytes(strands=np.zeros((2, 3, 4, 3))), r"shape [S,N,3], found shape [2, 3, 4, 3]"),
    "npz scalar": (".npz", npz_bytes(points=np.float32(1), counts=np.int64(1)), "shape [P,3], found shape []"),
    "npz real counts": (".npz", npz_bytes(points=np.zeros((4, 3)), counts=np.array([4.0])), "whole numbers"),
    "npz negative": (".npz", npz_bytes(points=np.zeros((4, 3)), counts=np.array([3, 3, -2])), "found -2 to 3"),
    "npz nested counts": (".npz", npz_bytes(points=np.zeros((4, 3)), counts=np.array([[4]])), "of shape [S]"),
    "npz wrapping": (".npz", npz_bytes(points=np.zeros((4, 3)), counts=np.array([2**63 - 1] * 2 + [6])), "from 0 to 4"),
    "npz sum": (".npz", npz_bytes(points=np.zeros((4, 3)), counts=np.array([3])), "3 points for its 1 strands"),
    "npz overflow": (".npz", npz_bytes(strands=np.full((1, 2, 3), 1e300)), "NaN, infinity or more in 2 of 2"),
    "npz text": (".npz", npz_bytes(strands=np.full((1, 2, 3), "a")), "plain numbers"),
    "npz names": (".npz", npz_bytes(points=np.zeros((4, 3))), "counts"),
    "npz not a zip": (".npz", b"points", "undamaged .npz"),
}


@pytest.mark.parametrize(("suffix", "content", "message"), CONTRADICTIONS.values(), ids=CONTRADICTIONS.keys())
def test_contradictions_are_named(tmp_path, suffix, content, message):
    path = saved(tmp_path, suffix, content)
    assert message in str(refusal(path))
    assert str(refusal(path)).startswith(str(path))


def test_arrays_after_unknown_hair_flags_are_passed_over(tmp_path):
    path = saved(tmp_path, ".hair", hair_bytes(RAGGED, 32 | 3) + bytes(40))
    assert len(read_strands(path)) == 3


class Trap:
    """Makes a folder if it is ever unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_pickled_npz_is_refused_and_not_run(tmp_path):
    sprung = tmp_path / "sprung"
    path = saved(tmp_path, ".npz", npz_bytes(strands=np.array([Trap(sprung)], dtype=object)))
    assert "never loaded" in str(refusal(path))
    assert not sprung.exists()
    np.load(path, allow_pickle=True)["strands"]
    assert sprung.exists()  # the trap is a real one


def test_missing_folder_and_unknown_suffix_name_what_is_supported(tmp_path):
    folder = tmp_path / "groom.hair"
    folder.mkdir()
    for name in ("groom.obj", "groom"):
        (tmp_path / name).write_bytes(b"v 0 0 0")
    for path, found in (
        (tmp_path / "none.hair", "no such file"),
        (folder, "a folder"),
        (tmp_path / "groom.obj", "suffix '.obj'"),
        (tmp_path / "groom", "suffix ''"),
    ):
        error = refusal(path)
        assert error.found == found
        for suffix in (".bin", ".data", ".hair", ".npz", ".tfx"):
            assert suffix in error.expected


finite = st.floats(-1e9, 1e9, width=32)
ragged_strands = st.lists(
    st.integers(2, 7).flatmap(lambda count: arrays(np.float32, (count, 3), elements=finite)), min_size=1, max_size=6
)


@pytest.mark.parametrize(
    ("suffix", "content_of"),
    [
        (".hair", lambda strands: hair_bytes(strands, 3)),
        (".npz", lambda strands: npz_bytes(points=np.concatenate(strands), counts=np.array(list(map(len, strands))))),
    ],
)
@settings(deadline=None, max_examples=40)
@given(strands=ragged_strands)
def test_what_is_written_is_read_back(suffix, content_of, strands):
    with tempfile.TemporaryDirectory() as folder:
        found = read_strands(saved(Path(folder), suffix, content_of(strands)))
    assert found.points.tobytes() == np.concatenate(strands).tobytes()
    assert found.counts.tolist() == list(map(len, strands))


def test_a_failed_write_leaves_the_file_as_it_was(tmp_path):
    path = saved(tmp_path, ".npz", b"before")

    def fill_the_disk() -> None:
        with replacing(path) as temporary:
            temporary.write_bytes(b"half")
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match=r"groom\.npz: expected a file that can be written, found No space left"):
        fill_the_disk()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match="existing folder"), replacing(tmp_path / "none" / "groom.npz"):
        pass


GROOMS = Path(__file__).parents[2] / "shared" / "data" / "grooms"


def real_groom(*names: str) -> list[Strands]:
    if not GROOMS.is_dir():
        pytest.skip("the real grooms of ../shared/data/grooms are not on this machine")
    return [read_strands(GROOMS / name) for name in names]


PONYTAIL = tuple(f"ponytail/{part}.tfx" for part in ("back", "front_top", "side", "tail"))


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("names", "strands", "count", "low", "high", "longest_segment"),
    [
        (("sintel/sintel_hair_16points.tfx",), 11400, 16, (-0.12, 1.39, -0.14), (0.11, 1.68, 0.14), 0.017),
        (PONYTAIL, 4933, 16, (-33, -4, -37), (33, 124, 78), 6.4),
        (("mohawk/Ratboy_mohawk.tfx",), 2228, 32, (-0.10, 0.21, -0.34), (0.12, 1.11, 0.28), 0.012),
    ],
    ids=["sintel", "ponytail", "mohawk"],
)
def test_real_grooms(names, strands, count, low, high, longest_segment):
    parts = real_groom(*names)
    assert sum(map(len, parts)) == strands
    assert all((part.counts == count).all() for part in parts)
    points = np.concatenate([part.points for part in parts]).reshape(-1, count, 3)
    assert (points >= low).all()
    assert (points <= high).all()
    assert (points.max((0, 1)) - points.min((0, 1)) > 0.9 * (np.array(high) - low)).all()
    # A wrong stride or offset would join points of different strands.
    assert np.linalg.norm(np.diff(points, axis=1), axis=2).max() < longest_segment


def test_signalling_nan_makes_no_warning(tmp_path: Path) -> None:
    """A NaN that the processor reports where it is converted or added to: of widths left out, of points the end."""
    signalling = np.array([0x7F800001], "<u4").tobytes()
    widths = hair_bytes(EVEN, 2 | 4, default_segments=1).replace(floats([7.0]), signalling, 1)
    strands = read_strands(saved(tmp_path, ".hair", widths))
    assert strands.attributes.width is None
    rooted = np.zeros((2, 3, 3), np.float32)
    rooted[:, 1:, 2] = [[1, 2], [1, 3]]
    rooted.view("<u4")[1, 2, 1] = 0x7F800001
    content = npz_bytes(strands=rooted, roots=np.float32([[1, 0, 0], [2, 0, 0]]))
    assert read_strands(saved(tmp_path, ".npz", content)).counts.tolist() == [3, 2]
