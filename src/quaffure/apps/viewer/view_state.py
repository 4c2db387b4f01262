"""State of the live page, as plain data that can be draped without a browser."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch

from quaffure.benchmark.metrics import measure
from quaffure.body.body_model import SHAPE_COUNT, BodyModel
from quaffure.body.motion import Motion, joint_matrices, pose_from_matrices
from quaffure.drape_motion import drape_motion
from quaffure.draper import Draper, LoadDependentDraper
from quaffure.drapers import reads_loading
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.loading import Loading
from quaffure.errors import InputError
from quaffure.geometry.rotation import matrix_from_axis_angle
from quaffure.geometry.winding_number import is_inside
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.groom import Groom
from quaffure.model.neural import NeuralDraper
from quaffure.solvers.coherent_clip import CoherentDraper
from quaffure.types import BodyPose, Bool, Float

Degrees = tuple[float, float, float]
NO_ROTATION: Degrees = (0.0, 0.0, 0.0)
MEAN_SHAPE = (0.0,) * SHAPE_COUNT


@dataclass(frozen=True, eq=False)
class ViewState:
    """A groom on a body in one frame of a clip, and the draper for it.

    Attributes:
        motion: the clip.
        frame: index in the clip.
        joint_rotations: rotation vectors about the axes of the rest pose, by joint, applied after the clip [degrees].
        body_shape: beta [standard deviations].
        loading: stiffness of the hair, gravity and wind; drapers that know one hair and one gravity leave them.

    Raises:
        InputError: a frame outside of the clip, a joint that the body does not have, or not ten shape coefficients.
    """

    body: BodyModel
    groom: Groom
    motion: Motion
    draper: Draper
    frame: int = 0
    joint_rotations: Mapping[str, Degrees] = field(default_factory=dict)
    body_shape: tuple[float, ...] = MEAN_SHAPE
    loading: Loading = field(default_factory=Loading)

    def __post_init__(self) -> None:
        if not 0 <= self.frame < len(self.motion):
            raise InputError("frame", f"0 to {len(self.motion) - 1} of {self.motion.name}", f"{self.frame}")
        if len(self.body_shape) != SHAPE_COUNT:
            raise InputError("body shape", f"{SHAPE_COUNT} coefficients", f"{len(self.body_shape)}")
        for joint in self.joint_rotations:
            if joint not in self.body.joint_names:
                raise InputError("joint", f"one of {', '.join(self.body.joint_names)}", f"'{joint}'")

    def at(self, frame: int) -> "ViewState":
        """The state with another frame; clips repeat."""
        return replace(self, frame=frame % len(self.motion))

    def playing(self, motion: Motion) -> "ViewState":
        """The state with another clip, from its start."""
        return replace(self, motion=motion, frame=0)

    def rotated(self, joint: str, degrees: Degrees) -> "ViewState":
        """The state with another rotation of one joint."""
        return replace(self, joint_rotations={**self.joint_rotations, joint: degrees})

    def shaped(self, index: int, coefficient: float) -> "ViewState":
        """The state with another value of one shape coefficient."""
        shape = (*self.body_shape[:index], coefficient, *self.body_shape[index + 1 :])
        return replace(self, body_shape=shape)

    def body_pose(self) -> BodyPose:
        """Theta of the frame with the joint rotations, [1, 81] [rad]."""
        clip_pose = self.motion.body_pose[self.frame][None]
        body_pose, rotations = clip_pose.clone(), joint_matrices(clip_pose)
        for joint, degrees in self.joint_rotations.items():
            if degrees != NO_ROTATION:
                index = self.body.joint_names.index(joint)
                rotation = matrix_from_axis_angle(torch.tensor(degrees, dtype=rotations.dtype) * (math.pi / 180))
                rotations[:, index] = rotation @ rotations[:, index]
                body_pose[:, 3 * index : 3 * index + 3] = pose_from_matrices(rotations)[:, 3 * index : 3 * index + 3]
        return body_pose

    def drape(self) -> "Drape":
        """Drape the groom; one that follows from frame to frame continues from its last drape. Takes as long as the
        draper takes."""
        frame = self.motion.select(slice(self.frame, self.frame + 1))
        pose = replace(frame, body_pose=self.body_pose())
        draper = self._loaded_draper()
        with network_clock(draper) as network_times:
            shape = torch.tensor(self.body_shape)
            sequence = drape_motion(draper, self.groom, self.body, pose, shape, continues=True)
        sequence.meta["frame"] = self.frame
        if isinstance(draper, CoherentDraper) or reads_loading(draper):
            sequence.meta.update(asdict(self.loading))
        return Drape(self, sequence, sum(network_times) if network_times else None)

    def _loaded_draper(self) -> Draper:
        """The draper under the loading. The network's and the one that follows stay the same, with what they keep."""
        draper = self.draper
        if isinstance(draper, CoherentDraper):
            draper.draper.loading = self.loading
        elif isinstance(draper, NeuralDraper):
            draper.loading = self.loading
        elif isinstance(draper, LoadDependentDraper):
            return draper.with_loading(self.loading)
        return draper


@dataclass(frozen=True, eq=False)
class Drape:
    """A drape of a state.

    Attributes:
        sequence: of one frame, for files and metrics.
        network_milliseconds: wall time of the network alone, None for drapers without one.
    """

    state: ViewState
    sequence: DrapeSequence
    network_milliseconds: float | None

    @property
    def strands(self) -> Float[np.ndarray, "s n 3"]:
        """Draped guides [m, world]."""
        return self.sequence.strands[0]

    @property
    def body_vertices(self) -> Float[np.ndarray, "v 3"]:
        """The body under them [m, world]."""
        return self.sequence.body_vertices[0]

    @property
    def path(self) -> Float[np.ndarray, "3"]:
        """Translation of the body [m], level with the floor: the page's camera travels along it."""
        translation = self.sequence.body_translation
        return np.zeros(3) if translation is None else translation[0] * [1.0, 1.0, 0.0]

    @property
    def milliseconds(self) -> float:
        """Wall time from pose in to strands out."""
        return float(self.sequence.meta["milliseconds"])

    def metrics(self) -> tuple[dict[str, float], dict[str, float]]:
        """Metrics by name, of the drape and of the posed groom; energies are those of the rod in its design."""
        state = self.state
        terms = terms_of_design(state.groom, state.body, state.draper.material, state.loading)
        draped, posed = measure(self.sequence, state.groom, state.body, terms=terms)
        return _first_frame(draped), _first_frame(posed)

    def inside(self, strands: Float[np.ndarray, "m n 3"]) -> Bool[np.ndarray, "m n"]:
        """Which vertices of these strands are inside the body; roots, which lie on the skin, are not."""
        return np.pad(is_inside(strands[:, 1:], self.body_vertices, self.sequence.body_faces), ((0, 0), (1, 0)))


def _first_frame(metrics: Mapping[str, torch.Tensor]) -> dict[str, float]:
    return {name: float(values[0]) for name, values in metrics.items()}


@contextmanager
def network_clock(draper: Draper) -> Iterator[list[float]]:
    """Collect the wall time of the draper's network [ms]; none where it has no network."""
    times: list[float] = []
    if not isinstance(draper, NeuralDraper):
        yield times
        return
    before = draper.backend().network_seconds
    yield times
    times.append(1000 * (draper.backend().network_seconds - before))
