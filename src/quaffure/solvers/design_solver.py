"""Any solver on the energy of the sag-free rod: a groom's rest shape is found when the groom is draped."""

from dataclasses import dataclass

from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.energies.energy_term import Terms
from quaffure.energies.hair_terms import ROD, hair_terms
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.energies.sag_free import design_of
from quaffure.hair.groom import Groom
from quaffure.scene import Scene
from quaffure.solvers.by_name import solver
from quaffure.types import Positions


def design_terms(groom: Groom, body: BodyModel, material: HairMaterial, loading: Loading = STANDARD_LOADING) -> Terms:
    """Terms of the energy that keeps a groom as it was designed on a body."""
    design = design_of(groom, body, material)
    return hair_terms(ROD, design, loading.stiffness, loading.acceleration)


@dataclass(frozen=True)
class DesignSolver:
    """The solver of a name, on the energy of `design_terms`.

    Attributes:
        name: see `quaffure.solvers.by_name`.
        loading: stiffness, gravity and wind.
    """

    name: str
    material: HairMaterial
    loading: Loading = STANDARD_LOADING

    def under(self, loading: Loading) -> "DesignSolver":
        """The same solver under another loading."""
        return DesignSolver(self.name, self.material, loading)

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world].

        Raises:
            InputError: a solver without the rod.
        """
        terms = design_terms(scene.groom, scene.bodies.body, self.material, self.loading)
        return solver(self.name, self.material, terms).drape(scene)
