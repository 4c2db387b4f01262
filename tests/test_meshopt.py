"""Streams of EXT_meshopt_compression, decoded to the bytes that meshoptimizer's own decoder gives."""

import contextlib
from base64 import b64decode

import numpy as np
import pytest

from quaffure.io.meshopt import decode_meshopt, least_size

# Mode, filter, count, stride; the stream; and what it decodes to. Encoded and decoded by meshoptimizer 1.3.0 (npm).
STREAMS = {
    "attributes": (
        ("ATTRIBUTES", "NONE", 35, 4),
        (
            "oBUqqqqqqqqqqqgAAAAfAAIGCg4SFhoeIiYqLjI2Oj5CRkpOUlZaXmJmam5ydnr8AAAAfoKGHwDCwsLCwsLCwsLCwsLCwsLCwsLC"
            "wsLCwsLCwsLCwsLC/AAAAMLCwgUQAkAJACQAkAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAF"
        ),
        (
            "AAAABQEBYQQCBMIEAwkjBAQQhAQFGeUEBiRGBAcxpwUIQAgECVFpBApkygQLeSsEDJCMBA2p7QQOxE4FD+GvBBAAEAQRIXEEEkTS"
            "BBNpMwQUkJQEFbn1BRbkVgQXEbcEGEAYBBlxeQQapNoEG9k7BBwQnAUdSf0EHoReBB/BvwQgACAEIUGBBCKE4gQ="
        ),
    ),
    "triangles": (
        ("TRIANGLES", "NONE", 66, 2),
        "4f4eEA4QDo4eFA4TDo4eEw4TDv////8PCKHqDf/5DcIPAk+zDxmWGAB2h1ZneKmGZYlomAFpAAA=",
        (
            "AAABAAQABAABAAUABQABAAIABQACAAYABgACAAMABgADAAcABAAFAAgACAAFAAkACQAFAAYACQAGAAoACgAGAAcACgAHAAsACAAJ"
            "AAwADAAJAA0ADQAJAAoADQAKAA4ADgAKAAsADgALAA8AhAMDAA8ABwDoA+kDDwCEAwIADgANAIQD"
        ),
    ),
    "indices": (
        ("INDICES", "NONE", 66, 4),
        "0QAEDAoQAgoEDAoQAgoEDAoQAgYEDAoQAgoEDAoQAgoEDAoQAgYEDAoQAgoEDAoQAgoEDAoQApEcKjAekQMFIJMDMjACAQAAAAA=",
        (
            "AAAAAAEAAAAEAAAAAQAAAAUAAAAEAAAAAQAAAAIAAAAFAAAAAgAAAAYAAAAFAAAAAgAAAAMAAAAGAAAAAwAAAAcAAAAGAAAABAAA"
            "AAUAAAAIAAAABQAAAAkAAAAIAAAABQAAAAYAAAAJAAAABgAAAAoAAAAJAAAABgAAAAcAAAAKAAAABwAAAAsAAAAKAAAACAAAAAkA"
            "AAAMAAAACQAAAA0AAAAMAAAACQAAAAoAAAANAAAACgAAAA4AAAANAAAACgAAAAsAAAAOAAAACwAAAA8AAAAOAAAAhAMAAAMAAAAP"
            "AAAABwAAAOgDAADpAwAADwAAAIQDAAACAAAADgAAAA0AAACEAwAA"
        ),
    ),
    "normals 8": (
        ("ATTRIBUTES", "OCTAHEDRAL", 5, 4),
        "oAE/wAAA/f5cpgE/wAAA/W8mtwABD8AAAAQD/QAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAB/AH9/",
        "fwAAfwCBAH9MAJqBxEyufwAAfwA=",
    ),
    "normals 16": (
        ("ATTRIBUTES", "OCTAHEDRAL", 5, 8),
        (
            "oAEnwAAAZ2oBP8AAAA0OGQwBL8AAAN1keAE+wAAADxgJAAABD4AAAAQDAQnAAAD9AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA/wcA"
            "AP8H/38="
        ),
        "/38AAAAA/38AAAGAAAD/f8VMAACVmQGAl8LKTA2u/38AAAAA/38AAA==",
    ),
    "rotations": (
        ("ATTRIBUTES", "QUATERNION", 5, 8),
        (
            "oAE8wAAAwL/0ATzAAAAtLgkBP8AAAL8w3PEBN8AAACwMCAE/wAAAv3RM8wE/wAAALGM4CAE+wAAABQQDAAAAAAAAAAAAAAAAAAAA"
            "AAAAAAAAAAAAAAAAAAAAAP8f"
        ),
        "AAAAAAAA/3//PwDAAEAAQG89NbPsUQAAAADLTAAAZmbMDJhZNPOaWQ==",
    ),
    "reals": (
        ("ATTRIBUTES", "EXPONENTIAL", 6, 4),
        "oAEP8AAAg/BrcgEP8AAAYlMN1wE/8AAAERIECwsBL/AAAClC47EAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAE7g==",
        "AACAPwAAIMDAN4Y1wOZARgAAAADgeK3g",
    ),
}
TOLERANCE = 1
"""Of what filters round, in units of the last place: as much as the specification leaves open."""


