"""The energy of hair: its terms, their sum, and the shapes at rest that they refer to."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.energies.body_collision import BodyCollision, energy_body_collision
    from quaffure.energies.by_name import ELASTIC_MODELS, hair_terms
    from quaffure.energies.closed_form import equilibrium_vectors
    from quaffure.energies.cohesion import Cohesion
    from quaffure.energies.cosserat import Cosserat, RodStiffness
    from quaffure.energies.design_terms import terms_of_design
    from quaffure.energies.energy_term import EnergyTerm, HairState, Terms
    from quaffure.energies.gravity import Gravity, energy_gravity
    from quaffure.energies.hair_energy import HairEnergy
    from quaffure.energies.held_parts import held_up_to, released, tied_at, with_ties
    from quaffure.energies.loading import STANDARD_LOADING, Loading
    from quaffure.energies.mass_spring import Springs, SpringStiffness
    from quaffure.energies.rest_state import RestState
    from quaffure.energies.rod import TWISTING_STIFFNESS, RodRest, energy_at_twist, energy_rod, stress_free_rest
    from quaffure.energies.rod_term import Rod
    from quaffure.energies.sag_free import SagFreeRest, design_of, sag_free_rest
    from quaffure.energies.self_collision import SelfCollision, energy_self_collision
    from quaffure.energies.stretch import Stretch, energy_stretch
    from quaffure.energies.stretch_shear import StretchShear, energy_stretch_shear

__all__, __getattr__, __dir__ = lazy_exports(__name__)
