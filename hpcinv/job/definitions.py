"""The section 'let' of a job: definitions of names in its formulas."""

import keyword
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from hpcinv.job.sections import FIELDS, POSITIONS
from hpcinv.materials.formula_law.invariants import families_in
from hpcinv.quantity.expressions import Expression
from hpcinv.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.quantity.schema import Problems

RESERVED = frozenset({*FUNCTIONS, *CONSTANTS, *POSITIONS, *FIELDS, "displacement"})
"""Names with a meaning in formulas of a job."""


def unusable(name: str) -> str | None:
    """Reason why a definition cannot have this name, or ``None``."""
    if name in RESERVED or families_in(name) is not None:
        return "is already the name of something else; 'hpcinv formulas' lists the reserved names"
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        return "cannot be a name in a formula; choose a name of letters, digits and _"
    return None


def resolve(given: Mapping[str, Expression]) -> dict[str, Expression]:
    """Definitions that include the definitions that they use; these may be given in any order.

    Raises:
        Problems: a definition uses itself, directly or through others, or definitions are nested too deeply.
    """
    sorter = TopologicalSorter({name: sorted(formula.names & given.keys()) for name, formula in given.items()})
    try:
        order = list(sorter.static_order())
    except CycleError as error:
        cycle = error.args[1][:0:-1]  # each name uses the next one, and the last uses the first
        start = cycle.index(next(name for name in given if name in cycle))
        names = [*cycle[start:], *cycle[: start + 1]]
        raise Problems(((names[0],), f"is defined by itself: {' -> '.join(names)}")) from None
    resolved: dict[str, Expression] = {}
    for name in order:
        try:
            resolved[name] = Expression.using(given[name].source, resolved)
        except ValueError as error:
            raise Problems(((name,), str(error))) from None
    return {name: resolved[name] for name in given}
