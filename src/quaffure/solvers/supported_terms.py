"""Which energy terms a solver with its own projections or derivatives can minimize."""

from quaffure.energies.by_name import MODIFIED_COSSERAT, ROD, hair_terms
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.energy_term import Terms
from quaffure.errors import InputError


def refuse_other_terms(solver: str, terms: Terms | None, elastic: str = MODIFIED_COSSERAT) -> None:
    """Check that the terms are those of one elastic model and Eqs. 9, 10 and 11: all that a solver implements. With the
    rod the cohesion of tails may be among them.

    Raises:
        InputError: a term is of another type, or one of these is missing.
    """
    if terms is None:
        return
    supported = {type(term): term.name for term in hair_terms(elastic)}
    found = {type(term) for term in terms}
    allowed = {*supported, Cohesion} if elastic == ROD else {*supported}
    others = [term.name for term in terms if type(term) not in allowed]
    missing = [f"no {name}" for kind, name in supported.items() if kind not in found]
    if others or missing:
        names = ", ".join(supported.values())
        expected = f"the energy terms {names} of the elastic model {elastic} alone (adam and lbfgs accept any)"
        raise InputError(f"solver {solver}", expected, ", ".join([*others, *missing]))
