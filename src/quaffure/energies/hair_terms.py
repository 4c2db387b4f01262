"""The terms of `HairEnergy` by the name of the elastic model, as the command line knows it."""

from quaffure.energies.body_collision import BodyCollision
from quaffure.energies.cosserat import Cosserat
from quaffure.energies.energy_term import Terms
from quaffure.energies.gravity import Gravity
from quaffure.energies.mass_spring import MassSpring
from quaffure.energies.self_collision import SelfCollision
from quaffure.energies.stretch import Stretch
from quaffure.energies.stretch_shear import StretchShear
from quaffure.errors import InputError

MODIFIED_COSSERAT = "modified_cosserat"
"""Eqs. 6-8, the default; the others serve validation and the ablation of Fig. 10."""

ELASTIC_MODELS: dict[str, Terms] = {
    MODIFIED_COSSERAT: (StretchShear(), Stretch()),
    "cosserat": (Cosserat(),),
    "mass_spring": (MassSpring(),),
}
"""What resists gravity and contact in a strand, with default stiffness."""


def hair_terms(elastic: str = MODIFIED_COSSERAT) -> Terms:
    """An elastic model and Eqs. 9, 10 and 11.

    Raises:
        InputError: no elastic model of that name.
    """
    if elastic not in ELASTIC_MODELS:
        raise InputError("elastic model", f"one of {', '.join(ELASTIC_MODELS)}", repr(elastic))
    return (*ELASTIC_MODELS[elastic], Gravity(), BodyCollision(), SelfCollision())
