"""The section 'let' of a job: definitions of names in its formulas."""

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.base.quantity.schema import Problems
from hpcinv.job.vocabulary import FIELDS, POSITIONS

RESERVED = frozenset({*FUNCTIONS, *CONSTANTS, *POSITIONS, *FIELDS, "displacement"})
"""Names with a meaning in formulas of a job."""


def resolve(given: Mapping[str, Expression]) -> dict[str, Expression]:
    """Definitions that include the definitions that they use; these may be given in any order.

    Raises:
        Problems: a definition uses itself, directly or through others, or definitions are nested too deeply.
    """
    sorter = TopologicalSorter({name: sorted(formula.names & given.keys()) for name, formula in given.items()})
    try:
        order = list(sorter.static_order())
    except CycleError as error:
        cycle = error.args[1][::-1]  # each name uses the next one
        raise Problems(((cycle[0],), f"is defined by itself: {' -> '.join(cycle)}")) from None
    resolved: dict[str, Expression] = {}
    for name in order:
        try:
            resolved[name] = Expression.using(given[name].source, resolved)
        except ValueError as error:
            raise Problems(((name,), str(error))) from None
    return {name: resolved[name] for name in given}
