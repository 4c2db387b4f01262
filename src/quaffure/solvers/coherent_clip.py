"""Clips that do not jump: every frame starts from the last one, rotated with the scalp.

Hair at rest has many minima of nearly the same energy, centimetres apart, so that frames which are solved one by one
jump between them. Here strands go from one frame's minimum to the next, by limited displacements.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import torch

from quaffure.config import HairMaterial
from quaffure.energies.hair_energy import HairEnergy
from quaffure.errors import InputError
from quaffure.geometry.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from quaffure.hair.groom_cache import GroomCopy
from quaffure.scene import PosedScene, Scene
from quaffure.solvers.restoring_goals import RestoringGoals
from quaffure.solvers.strand_descent import StrandDescent
from quaffure.solvers.strand_newton import StrandNewtonDraper
from quaffure.types import Float, Positions, RestLengths, Tensor

FRAME_SECONDS = 1 / 30
"""Time between frames that settings are meant for [s]."""
LEAST_PASSES = 2
"""A frame has no fewer: `OscillationDamping` compares the displacements of two."""
BLENDED_EDGES = 6
"""Edges from the root over which a strand that turns less than its scalp goes over to the smaller angle."""


@dataclass(frozen=True)
class CoherentSetting:
    """How a frame follows the last one, `FRAME_SECONDS` later.

    Attributes:
        passes: of a frame, at least.
        max_passes: of a frame in which strands still move.
        max_pass_displacement, max_frame_displacement: of a vertex, on top of the head's displacement and of what a limb
            pushes, to first order [m].
        max_head_sweep: displacement of a tip with the head, on top of what its root and its posed tip move [m]. Hair
            that hangs far from where it was posed would otherwise sweep around a head that turns fast.
        still: displacement in the last pass below which a strand is at rest [m].
        moving_share: of the strands above which further passes follow.
        cut_distance, cut_angle: mean displacement [m] and rotation [rad] of the roots in one frame from which on the
            motion is cut and hair is settled anew.
        cut_seconds: between frames, above which every frame is settled anew [s].
        stray_rounds, stray_passes: of a frame that is settled anew: how often strands that stand apart rejoin the
            others, and passes after that.
        restoring: of frames that follow: what draws hair that has fallen over a face back beside it.
    """

    passes: int = 2
    max_passes: int = 4
    max_pass_displacement: float = 0.01
    max_frame_displacement: float = 0.038
    max_head_sweep: float = 0.012
    still: float = 0.003
    moving_share: float = 0.1
    cut_distance: float = 0.25
    cut_angle: float = 0.8
    cut_seconds: float = 0.5
    stray_rounds: int = 2
    stray_passes: int = 5
    restoring: RestoringGoals = field(default_factory=RestoringGoals)

    def over(self, seconds: float) -> "CoherentSetting":
        """The setting for frames that are further apart, or nearer: hair and roots are as fast as before, and hair
        has as many passes a second, so that it does not fall behind, but `LEAST_PASSES` a frame."""
        frames = seconds / FRAME_SECONDS
        return replace(
            self,
            passes=max(LEAST_PASSES, round(frames * self.passes)),
            max_passes=max(LEAST_PASSES, round(frames * self.max_passes)),
            max_frame_displacement=frames * self.max_frame_displacement,
            max_head_sweep=frames * self.max_head_sweep,
            cut_distance=frames * self.cut_distance,
            cut_angle=frames * self.cut_angle,
        )


class CoherentDraper:
    """Drapes the frames of a clip in the order in which they come, by Newton's method on single strands.

    The first frame, one of another or a changed groom, and one after a cut are settled as `StrandNewtonDraper` does;
    strands that then stand apart rejoin the others. The same frames in the same order give the same bits with any
    number of threads.

    Attributes:
        draper: of frames that start anew.
        setting: how frames follow.
        frame_seconds: time from each frame to the next [s].
        is_moving: whether more strands than `moving_share` of the setting still moved in the last frame's last pass.
    """

    def __init__(self, draper: StrandNewtonDraper | None = None, setting: CoherentSetting | None = None) -> None:
        self.draper, self.setting = draper or StrandNewtonDraper(), setting or CoherentSetting()
        self.frame_seconds, self.is_moving = FRAME_SECONDS, False
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

    @property
    def state(self) -> Float[Tensor, "s k"] | None:
        """The directions of every strand's edges in the last frame, then its damping; None before the first one."""
        last = self._last
        if last is None:
            return None
        return torch.cat([last.direction.flatten(1), torch.from_numpy(last.damping)[:, None]], dim=1)

    def resume(self, scene: Scene, state: Float[Tensor, "s k"]) -> None:
        """Continue from the last of these frames, after which `state` was this, as if it had been draped here.

        Raises:
            InputError: a state of other strands.
        """
        strands, vertices, _ = scene.groom.rest_strands.shape
        if state.shape != (strands, 3 * (vertices - 1) + 1):
            raise InputError("state", f"numbers [{strands}, {3 * (vertices - 1) + 1}]", f"{list(state.shape)}")
        last = scene.sample(len(scene.posed) - 1)
        direction = state[:, :-1].reshape(len(state), -1, 3)
        self._last = replace(_frame(last, direction), damping=state[:, -1].numpy().astype(np.float32))

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of the next frames, which follow those of the last call [m, world]."""
        energy = self.draper.energy_of(scene)
        return torch.cat([self._step(energy, scene.sample(index)) for index in range(len(scene.posed))])

    def _step(self, energy: HairEnergy, scene: PosedScene) -> Positions:
        last = self._last
        frame = _frame(scene, scene.director[0])
        if last is None or not last.groom.is_of(scene.groom) or self._is_cut(last, frame):
            descent, self.is_moving = self.draper.descend(energy, scene), False
            self.draper.gather_strays(descent, self.setting.stray_rounds, self.setting.stray_passes)
        else:
            max_head_sweep = self.setting.over(self.frame_seconds).max_head_sweep
            direction = last.rotated_to(frame, scene.groom.rest_lengths, max_head_sweep)
            descent = self._followed(energy, scene, direction, last.damping)
            self.is_moving = self._moves(descent)
        self._last = replace(
            frame, direction=torch.from_numpy(descent.direction.copy()), damping=descent.history.damping
        )
        return descent.positions

    def _followed(
        self, energy: HairEnergy, scene: PosedScene, direction: Float[Tensor, "s e 3"], damping: np.ndarray
    ) -> StrandDescent:
        setting = self.setting.over(self.frame_seconds)
        descent = StrandDescent(energy, scene, self.draper.setting.control, direction)
        descent.history.damping = damping
        # A limb may sweep through hair faster than hair may move in a frame.
        descent.resolve_contact(0.0)
        descent.restore(setting.restoring)
        descent.run_limited(setting.passes, setting.max_pass_displacement, setting.max_frame_displacement)
        while descent.passes < setting.max_passes and self._moves(descent):
            descent.run_limited(1, setting.max_pass_displacement, setting.max_frame_displacement)
        return descent

    def _moves(self, descent: StrandDescent) -> bool:
        return bool((descent.moved > self.setting.still).mean() > self.setting.moving_share)

    def _is_cut(self, last: "_Frame", frame: "_Frame") -> bool:
        setting = self.setting.over(self.frame_seconds)
        distance = (frame.root - last.root).norm(dim=-1).mean()
        trace = torch.einsum("sij,sij->s", frame.rotation, last.rotation)
        angle = torch.arccos(((trace - 1) / 2).clamp(-1, 1)).mean()
        is_late = self.frame_seconds > setting.cut_seconds
        return is_late or bool(distance > setting.cut_distance) or bool(angle > setting.cut_angle)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Where roots were, and hair.

    Attributes:
        groom: which one it was, and its arrays, which may change in place.
        root, posed_tip: positions [m].
        rotation: of the scalp triangles from rest.
        direction: unit direction of every edge.
        damping: of every strand, see `OscillationDamping`.
    """

    groom: GroomCopy
    root: Float[Tensor, "s 3"]
    posed_tip: Float[Tensor, "s 3"]
    rotation: Float[Tensor, "s 3 3"]
    direction: Float[Tensor, "s e 3"]
    damping: np.ndarray

    def rotated_to(self, frame: "_Frame", lengths: RestLengths, max_head_sweep: float) -> Float[Tensor, "s e 3"]:
        """The directions of the edges, rotated as the scalp has rotated.

        Where that would move a tip by `max_head_sweep` [m] more than its root and its posed tip move, edges beyond
        the first ones rotate by a smaller angle.
        """
        turn = frame.rotation @ self.rotation.transpose(-1, -2)
        direction = self.direction.to(turn)
        shift, to_tip = frame.root - self.root, (lengths[..., None] * direction).sum(1)
        moved = (shift + torch.einsum("sij,sj->si", turn, to_tip) - to_tip).norm(dim=-1)
        allowed = torch.maximum(shift.norm(dim=-1), (frame.posed_tip - self.posed_tip).norm(dim=-1)) + max_head_sweep
        share = (allowed / moved.clamp(min=1e-6)).clamp(max=1.0)
        edge = torch.arange(1, direction.shape[1] + 1, device=turn.device)
        shares = 1 - (1 - share[:, None]) * (edge / BLENDED_EDGES).clamp(max=1.0)
        turns = matrix_from_axis_angle(shares[..., None] * axis_angle_from_matrix(turn)[:, None])
        return torch.einsum("seij,sej->sei", turns, direction)


def _frame(scene: PosedScene, direction: Float[Tensor, "s e 3"]) -> _Frame:
    """The first frame of a scene, with hair of these directions."""
    posed = scene.posed[0]
    undamped = np.zeros(len(direction), np.float32)
    return _Frame(GroomCopy(scene.groom), posed[:, 0], posed[:, -1], scene.root_rotation[0], direction, undamped)
