"""The groom as the pose transform leaves it: the start of all others, and the row to beat."""

from quaffure.drapers.scene import Scene
from quaffure.types import Positions


class PosedDraper:
    """x_posed, without any deformation."""

    def drape(self, scene: Scene) -> Positions:
        return scene.posed
