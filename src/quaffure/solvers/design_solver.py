"""Any solver on the energy of the sag-free rod: a groom's rest shape is found when the groom is draped."""

from dataclasses import dataclass

from quaffure.config import HairMaterial
from quaffure.energies.design_terms import terms_of_design
from quaffure.scene import Scene
from quaffure.solvers.by_name import solver
from quaffure.types import Positions


@dataclass(frozen=True)
class DesignSolver:
    """The solver of a name, on the energy of `terms_of_design`.

    Attributes:
        name: see `quaffure.solvers.by_name`.
    """

    name: str
    material: HairMaterial

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world].

        Raises:
            InputError: a solver without the rod.
        """
        terms = terms_of_design(scene.groom, scene.bodies.body, self.material)
        return solver(self.name, self.material, terms).drape(scene)
