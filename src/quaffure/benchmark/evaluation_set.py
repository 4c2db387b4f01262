"""The evaluation set: clips, shapes and grooms that no training uses, in one versioned file of the package."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.clips import CLIP_NAMES, bundled_clip
from quaffure.body.motion import Motion, resample
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.load_groom import load_groom
from quaffure.io.read_motion import read_motion
from quaffure.scene import BodyBatch
from quaffure.types import Float, Tensor

LEAST_RUN = 3
"""Frames in a row that have an acceleration."""


@dataclass(frozen=True)
class GroomSource:
    """Where a groom of the set comes from.

    Attributes:
        group: `seen` if training may use the groom, else `unseen`.
        file, head: in the folder of grooms; empty for a bundled style.
    """

    group: str
    file: str = ""
    head: str = ""


@dataclass(frozen=True)
class CaseEntry:
    """One line of the set: a groom, a clip, a shape of the body, and frames at the set's rate.

    Attributes:
        shape: letter of the shape.
    """

    groom: str
    clip: str
    shape: str
    frames: tuple[int, ...]

    @property
    def name(self) -> str:
        return f"{self.groom}-{self.clip}-{self.shape}"


@dataclass(frozen=True)
class EvaluationSet:
    """The whole file.

    Attributes:
        version: changes whenever a case does: metrics of two versions cannot be compared.
        fps: rate at which frames count.
        motions: stems of the motion files; other clips are bundled ones.
        shapes: ten coefficients of each shape [standard deviations].
        quick: names of the cases of a quick evaluation.
    """

    version: int
    fps: float
    motions: tuple[str, ...]
    shapes: dict[str, tuple[float, ...]]
    grooms: dict[str, GroomSource]
    cases: tuple[CaseEntry, ...]
    quick: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """A groom on a body in some frames, ready to drape.

    Attributes:
        group: `seen`, `unseen` or `own`.
        motion: the frames of the clip, and nothing else.
        frames: which ones they are.
    """

    name: str
    group: str
    shape: str
    groom: Groom
    motion: Motion
    frames: tuple[int, ...]
    body_shape: Float[Tensor, "10"]

    @property
    def is_run(self) -> bool:
        """Whether the frames follow each other, so that hair can jitter between them."""
        steps = [after - before for before, after in zip(self.frames, self.frames[1:])]
        return len(self.frames) >= LEAST_RUN and all(step == 1 for step in steps)

    def bodies(self, body: BodyModel, frame: int | None = None) -> BodyBatch:
        """The posed bodies of all frames, or of one, counted within the case."""
        chosen = slice(None) if frame is None else slice(frame, frame + 1)
        body_pose = self.motion.body_pose[chosen]
        return BodyBatch(body, body_pose, self.body_shape.expand(len(body_pose), -1))


@cache
def load_evaluation_set() -> EvaluationSet:
    """The set that comes with the package."""
    content = json.loads((files("quaffure") / "assets" / "evaluation_set.json").read_text(encoding="utf-8"))
    return EvaluationSet(
        version=content["version"],
        fps=float(content["fps"]),
        motions=tuple(content["motions"]),
        shapes={name: tuple(values) for name, values in content["shapes"].items()},
        grooms={name: GroomSource(**source) for name, source in content["grooms"].items()},
        cases=tuple(CaseEntry(**entry | {"frames": tuple(entry["frames"])}) for entry in content["cases"]),
        quick=tuple(content["quick"]),
    )


def refuse_evaluation_data(grooms: Iterable[str | Path] = (), motions: Iterable[str | Path] = ()) -> None:
    """Keep out of a training what it is evaluated on: every clip of the set, and its grooms of the group `unseen`.

    Args:
        grooms, motions: bundled names or files. Names and stems of files count, in any case: a copy of a held-out
            groom is one as well.

    Raises:
        InputError: one of them is in the set.
    """
    of = load_evaluation_set()
    clips = {name.lower() for name in (*of.motions, *(entry.clip for entry in of.cases))}
    unseen = {name.lower() for name, source in of.grooms.items() if source.group == "unseen"}
    for path in map(Path, grooms):
        if path.stem.lower() in unseen:
            raise InputError(f"groom {path}", "a groom that is not held out for evaluation", path.stem)
    for path in map(Path, motions):
        if path.stem.lower() in clips:
            expected = "a clip that is not in the evaluation set (one of your own needs another name)"
            raise InputError(f"motion {path}", expected, path.stem)


@dataclass(frozen=True)
class DataFolders:
    """Folders of the files of the set that the package does not ship. Either folder may be missing.

    Attributes:
        motions: holds `<clip>.bvh`.
        grooms: holds the files of `GroomSource`.
    """

    motions: Path
    grooms: Path

    def motion(self, clip: str) -> Path:
        return self.motions / f"{clip}.bvh"

    def missing(self, entry: CaseEntry, of: EvaluationSet) -> Path | None:
        """The first file that a case needs and that is not there."""
        source = of.grooms[entry.groom]
        needed = [self.motion(entry.clip)] if entry.clip not in CLIP_NAMES else []
        needed += [self.grooms / name for name in (source.file, source.head) if name]
        return next((path for path in needed if not path.is_file()), None)


def load_cases(
    entries: Sequence[CaseEntry], of: EvaluationSet, folders: DataFolders, body: BodyModel
) -> Iterator[EvaluationCase]:
    """The cases, one after the other; each groom and clip is loaded once, when it is first needed.

    Raises:
        InputError: a file of the set is missing or broken, or its clip ends before a frame of the set.
    """

    @cache
    def groom_of(name: str) -> Groom:
        source = of.grooms[name]
        if not source.file:
            return load_groom(name, body)
        head = folders.grooms / source.head if source.head else None
        return replace(load_groom(folders.grooms / source.file, body, head), name=name)

    @cache
    def clip_of(name: str) -> Motion:
        clip = bundled_clip(name, body) if name in CLIP_NAMES else read_motion(folders.motion(name), body).in_place()
        return resample(clip, of.fps)

    for entry in entries:
        groom, clip = groom_of(entry.groom), clip_of(entry.clip)
        if max(entry.frames) >= len(clip):
            raise InputError(folders.motion(entry.clip), f"more than {max(entry.frames)} frames", f"{len(clip)}")
        yield EvaluationCase(
            name=entry.name,
            group=of.grooms[entry.groom].group,
            shape=entry.shape,
            groom=groom,
            motion=replace(clip, body_pose=clip.body_pose[list(entry.frames)]),
            frames=entry.frames,
            body_shape=torch.tensor(of.shapes[entry.shape]),
        )
