"""Which energy terms a solver with its own projections or derivatives can minimize."""

from quaffure.energies.energy_term import Terms
from quaffure.energies.hair_terms import hair_terms
from quaffure.errors import InputError


def refuse_other_terms(solver: str, terms: Terms | None) -> None:
    """Check that the terms are Eqs. 6, 7, 9, 10 and 11, which is all that XPBD and Newton's method implement.

    Raises:
        InputError: a term is of another type, or one of these is missing.
    """
    if terms is None:
        return
    supported = {type(term): term.name for term in hair_terms()}
    found = {type(term) for term in terms}
    others = [term.name for term in terms if type(term) not in supported]
    missing = [f"no {name}" for kind, name in supported.items() if kind not in found]
    if others or missing:
        expected = f"the energy terms {', '.join(supported.values())} alone (adam and lbfgs accept any)"
        raise InputError(f"solver {solver}", expected, ", ".join([*others, *missing]))
