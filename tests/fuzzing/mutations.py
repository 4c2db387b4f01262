"""Damage to files: bytes and numbers at random, and the parts of archives behind their checksums."""

import json
import random
import re
import struct
from collections.abc import Callable
from io import BytesIO
from typing import Any
from zipfile import ZipFile, ZipInfo

from tests.fuzzing.folders import is_folder, packed, unpacked

DIGITS = b"9" * 5000
"""More than Python makes a whole number of."""
NUMBERS = (b"nan", b"inf", b"-1", b"0", b"1e39", b"-1e308", b"9" * 30, b"2147483648", b"0x10", b"", b"--5", DIGITS)
"""What replaces a number of a text."""
INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
VALUES = (-1, 1e30, 0.5, None, True, "0", [], {}, [0], [1, 2, 3], 10**30)
"""What replaces a value of JSON."""
FLOATS = (float("nan"), float("inf"), -1e39, 1e-45, 3e38)


def mutant(seed: bytes, random_: random.Random) -> bytes:
    """One change of a file, or a few."""
    content = seed
    for _ in range(random_.choice((1, 1, 1, 2, 3))):
        content = _change_of(seed, random_)(content, random_)
    return content


def _change_of(seed: bytes, random_: random.Random) -> Callable[[bytes, random.Random], bytes]:
    changes = [_bits, _word, _cut, _repeat]
    if is_folder(seed):
        changes = [_file]
    elif seed.startswith(b"PK"):
        changes += [_member] * 16
    elif seed[8:9] == b"{":
        changes += [_header] * 12
    elif seed.startswith(b"Kaydara"):
        changes += [_record] * 12
    elif seed.startswith(b"glTF"):
        changes += [_document] * 16
    elif seed.startswith(b"{"):
        changes += [_json] * 9 + [_number] * 5 + [_line] * 2
    elif b"\0" not in seed:
        changes += [_number] * 9 + [_line] * 3
    return random_.choice(changes)


def _bits(content: bytes, random_: random.Random) -> bytes:
    out = bytearray(content)
    for _ in range(random_.randint(1, 8)):
        if out:
            out[random_.randrange(len(out))] = random_.randrange(256)
    return bytes(out)


