"""Supervision of GroomGen: one groom draped by a solver at random rotations of the neck, a file a pose.

    groom.npz        the groom, as `quaffure.io.groom_file` writes it
    manifest.json    what all its drapes have in common
    pose_00017.npz   `strands` [S,N,3], draped [m, world], and `body_pose` [81] [rad]

A pose is drawn by its number and the seed alone, so a folder can be filled by several processes, and further later on.
"""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.body.neck import head_rotation, neck_pose
from quaffure.body.pose_features import world_from_head
from quaffure.config import HairMaterial
from quaffure.digest import array_digest
from quaffure.draper import Draper
from quaffure.errors import InputError, refused
from quaffure.file_values import known_fields, material_from
from quaffure.hair.groom import Groom
from quaffure.input_file import read_text
from quaffure.io.atomic import replacing, write_json
from quaffure.io.groom_file import read_groom, write_groom
from quaffure.io.output_path import made_folder
from quaffure.npz import Spec, read_arrays
from quaffure.scene import BodyBatch, Scene
from quaffure.training.run_folder import body_digest, code_version
from quaffure.types import BodyPose, Float, Tensor

LARGEST_TURN = math.radians(30)
"""Limit of the rotation of the head about each axis (Sec. 4.2) [rad]."""
DRAPES = "a folder for drapes"
POSE_FILE = "a draped pose (delete the file to have it draped again)"
SAME_GROOM = 1e-4
"""Every process makes the groom again; its vertices may differ by this much [m]."""


@dataclass(frozen=True)
class Manifest:
    """What all drapes of a folder have in common.

    Attributes:
        groom: its name.
        groom_digest: of `groom.npz`.
        body: digest of the body.
        solver: name of the draper.
        seed: of the poses.
        version: of the code that made the folder; the only one that may be another later on.
    """

    groom: str
    groom_digest: str
    body: str
    solver: str
    material: HairMaterial
    seed: int
    version: str


class DrapeFolder:
    """Drapes of one groom by one solver. A process killed at any moment leaves its files whole.

    Attributes:
        path: the folder.
        groom: the one that is draped.
        manifest: see `Manifest`.
    """

    def __init__(self, path: Path, body: BodyModel) -> None:
        """Open a folder that `started_folder` made.

        Raises:
            InputError: it is none, of another body, or one of its files is damaged.
        """
        self.path, self.body = path, body
        self.manifest = _read_manifest(path / "manifest.json")
        self.groom = read_groom(path / "groom.npz", body)
        if groom_digest(self.groom) != self.manifest.groom_digest:
            raise InputError(path / "groom.npz", f"the groom {self.manifest.groom_digest}", groom_digest(self.groom))
        if body_digest(body) != self.manifest.body:
            raise InputError(path, f"a folder of body {body_digest(body)}", f"body {self.manifest.body}")

    def pose_file(self, pose: int) -> Path:
        return self.path / f"pose_{pose:05d}.npz"

    def missing(self, poses: Iterable[int]) -> list[int]:
        """Those that are not draped yet."""
        return [pose for pose in poses if not self.pose_file(pose).is_file()]

    def drape(self, pose: int, draper: Draper) -> None:
        """Drape one pose and keep it.

        Raises:
            InputError: the draper returns NaN or infinity.
        """
        body_pose = neck_pose(self.body, random_head_rotation(self.manifest.seed, pose)[None])
        strands = draper.drape(Scene(self.groom, BodyBatch(self.body, body_pose, torch.zeros(1, 10))))[0].detach()
        if not bool(torch.isfinite(strands).all()):
            raise InputError(draper.name, f"finite vertices in pose {pose}", "NaN or infinity")
        with replacing(self.pose_file(pose)) as temporary:
            np.savez(temporary, strands=strands.numpy(), body_pose=body_pose[0].numpy())

    def read(self, on_pose: Callable[[int], None] = lambda pose: None) -> "DrapedPoses":
        """All drapes that are there, in the order of their numbers.

        Args:
            on_pose: called with the number of poses read so far.

        Raises:
            InputError: there is none, or a file is damaged.
        """
        paths = sorted(self.path.glob("pose_*.npz"))
        if not paths:
            raise InputError(self.path, "draped poses (quaffure groomgen-data)", "none")
        turns, displacements = [], []
        for path in paths:
            turn, displacement = self._read_pose(path)
            turns.append(turn)
            displacements.append(displacement)
            on_pose(len(turns))
        return DrapedPoses(torch.stack(turns), torch.stack(displacements))

    def _read_pose(self, path: Path) -> tuple[Float[Tensor, "3"], Float[Tensor, "s n 3"]]:
        """As of `DrapedPoses`."""
        spec: Spec = {
            "strands": (tuple(self.groom.rest_strands.shape), (np.float32,)),
            "body_pose": ((81,), (np.float32,)),
        }
        arrays, _ = read_arrays(path, spec, POSE_FILE)
        body_pose: BodyPose = torch.from_numpy(arrays["body_pose"])[None]
        scene = Scene(self.groom, BodyBatch(self.body, body_pose, torch.zeros(1, 10)))
        rotations = scene.bodies.posed.joint_rotations
        moved = torch.from_numpy(arrays["strands"]) - scene.posed[0]
        displacement = (moved @ world_from_head(self.body, rotations)[0]).half()
        if not bool(torch.isfinite(displacement).all()):
            raise InputError(path, f"{POSE_FILE}, vertices near the head", "some that half precision does not hold")
        return head_rotation(self.body, rotations)[0], displacement


