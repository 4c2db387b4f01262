"""The posed groom without deformation, the baseline of every table."""

from quaffure.config import HairMaterial
from quaffure.energies.loading import Loading
from quaffure.scene import HairScene
from quaffure.types import Positions


class PosedDraper:
    """x_posed, without any deformation."""

    name = "posed"

    def __init__(self, material: HairMaterial | None = None) -> None:
        self.material = material or HairMaterial()

    def with_loading(self, loading: Loading) -> "PosedDraper":
        """The same: what is not deformed hangs in no direction."""
        return self

    def drape(self, scene: HairScene) -> Positions:
        return scene.posed
