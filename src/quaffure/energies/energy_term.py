"""What an energy term is: one equation of the objective in one object, with a readable error next to its energy."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from quaffure.config import HairMaterial
from quaffure.energies.rest_state import RestState
from quaffure.scene import HairScene
from quaffure.types import Energy, Float, Positions, Tensor


@dataclass(frozen=True, eq=False)
class HairState:
    """One batch of drapes of a groom, as energy terms read it.

    Attributes:
        positions: draped vertices [m, world].
        rest: of the groom.
        variables: what some terms minimize over as well, by their names.
        prepared: what terms computed once for the scene, by their names.
    """

    positions: Positions
    rest: RestState
    material: HairMaterial
    variables: Mapping[str, Tensor] = field(default_factory=dict)
    prepared: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class EnergyTerm(ABC):
    """One term of `HairEnergy`, in the file of its equation; parameters of its own are fields of a frozen dataclass.

    `energy` is plain torch, differentiable in the positions. Where a compiled kernel computes the term as well, the
    kernel's scalar function stands in the same file, and `HairEnergy` recognizes the term by its exact type: a subclass
    runs in torch.

    Attributes:
        name: key in reports and logs.
        equation: where the formula comes from.
        metric_unit: of `metric`.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    metric_unit: ClassVar[str] = ""

    @abstractmethod
    def energy(self, hair: HairState, scene: HairScene) -> Energy:
        """Energy of every sample [J]."""

    def metric(self, hair: HairState, scene: HairScene) -> Float[Tensor, "b ..."] | None:
        """A readable error [`metric_unit`] per vertex, edge or pair; None where the term has none."""
        return None

    def adapt_rest(self, rest: RestState) -> RestState:
        """The rest state for all terms of the sum, where this one needs another: a rest shape with its own margins."""
        return rest

    def prepare(self, rest: RestState, scene: HairScene) -> Any:
        """What `energy` needs and can be computed once for a scene; it finds it in `HairState.prepared`."""
        return None

    def initial_variables(self, scene: HairScene) -> Tensor | None:
        """What a solver minimizes over in addition to the positions, at its start; None for positions alone.

        `energy` reads them from `HairState.variables` under the term's name and takes these where they are missing.
        """
        return None


Terms = tuple[EnergyTerm, ...]
