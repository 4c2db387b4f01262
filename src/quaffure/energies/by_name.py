"""The terms of `HairEnergy` by the name of the elastic model, as the command line knows it."""

from quaffure.energies.body_collision import BodyCollision
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.cosserat import Cosserat
from quaffure.energies.energy_term import Terms
from quaffure.energies.gravity import GRAVITY, Acceleration, Gravity
from quaffure.energies.mass_spring import MassSpring
from quaffure.energies.rod_term import Rod
from quaffure.energies.sag_free import SagFreeRest
from quaffure.energies.self_collision import SelfCollision
from quaffure.energies.stretch import Stretch
from quaffure.energies.stretch_shear import StretchShear
from quaffure.errors import InputError
from quaffure.types import Float, Tensor

MODIFIED_COSSERAT = "modified_cosserat"
"""Eqs. 6-8, the default; `cosserat` and `mass_spring` serve validation and the ablation of Fig. 10."""
ROD = "rod"
"""A Kirchhoff rod and Eq. 7, not in the paper; with a sag-free rest shape, hair at rest is as it was designed."""

ELASTIC_MODELS: dict[str, Terms] = {
    MODIFIED_COSSERAT: (StretchShear(), Stretch()),
    "cosserat": (Cosserat(),),
    "mass_spring": (MassSpring(),),
    ROD: (Rod(), Stretch()),
}
"""What resists gravity and contact in a strand, with default stiffness."""


def hair_terms(
    elastic: str = MODIFIED_COSSERAT,
    design: SagFreeRest | None = None,
    stiffness: float | Float[Tensor, "s e"] = 1.0,
    acceleration: Acceleration = GRAVITY,
) -> Terms:
    """An elastic model and Eqs. 9, 10 and 11; with a design, the cohesion of its tails as well.

    Args:
        elastic: name of the model.
        design: sag-free rest shape of the one groom that the terms are for; with the rod alone.
        stiffness: multiple of the rod's, of all edges or of each; with the rod alone. 0.3 to 3 is that of human hair.
        acceleration: gravity and wind [m/s^2].

    Raises:
        InputError: no elastic model of that name, or a design or a stiffness with another model than the rod.
    """
    if elastic not in ELASTIC_MODELS:
        raise InputError("elastic model", f"one of {', '.join(ELASTIC_MODELS)}", repr(elastic))
    if design is not None and elastic != ROD:
        raise InputError("sag-free rest shape", f"the elastic model {ROD}", repr(elastic))
    if elastic != ROD and (isinstance(stiffness, Tensor) or stiffness != 1):
        raise InputError("stiffness", f"the elastic model {ROD}", repr(elastic))
    chosen = (Rod(design, stiffness), Stretch()) if elastic == ROD else ELASTIC_MODELS[elastic]
    cohesion = () if design is None or design.tails is None else (Cohesion(design.tails),)
    return (*chosen, Gravity(acceleration), BodyCollision(), SelfCollision(), *cohesion)
