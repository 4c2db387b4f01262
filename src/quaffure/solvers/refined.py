"""A few steps of Adam from a network's drape: how much of its error local optimization removes."""

from quaffure.energies.hair_energy import HairEnergy
from quaffure.model.neural import NeuralDraper
from quaffure.scene import Scene
from quaffure.solvers.adam import descend_directions
from quaffure.solvers.descent import Descent, Directions
from quaffure.types import Positions


class RefinedDraper:
    """Minimizes `HairEnergy` over directions, from a network's drape.

    Attributes:
        start: the network.
        steps: gradient evaluations.
        learning_rate: at the start [dimensionless change of a unit direction]; falls to a hundredth along a cosine.
    """

    name = "neural_refined"

    def __init__(self, start: NeuralDraper, steps: int = 10, learning_rate: float = 0.01) -> None:
        self.start, self.material = start, start.material
        self.steps, self.learning_rate = steps, learning_rate

    def drape(self, scene: Scene) -> Positions:
        energy = HairEnergy(scene.groom, self.material)
        directions = Directions(energy, scene)
        directions.set_directions(self.start.drape(scene).diff(dim=2))
        descend_directions(Descent(energy, scene, directions, clips=True), self.steps, self.learning_rate)
        return directions.positions().detach()
