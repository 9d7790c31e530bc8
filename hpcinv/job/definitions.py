"""The section 'let' of a job: names for parts of its formulas."""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Mapping

from hpcinv.job.sections import FIELDS, POSITIONS
from hpcinv.materials.formula_law.invariants import families_in
from hpcinv.quantity.expressions import Expression
from hpcinv.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.quantity.schema import Location, Problems

RESERVED = frozenset({*FUNCTIONS, *CONSTANTS, *POSITIONS, *FIELDS, "displacement"})
"""Names that mean something in some formula of a job."""


def unusable(name: str) -> str | None:
    """Why a definition cannot have this name, ``None`` if it can."""
    if name in RESERVED or families_in(name) is not None:
        return "is already the name of something else; 'hpcinv formulas' lists the names that are taken"
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        return "cannot be a name in a formula; take another, of letters, digits and _"
    return None


def resolve(given: Mapping[str, Expression]) -> dict[str, Expression]:
    """The definitions with those that they use, in whatever order they stand.

    Raises:
        Problems: one uses itself, or they are too deep in each other.
    """
    resolved: dict[str, Expression] = {}
    for name in given:
        waiting = [name]
        while waiting:
            last = waiting[-1]
            needed = [other for other in _used(given[last], given) if other not in resolved]
            if last in resolved:
                waiting.pop()
            elif not needed:
                resolved[last] = _with(last, given[last], resolved)
                waiting.pop()
            elif needed[0] in waiting:
                raise Problems(((needed[0],), _circle(waiting[waiting.index(needed[0]) :])))
            else:
                waiting.append(needed[0])
    return {name: resolved[name] for name in given}


def _used(formula: Expression, given: Mapping[str, Expression]) -> list[str]:
    return sorted(formula.names & given.keys())


def _with(name: str, formula: Expression, resolved: Mapping[str, Expression]) -> Expression:
    where: Location = (name,)
    try:
        return Expression.using(formula.source, resolved)
    except ValueError as error:
        raise Problems((where, str(error))) from None


def _circle(names: Iterable[str]) -> str:
    first, *others = names
    way = " -> ".join((first, *others, first))
    return f"is defined by itself: {way}"
