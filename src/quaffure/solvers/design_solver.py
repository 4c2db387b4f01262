"""Any solver on the energy of the sag-free rod: a groom's rest shape is found when the groom is draped."""

from dataclasses import dataclass, replace

from quaffure.config import HairMaterial
from quaffure.draper import LoadedDraper
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.scene import Scene
from quaffure.solvers.by_name import StartedSolver, solver
from quaffure.types import Positions


@dataclass(frozen=True)
class DesignSolver:
    """The solver of a name, on the energy of `terms_of_design`.

    Attributes:
        name: see `quaffure.solvers.by_name`.
        loading: stiffness, gravity and wind.
        start: whose drape the solver starts from; where there is none, the solver's own start.
    """

    name: str
    material: HairMaterial
    loading: Loading = STANDARD_LOADING
    start: LoadedDraper | None = None

    def under(self, loading: Loading) -> "DesignSolver":
        """The same solver under another loading."""
        return replace(self, loading=loading, start=self.start and self.start.under(loading))

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world].

        Raises:
            InputError: a solver without the rod, or one that cannot start from a drape where it shall.
        """
        terms = terms_of_design(scene.groom, scene.bodies.body, self.material, self.loading)
        draper = solver(self.name, self.material, terms)
        if self.start is None:
            return draper.drape(scene)
        if not isinstance(draper, StartedSolver):
            raise InputError("solver", "one that can start from a drape", self.name)
        return draper.drape_from(scene, self.start.drape(scene))
