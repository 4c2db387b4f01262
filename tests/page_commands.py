"""Commands on the pages of the docs, and small files under the names that pages give to files of their reader.

A comment before a block, which readers of the page do not see, says what the tests do with it:

    <!-- test: slow -->                     takes more than some seconds: runs with the slow tests
    <!-- test: slow, with --steps 2 -->     the same, and these options have these values where a command has them
    <!-- test: skip, needs a launcher -->   can't run here: its commands are parsed, and not run
"""

import glob
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import quaffure as qf
from quaffure.baselines import PosedDraper
from quaffure.body import Motion
from quaffure.io import write_groom
from tests.test_groom_files import tfx4_bytes
from tests.test_retarget import CHANNELS, SKELETON

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^    .*\n)+", re.MULTILINE)
DIRECTIVE = re.compile(r"<!-- test: (slow|slow, with (?:--[a-z-]+ [\w:]+ ?)+|skip, [^>]+?) ?-->\s*$")
SHELLS = ("bash", "console", "sh")
SERVES = "view"
"""The command that runs until Ctrl-C."""
PROGRAMS = ("quaffure", "python", "python3", "torchrun", "pip", "make", "mkdir", "source", "apt-get")
PARTS = ("back", "front_top", "side", "tail")
FRAMES_OF_MOTION = {"dance.bvh": 121, "walk.bvh": 41}


@dataclass(frozen=True)
class Command:
    """A line of a shell block.

    Attributes:
        line: as on the page; continued lines are joined.
        kind: empty, "slow", "slow, with OPTIONS" or "skip, REASON".
    """

    line: str
    kind: str

    @property
    def words(self) -> list[str]:
        """As a shell splits the line: without its comment, with file names for patterns."""
        words = []
        for word in shlex.split(self.line, comments=True):
            words += sorted(glob.glob(word)) or [word]
        return words

    @property
    def arguments(self) -> list[str]:
        """Of `quaffure`, with the values that the page's comment gives to options of this command."""
        arguments = self.words[1:]
        for option, value in re.findall(r"(--[a-z-]+) ([\w:]+)", self.kind.partition("slow, with ")[2]):
            if option in arguments:
                arguments[arguments.index(option) + 1] = value
        return arguments

    @property
    def is_slow(self) -> bool:
        return self.kind.startswith("slow")

    @property
    def runs(self) -> bool:
        """Whether the tests run it: `quaffure`, unless the page says otherwise."""
        is_ours = self.line.startswith("quaffure ") and not self.line.startswith(f"quaffure {SERVES}")
        return is_ours and not self.kind.startswith("skip")


def commands(text: str) -> Iterator[Command]:
    """Every command of a page, in its order."""
    for kind, block in _shell_blocks(text):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.strip().removeprefix("$ ")
            if line and not line.startswith("#"):
                yield Command(line, kind)


def _shell_blocks(text: str) -> Iterator[tuple[str, str]]:
    """The kind and the text of fenced shell blocks, and of indented ones that begin with a program."""
    found = []
    for match in FENCE.finditer(text):
        if match[1] in SHELLS:
            found.append((match.start(), match[2]))
    outside = FENCE.sub(lambda match: re.sub(r"[^\n]", "-", match[0]), text)
    for match in INDENTED.finditer(outside):
        lines = re.sub(r"^    ", "", match[0], flags=re.MULTILINE)
        if lines.split()[:1] and lines.split()[0] in PROGRAMS:
            found.append((match.start(), lines))
    for start, block in sorted(found):
        directive = DIRECTIVE.search(text[:start])
        yield directive[1].strip() if directive else "", block


def table_of(text: str) -> str | None:
    """The table of characters on a page."""
    match = re.search(r"(?:^    .*,.*\n)+", text, re.MULTILINE)
    return None if match is None else re.sub(r"^    ", "", match[0], flags=re.MULTILINE)


def write_inputs(folder: Path, page: str) -> None:
    """The files that commands of a page read, by the names that it gives them."""
    rest = Motion(torch.zeros(1, 81), 30.0, "rest")
    hair = qf.drape_clip(qf.load_groom("bob"), rest, draper=PosedDraper())
    writers = {
        "my_hair.hair": lambda path: qf.save_drape(hair, path),
        "theirs.usd": lambda path: qf.save_drape(hair, path),
        "theirs.abc": lambda path: qf.save_drape(hair, path),
        "hair.abc": lambda path: qf.save_drape(hair, path),
        "dance.bvh": lambda path: path.write_text(motion_text(FRAMES_OF_MOTION[path.name])),
        "walk.bvh": lambda path: path.write_text(motion_text(FRAMES_OF_MOTION[path.name])),
        "characters.csv": lambda path: path.write_text(table_of(page) or ""),
    }
    for part, strands in zip(PARTS, np.array_split(hair.strands[0], len(PARTS))):
        writers[f"{part}.tfx"] = lambda path, strands=strands: path.write_bytes(tfx4_bytes(list(strands)))
    if "mine.npz" in page and "--out mine.npz" not in page:
        writers["mine.npz"] = lambda path: write_groom(path, qf.load_groom("bob"))
    for name, write in writers.items():
        if name in page:
            write(folder / name)
    (folder / "out").mkdir()


def motion_text(frames: int) -> str:
    """A .bvh of a skeleton with common joint names that shakes its head."""
    children: dict[str, list[str]] = {name: [] for name, _, _ in SKELETON}
    for name, parent, _ in SKELETON:
        children.get(parent, []).append(name)
    offsets, order = {name: offset for name, _, offset in SKELETON}, []

    def joint(name: str, depth: int) -> str:
        order.append(name)
        pad = "  " * depth
        position = "" if depth else "Xposition Yposition Zposition "
        inside = [f"OFFSET {' '.join(map(str, offsets[name]))}"]
        inside.append(f"CHANNELS {3 if depth else 6} {position}{' '.join(CHANNELS)}")
        inside += [joint(child, depth + 1) for child in children[name]] or ["End Site\n{\nOFFSET 0 5 0\n}"]
        return f"{pad}{'JOINT' if depth else 'ROOT'} {name}\n{{\n" + "\n".join(inside) + "\n}"

    hierarchy = joint(SKELETON[0][0], 0)
    lines = []
    for frame in range(frames):
        angles = np.zeros((len(order), 3))
        angles[order.index("head"), 2] = 20 * np.sin(frame / 15)
        lines.append(" ".join(f"{number:.4f}" for number in (0, 90, 0, *angles.ravel())))
    return f"HIERARCHY\n{hierarchy}\nMOTION\nFrames: {frames}\nFrame Time: 0.0333333\n" + "\n".join(lines) + "\n"
