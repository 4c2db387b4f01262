"""Clips that do not jump: every frame starts from the last one, rotated with the scalp.

Hair at rest has many minima of nearly the same energy, centimetres apart, so that frames which are solved one by one
jump between them. Here strands go from one frame's minimum to the next, by limited displacements.
"""

from dataclasses import dataclass, replace

import torch

from quaffure.config import HairMaterial
from quaffure.energies.hair_energy import HairEnergy
from quaffure.hair.groom_cache import GroomCopy
from quaffure.scene import PosedScene, Scene
from quaffure.solvers.strand_descent import StrandDescent
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.types import Float, Positions, Tensor


@dataclass(frozen=True)
class CoherentSetting:
    """How a frame follows the last one.

    Attributes:
        passes: of a frame.
        most_passes: of a frame in which strands still move.
        most_move, most_moved: displacement of a vertex in a pass and in a frame, on top of the head's and of what a
            limb pushes, to first order [m].
        still: displacement in the last pass below which a strand is at rest [m].
        moving_share: of the strands above which further passes follow.
        cut_distance, cut_angle: mean displacement [m] and rotation [rad] of the roots in one frame from which on the
            motion is cut and hair is settled anew.
    """

    passes: int = 4
    most_passes: int = 6
    most_move: float = 0.01
    most_moved: float = 0.038
    still: float = 0.004
    moving_share: float = 0.1
    cut_distance: float = 0.25
    cut_angle: float = 0.8


class CoherentDraper:
    """Drapes the frames of a clip in the order in which they come, by Newton's method on single strands.

    The first frame, one of another or a changed groom, and one after a cut are settled as `StrandNewtonDraper` does.
    The same frames in the same order give the same bits with any number of threads.

    Attributes:
        draper: of frames that start anew.
        setting: how frames follow.
    """

    def __init__(self, draper: StrandNewtonDraper | None = None, setting: CoherentSetting | None = None) -> None:
        self.draper, self.setting = draper or StrandNewtonDraper(), setting or CoherentSetting()
        self._last: _Frame | None = None

    @property
    def name(self) -> str:
        return self.draper.name

    @property
    def material(self) -> HairMaterial:
        return self.draper.material

    def restart(self) -> None:
        """Settle the next frame anew."""
        self._last = None

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of the next frames, which follow those of the last call [m, world]."""
        energy = self.draper.energy_of(scene)
        return torch.cat([self._step(energy, scene.sample(index)) for index in range(len(scene.posed))])

    def _step(self, energy: HairEnergy, scene: PosedScene) -> Positions:
        last = self._last
        root, rotation = scene.posed[0, :, 0], scene.root_rotation[0]
        frame = _Frame(GroomCopy(scene.groom), root, rotation, scene.director[0])
        if last is None or not last.groom.is_of(scene.groom) or self._is_cut(last, frame):
            descent = self.draper.descend(energy, scene)
        else:
            descent = self._followed(energy, scene, last.rotated_to(frame))
        self._last = replace(frame, direction=torch.from_numpy(descent.direction.copy()))
        return descent.positions

    def _followed(self, energy: HairEnergy, scene: PosedScene, direction: Float[Tensor, "s e 3"]) -> StrandDescent:
        setting = self.setting
        descent = StrandDescent(energy, scene, self.draper.setting.control, direction)
        # A limb may sweep through hair faster than hair may move in a frame.
        descent.resolve_contact(0.0)
        descent.follow(setting.passes, setting.most_move, setting.most_moved)
        while descent.passes < setting.most_passes and (descent.moved > setting.still).mean() > setting.moving_share:
            descent.follow(1, setting.most_move, setting.most_moved)
        return descent

    def _is_cut(self, last: "_Frame", frame: "_Frame") -> bool:
        distance = (frame.root - last.root).norm(dim=-1).mean()
        trace = torch.einsum("sij,sij->s", frame.rotation, last.rotation)
        angle = torch.arccos(((trace - 1) / 2).clamp(-1, 1)).mean()
        return bool(distance > self.setting.cut_distance) or bool(angle > self.setting.cut_angle)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Where roots were, and hair.

    Attributes:
        groom: which one it was, and its arrays, which may change in place.
        root: positions [m].
        rotation: of the scalp triangles from rest.
        direction: unit direction of every edge.
    """

    groom: GroomCopy
    root: Float[Tensor, "s 3"]
    rotation: Float[Tensor, "s 3 3"]
    direction: Float[Tensor, "s e 3"]

    def rotated_to(self, frame: "_Frame") -> Float[Tensor, "s e 3"]:
        """The directions of the edges, rotated as the scalp has rotated."""
        turn = frame.rotation @ self.rotation.transpose(-1, -2)
        return torch.einsum("sij,sej->sei", turn, self.direction.to(turn))