def stream_of(name: str) -> np.ndarray:
    return np.frombuffer(b64decode(STREAMS[name][1]), np.uint8)


@pytest.mark.parametrize("name", STREAMS)
def test_streams_decode_to_the_bytes_of_the_reference(name: str) -> None:
    (mode, kind, count, stride), _, expected = STREAMS[name]
    found = decode_meshopt(stream_of(name), count, stride, mode, kind)
    dtype = {"OCTAHEDRAL": f"i{stride // 4}", "QUATERNION": "i2"}.get(kind, "u1")
    wanted = np.frombuffer(b64decode(expected), dtype)
    difference = np.abs(found.view(dtype).astype(int) - wanted.astype(int)).max()
    assert difference <= (0 if dtype == "u1" else TOLERANCE)


def test_the_example_of_the_specification() -> None:
    """Appendix A: sixteen deltas in four bits each, of which two follow in full."""
    group = bytes.fromhex("175ff0bc77a9210034b5")
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    stream = b"\xa0" + b"\x02" + group + bytes([0, 0, 0]) + bytes(28) + bytes([7, 1, 2, 3])
    found = decode_meshopt(np.frombuffer(stream, np.uint8), 16, 4, "ATTRIBUTES").reshape(16, 4)
    np.testing.assert_array_equal(found[:, 0], np.uint8((7 + np.cumsum(deltas)) & 0xFF))
    np.testing.assert_array_equal(found[:, 1:], [[1, 2, 3]] * 16)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "attributes" else []) for name in STREAMS]
)
def test_damaged_streams_are_refused_or_decoded(name: str) -> None:
    """Every byte changed, every length: never a read or a write out of bounds, which would end the process."""
    (mode, kind, count, stride), _, _ = STREAMS[name]
    stream, random = stream_of(name), np.random.default_rng(1)
    for place in range(len(stream)):
        damaged = stream.copy()
        damaged[place] = random.integers(256)
        with contextlib.suppress(ValueError):
            assert len(decode_meshopt(damaged, count, stride, mode, kind)) == count * stride
        with pytest.raises(ValueError, match=r"compressed bytes|begins with"):
            decode_meshopt(stream[:place], count, stride, mode, kind)


@pytest.mark.parametrize(
    ("mode", "kind", "count", "stride", "message"),
    [
        ("LINES", "NONE", 3, 4, "mode 'LINES'"),
        ("ATTRIBUTES", "NONE", 3, 6, "stride 6"),
        ("ATTRIBUTES", "OCTAHEDRAL", 3, 12, "stride 12"),
        ("ATTRIBUTES", "COLOUR", 3, 4, "filter 'COLOUR'"),
        ("TRIANGLES", "NONE", 4, 2, "4 indices of triangles"),
        ("INDICES", "NONE", 3, 8, "stride 8"),
        ("INDICES", "NONE", 3, 4, "begins with 0x7"),
        ("ATTRIBUTES", "NONE", 10**6, 4, "compressed bytes for 1000000 elements"),
    ],
)
def test_what_is_no_stream(mode: str, kind: str, count: int, stride: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        decode_meshopt(np.full(100, 7, np.uint8), count, stride, mode, kind)


def test_least_sizes_bound_the_memory_that_a_stream_takes() -> None:
    for stride in (4, 16, 256):
        assert 10_000 * stride <= 64 * least_size(10_000, stride, "ATTRIBUTES")
    assert least_size(300, 4, "TRIANGLES") == 1 + 100 + 16
    assert least_size(300, 4, "INDICES") == 1 + 300 + 4
