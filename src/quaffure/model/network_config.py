"""Settings of a network and of the steps around it; stored in its weights file.

The keys of a file are the names of the command line's options, which do not change; `FILE_KEYS` maps them to fields.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, Literal

import torch
import tyro

from quaffure.body.body_model import JOINT_COUNT, SHAPE_COUNT
from quaffure.body.mls_body import MlsBodyConfig
from quaffure.file_values import known_fields
from quaffure.model.weights_file import MAX_WIDTH
from quaffure.types import Float, Tensor

POSE_SIZE, SHAPE_SIZE, MAX_LAYERS = 3 * JOINT_COUNT, SHAPE_COUNT, 64
FILE_KEYS = {"views": "skin_features", "slides": "contact"}
_KEYS_OF_FIELDS = {name: key for key, name in FILE_KEYS.items()}


def _check_finite(config: Any) -> None:
    """Refuse what no comparison with a limit finds.

    Raises:
        ValueError: NaN or infinity in a field.
    """
    for name, value in vars(config).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"expected a finite {name}, found {value}")


@dataclass(frozen=True)
class InitialShapeConfig:
    """Strands before the network (`quaffure.model.initial_shape`)."""

    body: MlsBodyConfig = field(default_factory=MlsBodyConfig)
    passes: int = 2
    """Gauss-Newton passes without contact (`quaffure.model.free_rod`)."""
    least_disturbance: float = 0.05
    """Rotation of an edge from the posed design at which the network moves its strand half as far as others [rad]."""
    decay_length: float = 0.05
    """Length along a strand over which edges return to their own directions after a contact [m]."""
    bend_relaxation: float = 5.0
    """How far bends of contact spread along a strand (`quaffure.model.bend_relaxation`), 0 for not at all."""
    tied_share: float = 0.1
    """How far the network moves tied strands, relative to free ones: those of a tail hold each other."""
    margin_slope: float = 10.0
    """Largest growth of the distance from the skin at which hair starts, for each length along a strand."""
    depth_share: float = 0.2
    """Depth below its margin at which hair may start, as a share of the depth at which Eq. 10 pushes an edge of length
    l as hard as its joint resists, B / (3 k_bc l^2)."""
    max_depth: float = 0.004
    """The same at most [m]."""
    min_weight_share: float = 0.05
    """Share of weight above which local features are a distance."""
    load_share: float = 0.2
    """Share of a strand's weight by which other hair or the skin may push its tip."""

    def __post_init__(self) -> None:
        _check_finite(self)
        if not (isinstance(self.passes, int) and 0 <= self.passes <= 16) or self.min_weight_share <= 0:
            raise ValueError(f"expected 0 to 16 passes and a weight share above 0, found {self}")
        rest = (self.least_disturbance, self.decay_length, self.tied_share, self.margin_slope, self.depth_share)
        if min(*rest, self.load_share, self.max_depth, self.bend_relaxation) < 0:
            raise ValueError(f"expected no length, share or slope below 0, found {self}")


@dataclass(frozen=True)
class DensityGridConfig:
    """Grid of the density of other hair, and units of what strands read of it (`quaffure.model.surroundings`)."""

    cell: float = 0.008
    """Side of a cell [m]; the kernel of Eq. 13 reaches 1 cm."""
    excess_unit: float = 0.5
    """Density above that in the design beyond which its feature grows as a logarithm [kg/m^3]."""
    slope_unit: float = 100.0
    """The same for its gradient [kg/m^4]."""
    margin_unit: float = 0.01
    """Unit of the collision margin [m]."""

    def __post_init__(self) -> None:
        _check_finite(self)
        if min(self.cell, self.excess_unit, self.slope_unit, self.margin_unit) <= 0:
            raise ValueError(f"expected a cell and units above 0, found {self}")


@dataclass(frozen=True)
class ProjectionConfig:
    """Strands projected out of the skin after the network (`quaffure.model.projection`)."""

    clearance_share: float = 0.5
    """Distance at which hair is left alone, as a share of its collision margin."""
    depth: float = 6e-4
    """Largest depth below its collision margin at which hair is left alone [m]; at rest on skin it is 0.1 to 0.5 mm."""
    most: float = 0.025
    """Largest distance that hair is pushed out to, or the material's margin where that is wider [m]: farther faces take
    longer to search."""
    clearance_slope: float = 0.12
    """Growth of that distance before a vertex that needs more, for each length along a strand."""
    spacing: float = 0.0025
    """Distance along a strand between two contact queries [m]; shorter edges are skipped."""
    max_push: float = 3.0
    """Largest tangent of the angle by which an edge rises from the skin that it is pushed out of."""
    pushes: int = 3
    """How often a strand is pushed out at most, and its bends relaxed; without relaxation once."""
    push_relaxation: float = 2.0
    """How far bends of a push spread along a strand at most (`quaffure.model.bend_relaxation`), 0 for not at all."""
    contact_stiffness: float = 8000.0
    """Resistance k l^2 of every edge of a pushed strand, of length l, to being turned back; as the bending stiffness,
    in weights of a metre of hair [m^2]. With less of it the energy is lower and more hair is inside the body."""

    def __post_init__(self) -> None:
        _check_finite(self)
        least = min(self.clearance_share, self.clearance_slope, self.max_push, self.depth, self.most)
        if self.spacing <= 0 or least < 0:
            raise ValueError(f"expected a spacing above 0, no share, slope, push or distance below it, found {self}")
        if not (isinstance(self.pushes, int) and 1 <= self.pushes <= 16):
            raise ValueError(f"expected 1 to 16 pushes, found {self.pushes!r}")
        if min(self.push_relaxation, self.contact_stiffness) < 0:
            raise ValueError(f"expected no push relaxation or contact stiffness below 0, found {self}")

    def clearance(self, margin: Float[Tensor, "s n"], depth: Float[Tensor, "s 1"], most: float) -> Float[Tensor, "s n"]:
        """Distance at which hair with a collision margin is left alone [m].

        Args:
            depth: below the margin, to which it is left alone for its stiffness; outside of the skin all the same.
            most: of that distance [m].
        """
        allowed = torch.minimum((1 - self.clearance_share) * margin.abs(), margin.new_tensor(self.depth))
        least = margin.clamp(max=0)
        return torch.maximum(margin - torch.maximum(allowed, depth), least).clamp(max=most)


