"""Sections of a job that are read first, since all others may depend on them: plugins, and definitions of names."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationInfo, field_validator

from hpcinv.base.files.untrusted import applies
from hpcinv.base.quantity.expressions import LET, Expression
from hpcinv.base.quantity.plugins import load_file, load_installed
from hpcinv.base.quantity.schema import KeyPath, ListOf, Name, Spec, collected, raise_if_any
from hpcinv.job.definitions import RESERVED, resolve
from hpcinv.job.mesh_file import directory_of
from hpcinv.physics.materials.formula_law.invariants import fault_of_name


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
