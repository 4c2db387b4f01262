"""The evaluation sets: clips, shapes and grooms that no training uses, each in one versioned file of the package."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.clips import CLIP_NAMES, bundled_clip
from quaffure.body.motion import Motion, resample
from quaffure.energies.gravity import GRAVITY
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.load_groom import load_groom
from quaffure.io.read_motion import read_motion
from quaffure.scene import BodyBatch
from quaffure.types import Float, Tensor

SETS = (2, 3)
"""Versions of the sets that come with the package; the last one is current."""
LEAST_RUN = 3
"""Frames in a row that have an acceleration."""


@dataclass(frozen=True)
class GroomSource:
    """Where a groom of the set comes from.

    Attributes:
        group: `seen` if training may use the groom, else `unseen`; `tied` of tied styles, which training may use.
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
        loading: name of the loading; empty for human hair under gravity.
    """

    groom: str
    clip: str
    shape: str
    frames: tuple[int, ...]
    loading: str = ""

    @property
    def name(self) -> str:
        return "-".join(part for part in (self.groom, self.clip, self.shape, self.loading) if part)


@dataclass(frozen=True)
class EvaluationSet:
    """The whole file.

    Attributes:
        version: changes whenever a case does: metrics of two versions cannot be compared.
        fps: rate at which frames count.
        motions: stems of the motion files; other clips are bundled ones.
        shapes: ten coefficients of each shape [standard deviations].
        loadings: stiffness, gravity and wind by name.
        quick: names of the cases of a quick evaluation.
    """

    version: int
    fps: float
    motions: tuple[str, ...]
    shapes: dict[str, tuple[float, ...]]
    grooms: dict[str, GroomSource]
    cases: tuple[CaseEntry, ...]
    quick: tuple[str, ...]
    loadings: dict[str, Loading] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """A groom on a body in some frames, ready to drape.

    Attributes:
        group: `seen`, `unseen`, `tied` or `own`; the name of the loading where there is one.
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
    loading: Loading = STANDARD_LOADING

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
def load_evaluation_set(version: int = SETS[-1]) -> EvaluationSet:
    """A set that comes with the package.

    Raises:
        InputError: none of that version.
    """
    if version not in SETS:
        raise InputError("evaluation set", f"version {' or '.join(map(str, SETS))}", f"{version}")
    content = json.loads((files("quaffure") / "assets" / f"evaluation_set_{version}.json").read_text(encoding="utf-8"))
    return EvaluationSet(
        version=content["version"],
        fps=float(content["fps"]),
        motions=tuple(content["motions"]),
        shapes={name: tuple(values) for name, values in content["shapes"].items()},
        grooms={name: GroomSource(**source) for name, source in content["grooms"].items()},
        cases=tuple(CaseEntry(**entry | {"frames": tuple(entry["frames"])}) for entry in content["cases"]),
        quick=tuple(content["quick"]),
        loadings={name: _loading(**values) for name, values in content.get("loadings", {}).items()},
    )


def _loading(stiffness: float = 1.0, acceleration: Sequence[float] = GRAVITY) -> Loading:
    x, y, z = acceleration
    return Loading(stiffness, (x, y, z))


def refuse_evaluation_data(grooms: Iterable[str | Path] = (), motions: Iterable[str | Path] = ()) -> None:
    """Keep out of a training what it is evaluated on: every clip of the sets, and their grooms of the group `unseen`.

    Args:
        grooms, motions: bundled names or files. Names and stems of files count, in any case: a copy of a held-out
            groom is one as well.

    Raises:
        InputError: one of them is in a set.
    """
    clips: set[str] = set()
    unseen: set[str] = set()
    for of in map(load_evaluation_set, SETS):
        clips |= {name.lower() for name in (*of.motions, *(entry.clip for entry in of.cases))}
        held_out = {name: source for name, source in of.grooms.items() if source.group == "unseen"}
        unseen |= {name.lower() for name in held_out}
        unseen |= {Path(source.file).stem.lower() for source in held_out.values() if source.file}
    for path in map(Path, grooms):
        if path.stem.lower() in unseen:
            raise InputError(f"groom {path}", "a groom that is not held out for evaluation", path.stem)
    for path in map(Path, motions):
        if path.stem.lower() in clips:
            expected = "a clip that is not in the evaluation set (one of your own needs another name)"
            raise InputError(f"motion {path}", expected, path.stem)


@dataclass(frozen=True)
class DataFolders:
    """Folders of the files of the set that the package does not ship. Any of them may be missing.

    Attributes:
        motions: hold `<clip>.bvh`.
        grooms: hold the files of `GroomSource`.
    """

    motions: tuple[Path, ...]
    grooms: tuple[Path, ...]

    def motion(self, clip: str) -> Path:
        return _first_file(self.motions, f"{clip}.bvh")

    def groom(self, name: str) -> Path:
        return _first_file(self.grooms, name)

    def missing(self, entry: CaseEntry, of: EvaluationSet) -> Path | None:
        """The first file that a case needs and that is not there."""
        source = of.grooms[entry.groom]
        needed = [self.motion(entry.clip)] if entry.clip not in CLIP_NAMES else []
        needed += [self.groom(name) for name in (source.file, source.head) if name]
        return next((path for path in needed if not path.is_file()), None)


def _first_file(folders: Sequence[Path], name: str) -> Path:
    """The file in the first folder that has it; in the first one of all where none has."""
    paths = [folder / name for folder in folders] or [Path(name)]
    return next((path for path in paths if path.is_file()), paths[0])


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
        head = folders.groom(source.head) if source.head else None
        return replace(load_groom(folders.groom(source.file), body, head), name=name)

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
            group=entry.loading or of.grooms[entry.groom].group,
            shape=entry.shape,
            groom=groom,
            motion=replace(clip, body_pose=clip.body_pose[list(entry.frames)]),
            frames=entry.frames,
            body_shape=torch.tensor(of.shapes[entry.shape]),
            loading=of.loadings[entry.loading] if entry.loading else STANDARD_LOADING,
        )