def _word(content: bytes, random_: random.Random) -> bytes:
    """A 32-bit number, most often near the start, where sizes are."""
    reach = len(content) - 4 if random_.random() < 0.3 else min(len(content) - 4, 200)
    if reach < 0:
        return content
    is_float = random_.random() < 0.3
    word = struct.pack("<f", _single(random_)) if is_float else struct.pack("<I", random_.choice(INTEGERS))
    at = random_.randint(0, reach // 4) * 4
    return content[:at] + word + content[at + 4 :]


def _single(random_: random.Random) -> float:
    value = random_.choice(FLOATS)
    return value if abs(value) < 3.4e38 else float("-inf")


def _cut(content: bytes, random_: random.Random) -> bytes:
    start, end = sorted(random_.randint(0, len(content)) for _ in range(2))
    return content[:end] if random_.random() < 0.5 else content[:start] + content[end:]


def _repeat(content: bytes, random_: random.Random) -> bytes:
    start, end = sorted(random_.randint(0, len(content)) for _ in range(2))
    return content[:end] + content[start : min(end, start + 4096)] * random_.randint(1, 3) + content[end:]


def _number(content: bytes, random_: random.Random) -> bytes:
    places = list(re.finditer(rb"-?\d+(\.\d+)?(e-?\d+)?", content))
    if not places:
        return content
    place = random_.choice(places)
    return content[: place.start()] + random_.choice(NUMBERS) + content[place.end() :]


def _line(content: bytes, random_: random.Random) -> bytes:
    lines = content.split(b"\n")
    at, other = random_.randrange(len(lines)), random_.randrange(len(lines))
    how = random_.randrange(3)
    if how == 0:
        lines[at : at + random_.randint(1, 5)] = []
    elif how == 1:
        lines.insert(at, lines[other])
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


def _header(content: bytes, random_: random.Random) -> bytes:
    """A change in the JSON of a .safetensors file, whose length then fits, or of a number in one of its texts."""
    (size,) = struct.unpack("<Q", content[:8])
    header, rest = content[8 : 8 + size], content[8 + size :]
    try:
        fields = json.loads(header)
        name = random_.choice(list(fields))
        how = random_.randrange(4)
        if how == 0:
            del fields[name]
        elif how == 1 and name != "__metadata__":
            fields[name][random_.choice(("shape", "data_offsets"))] = [random_.choice(INTEGERS) for _ in range(2)]
        else:
            notes = fields["__metadata__"]
            key = random_.choice(list(notes))
            notes[key] = (_number if how == 2 else _bits)(notes[key].encode(), random_).decode(errors="replace")
        header = json.dumps(fields).encode()
    except (ValueError, KeyError, TypeError, IndexError, AttributeError):
        header = _bits(header, random_)
    return struct.pack("<Q", len(header)) + header + rest


def _document(content: bytes, random_: random.Random) -> bytes:
    """A changed, missing or repeated value of a .glb's JSON, whose length then fits, or changes in what follows it."""
    size = int.from_bytes(content[12:16], "little")
    text, rest = content[20 : 20 + size], content[20 + size :]
    if random_.random() < 0.2:
        return content[: 20 + size] + rest[:8] + _bits(rest[8:], random_)
    try:
        document = json.loads(text)
        _change_value(document, random_)
        text = json.dumps(document).encode()
    except (ValueError, IndexError):
        text = _number(text, random_)
    text += b" " * (-len(text) % 4)
    return content[:12] + struct.pack("<I", len(text)) + content[16:20] + text + rest


def _json(content: bytes, random_: random.Random) -> bytes:
    """A changed, missing or repeated value of a JSON text, or another value in place of all."""
    try:
        document = json.loads(content)
        if random_.random() < 0.05:
            document = random_.choice(VALUES)
        else:
            _change_value(document, random_)
        return json.dumps(document, indent=1).encode()
    except (ValueError, IndexError, TypeError):
        return _number(content, random_)


def _file(content: bytes, random_: random.Random) -> bytes:
    """A file of a folder that has changed, is missing, or holds what another one should."""
    files = unpacked(content)
    if not files:
        return content
    # A text says what is in the other files.
    name = random_.choice([name for name in files for _ in range(5 if name.endswith(".json") else 1)])
    how = random_.randrange(12)
    if how == 0:
        del files[name]
    elif how == 1:
        files[name] = files[random_.choice(list(files))]
    else:
        files[name] = _change_of(files[name], random_)(files[name], random_)
    return packed(files)


def _record(content: bytes, random_: random.Random) -> bytes:
    """Changes near the name of a record of an .fbx: in its sizes, or in the properties after it."""
    names = list(re.finditer(rb"[A-Z][A-Za-z0-9]{3,}", content))
    if not names:
        return content
    place = random_.choice(names)
    if random_.random() < 0.1:
        start = max(place.start() - 13, 0)
        return content[:start] + _word(content[start : place.start()], random_) + content[place.start() :]
    start, end = place.end(), place.end() + 45
    return content[:start] + _property(content[start:end], random_) + content[end:]


def _property(content: bytes, random_: random.Random) -> bytes:
    """Another number: a single one after the letter of its type, or one of the first of an array after its sizes."""
    integer = random_.choice((*INTEGERS, random_.randrange(40), 1000 + random_.randrange(40)))
    real = random_.choice((*FLOATS, 1e300, -1.0, 0.0, 1e9))
    forms = {b"C": bytes([integer & 1]), b"I": struct.pack("<I", integer), b"L": struct.pack("<q", integer),
             b"D": struct.pack("<d", real)}  # fmt: skip
    arrays = {b"i": forms[b"I"], b"l": forms[b"L"], b"d": forms[b"D"], b"f": struct.pack("<f", _single(random_))}
    written = arrays.get(content[:1])
    if written is not None:
        at = 13 + random_.randrange(4) * len(written)
    else:
        letters = [index for index in range(len(content)) if content[index : index + 1] in forms]
        at = random_.choice(letters or [0])
        written, at = forms.get(content[at : at + 1], b"\xff"), at + 1
    return (content[:at] + written + content[at + len(written) :])[: len(content)]


def _change_value(document: Any, random_: random.Random) -> None:
    """Change a value somewhere in nested lists and dictionaries."""
    place = document
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        key = random_.choice(keys)
        below = place[key]
        if not isinstance(below, dict | list) or not below or random_.random() < 0.1:
            break
        place = below
    if random_.random() < 0.2:
        del place[key]
    elif isinstance(below, str):
        place[key] = random_.choice(("", "STEP", "CUBICSPLINE", "rotation", "weights", "VEC4", "\n", "x" * 5000))
    else:
        near = [below - 1, below + 1, 2 * below] if isinstance(below, int | float) else [[below], {}]
        place[key] = random_.choice((*near, *near, *near, *INTEGERS, *VALUES))


def _member(content: bytes, random_: random.Random) -> bytes:
    """A changed, missing or renamed array of an .npz, whose checksums then fit."""
    try:
        with ZipFile(BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # another change has damaged the archive
        return _bits(content, random_)
    if not members:
        return content
    name, how = random_.choice(list(members)), random_.randrange(8)
    if how == 0:
        del members[name]
    elif how == 1:
        members[random_.choice(list(members))] = members[name]
    elif how == 2:
        members[name] = _array_header(members[name], random_)
    elif how == 3:
        members[name] = _cut(members[name], random_)
    else:
        start = members[name].find(b"\n") + 1
        changed = random_.choice((_bits, _word))(members[name][start:], random_)
        members[name] = members[name][:start] + changed
    out = BytesIO()
    with ZipFile(out, "w") as archive:
        for name, data in members.items():
            archive.writestr(ZipInfo(name), data)  # a name alone would be dated, and the mutant another every 2 s
    return out.getvalue()


def _array_header(member: bytes, random_: random.Random) -> bytes:
    """Another shape, type or order in the header of an .npy."""
    end = member.find(b"\n") + 1
    header, places = member[:end], list(re.finditer(rb"\d+|<f[48]|False|<i[48]", member[10:end]))
    if not places:
        return _bits(member, random_)
    place = random_.choice(places)
    start, stop = 10 + place.start(), 10 + place.end()
    other = random_.choice((b"0", b"-1", b"9", b"4294967296", b"<f8", b">f4", b"<i8", b"|O", b"<U9", b"True", b"<c8"))
    length = stop - start
    # The header keeps its length: blanks are read over.
    padded = header[:start] + other[:length].ljust(length) + header[stop:]
    return padded + member[end:]
