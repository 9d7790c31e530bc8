"""Sections of a job that are read first, since all others may depend on them: plugins, and definitions of names."""

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any

from pydantic import ValidationInfo, field_validator

from hpcinv.base.files.untrusted import applies
from hpcinv.base.quantity.expressions import LET, Expression
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.base.quantity.plugins import load_file, load_installed
from hpcinv.base.quantity.schema import KeyPath, ListOf, Name, Problems, Spec, collected, raise_if_any
from hpcinv.job.mesh_file import directory_of
from hpcinv.job.vocabulary import FIELDS, POSITIONS
from hpcinv.physics.materials.formula_law.invariants import fault_of_name

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


class Preamble(Spec):
    """The sections ``let`` and ``plugins``; to read them loads the plugins."""

    let: Mapping[Name, Expression] = {}
    plugins: ListOf[str] = ()

    @field_validator("let")
    @classmethod
    def _check_let(cls, given: Mapping[str, Expression], info: ValidationInfo) -> Mapping[str, Expression]:
        raise_if_any(((name,), text) for name in given if (text := fault_of_name(name, RESERVED)))
        if given and info.context is None:
            raise ValueError("is valid only in jobs that are read by 'load' or 'parse'")
        return resolve(given)

    @field_validator("plugins")
    @classmethod
    def _check_plugins(cls, plugins: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        load_installed()
        if applies(info):  # the job refuses them, with all else that it refuses
            return plugins
        problems: list[tuple[KeyPath, str]] = []
        for i, plugin in enumerate(plugins):
            with collected(problems, i):
                load_file(directory_of(info) / plugin)
        raise_if_any(problems)
        return plugins


def read_preamble(data: Mapping[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Load plugins, put definitions into the validation context, and return the sections that ``data`` has.

    Raises:
        ValidationError: one of them has faults.
    """
    sections = {key: data[key] for key in Preamble.model_fields if key in data}
    preamble = Preamble.model_validate(sections, context=info.context)
    if preamble.let and info.context is not None:
        info.context[LET] = preamble.let
    return {key: getattr(preamble, key) for key in sections}