@dataclass(frozen=True)
class DrapedPoses:
    """The supervision: from a turn of the head to displacements.

    Attributes:
        turn: rotation vector of the head relative to the trunk [rad].
        displacement: draped less posed vertices in the head's frame, half precision [m].
    """

    turn: Float[Tensor, "p 3"]
    displacement: Float[Tensor, "p s n 3"]

    def __len__(self) -> int:
        return len(self.turn)


def started_folder(path: Path, groom: Groom, body: BodyModel, solver: str, draper: Draper, seed: int) -> DrapeFolder:
    """A folder for drapes, made where it does not exist.

    Args:
        groom: at most one strand a texel (`quaffure.load_groom`).
        solver: name of `draper`, which need not be the draper's own.

    Raises:
        InputError: it holds other drapes, or cannot be made.
    """
    made_folder(path, DRAPES)
    wanted = Manifest(groom.name, groom_digest(groom), body_digest(body), solver, draper.material, seed, code_version())
    if not (path / "manifest.json").is_file():
        write_groom(path / "groom.npz", groom)
        write_json(path / "manifest.json", asdict(wanted))
    folder = DrapeFolder(path, body)
    for name in ("groom", "solver", "material", "seed"):
        found, expected = getattr(folder.manifest, name), getattr(wanted, name)
        if found != expected:
            raise InputError(path, f"drapes of {name} {expected}", f"of {name} {found}")
    if not _same_groom(folder.groom, groom):
        raise InputError(path, f"drapes of this groom {groom.name}", "of another of that name")
    return folder


def random_head_rotation(seed: int, pose: int) -> Float[Tensor, "3"]:
    """Rotation vector of the head in one pose, each component uniform within `LARGEST_TURN` [rad]."""
    random = np.random.default_rng((seed, pose)).uniform(-LARGEST_TURN, LARGEST_TURN, 3)
    return torch.from_numpy(random).float()


def groom_digest(groom: Groom) -> str:
    """Tells one groom from another, bit for bit."""
    return array_digest(groom.rest_strands, groom.root_faces, groom.root_barycentric, groom.root_uv)[:16]


def _same_groom(one: Groom, other: Groom) -> bool:
    if one.rest_strands.shape != other.rest_strands.shape or not torch.equal(one.texels(), other.texels()):
        return False
    return bool((one.rest_strands - other.rest_strands).norm(dim=-1).max() < SAME_GROOM)


def _read_manifest(path: Path) -> Manifest:
    what = "the manifest of quaffure groomgen-data"
    text = read_text(path, what)
    with refused(path, what, ValueError, TypeError, KeyError, RecursionError):
        content = known_fields(json.loads(text), Manifest)
        return Manifest(**content | {"material": material_from(content["material"])})
