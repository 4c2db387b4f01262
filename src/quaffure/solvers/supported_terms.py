"""Which energy terms a solver with its own projections or derivatives can minimize."""

from quaffure.energies.by_name import MODIFIED_COSSERAT, hair_terms
from quaffure.energies.energy_term import EnergyTerm, Terms
from quaffure.errors import InputError


def refuse_other_terms(
    solver: str, terms: Terms | None, elastic: str = MODIFIED_COSSERAT, optional: tuple[type[EnergyTerm], ...] = ()
) -> None:
    """Check that the terms are those of one elastic model and Eqs. 9, 10 and 11: all that a solver implements.

    Args:
        optional: what it implements besides.

    Raises:
        InputError: a term is of another type, or one of these is missing.
    """
    if terms is None:
        return
    supported = {type(term): term.name for term in hair_terms(elastic)}
    found = {type(term) for term in terms}
    others = [term.name for term in terms if type(term) not in {*supported, *optional}]
    missing = [f"no {name}" for kind, name in supported.items() if kind not in found]
    if others or missing:
        names = ", ".join(supported.values())
        expected = f"the energy terms {names} of the elastic model {elastic} alone (adam and lbfgs accept any)"
        raise InputError(f"solver {solver}", expected, ", ".join([*others, *missing]))