@dataclass(frozen=True)
class NetworkConfig:
    """What a checkpoint needs to rebuild its network and the steps around it."""

    output: Literal["directions", "displacement"] = "directions"
    """`directions` (ours): changes of edge directions, integrated. `displacement` (the paper's): of vertices."""
    pose_features: int = 0
    """Length of the analytic pose features appended to the paper's R^107; 0 leaves them out."""
    texel_channels: int = 48
    """Channels of the decoder's texture that the strand layers read (`directions` only)."""
    strand_width: int = 128
    """Width of the layers common to all strands (`directions` only)."""
    strand_layers: int = 2
    """Hidden layers common to all strands, the first included (`directions` only)."""
    skin_features: Annotated[bool, tyro.conf.arg(name="views")] = True
    """The strand layers read local features of the skin near the initial strand, or, with `--no-views`, do
    not (`directions` only)."""
    surroundings: bool = False
    """The strand layers read the density of other hair around the initial strand, and the distance that it is to keep
    from the body (`quaffure.model.surroundings`; `directions` only, with the skin's features)."""
    refinements: int = 0
    """How often further strand layers, each with weights of its own, read where hair is after the changes so far and
    change it again (`directions` only, with surroundings)."""
    contact: Annotated[bool, tyro.conf.arg(name="slides")] = True
    """The initial strand is kept out of the point-sampled body, and the hair projected out of the skin after the
    network, or, with `--no-slides`, neither (`directions` only)."""
    initial_shape: InitialShapeConfig = field(default_factory=InitialShapeConfig)
    density_grid: DensityGridConfig = field(default_factory=DensityGridConfig)
    projection: ProjectionConfig = field(default_factory=ProjectionConfig)

    @cached_property
    def predicts_directions(self) -> bool:
        """Whether this is our configuration, which reads a loading; the paper's predicts displacements and knows human
        hair under gravity alone."""
        return self.output == "directions"

    def __post_init__(self) -> None:
        if self.output not in ("directions", "displacement"):
            raise ValueError(f"expected output directions or displacement, found {self.output!r}")
        widths = {"pose_features": (0, MAX_WIDTH), "texel_channels": (1, MAX_WIDTH), "strand_width": (1, MAX_WIDTH)}
        if self.surroundings and not (self.skin_features and self.predicts_directions):
            raise ValueError("expected surroundings with directions and the skin's features, found them without")
        if self.refinements and not self.surroundings:
            raise ValueError("expected refinements with surroundings, found them without")
        counts = {"strand_layers": (1, MAX_LAYERS), "refinements": (0, MAX_LAYERS)}
        for name, (least, most) in (widths | counts).items():
            value = getattr(self, name)
            if not (isinstance(value, int) and least <= value <= most):
                raise ValueError(f"expected {name} from {least} to {most}, found {value!r}")

    def __repr__(self) -> str:
        """By the keys of files, without what is as it was in the first runs: checkpoints are found by this text."""
        default = {
            "surroundings": False,
            "refinements": 0,
            "initial_shape": InitialShapeConfig(),
            "density_grid": DensityGridConfig(),
            "projection": ProjectionConfig(pushes=1, push_relaxation=0.0),
        }
        values = {name: getattr(self, name) for name in (f.name for f in fields(self))}
        shown = (
            f"{_KEYS_OF_FIELDS.get(name, name)}={value!r}"
            for name, value in values.items()
            if value != default.get(name)
        )
        return f"NetworkConfig({', '.join(shown)})"


def to_file_values(config: NetworkConfig) -> dict[str, Any]:
    """Settings by the keys of a weights file, as JSON takes them."""
    return {_KEYS_OF_FIELDS.get(name, name): value for name, value in asdict(config).items()}


def from_file_values(values: Mapping[str, Any]) -> NetworkConfig:
    """Undo `to_file_values`; what an older file does not hold is as by default.

    Raises:
        ValueError: a setting that is not known, or out of range.
    """
    named = {FILE_KEYS.get(key, key): value for key, value in values.items()}
    # Networks that were trained before bends were relaxed drape as they did.
    if "initial_shape" in named:
        shape = {"bend_relaxation": 0.0} | known_fields(named["initial_shape"], InitialShapeConfig)
        body = MlsBodyConfig(**known_fields(shape.pop("body", {}), MlsBodyConfig))
        named["initial_shape"] = InitialShapeConfig(**shape, body=body)
    if "projection" in named:
        known = known_fields(named["projection"], ProjectionConfig)
        named["projection"] = ProjectionConfig(**{"push_relaxation": 0.0, "pushes": 1} | known)
    if "density_grid" in named:
        named["density_grid"] = DensityGridConfig(**known_fields(named["density_grid"], DensityGridConfig))
    return NetworkConfig(**known_fields(named, NetworkConfig))
