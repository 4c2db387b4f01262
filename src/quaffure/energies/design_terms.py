"""Terms of the energy that keeps a groom as it was designed."""

from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.energies.by_name import ROD, hair_terms
from quaffure.energies.energy_term import Terms
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.energies.sag_free import design_of
from quaffure.hair.groom import Groom


def terms_of_design(
    groom: Groom, body: BodyModel, material: HairMaterial, loading: Loading = STANDARD_LOADING
) -> Terms:
    """The sag-free rod of a groom that was designed on a body, Eqs. 7, 9, 10 and 11, and the cohesion of its tails.

    Args:
        loading: stiffness, gravity and wind.

    Raises:
        InputError: see `sag_free_rest`.
    """
    return hair_terms(ROD, design_of(groom, body, material), loading.stiffness, loading.acceleration)
