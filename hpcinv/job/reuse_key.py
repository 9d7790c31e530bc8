"""Reuse groups: jobs that can share mesh, equations and symbolic factorization, and the numbers in which they differ.

The numbers of laws, effects, fibres and supports are entries of one constant of the forms (`Parameters`), so that jobs
that differ only in these use the same programs and the same matrix.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import chain
from typing import Any

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.schema import Spec
from hpcinv.base.quantity.spatial_fields import Field
from hpcinv.job.cavities import CONTROLS, Cavity
from hpcinv.job.fingerprint import FORMAT, NOT_CONTENT, NOT_PHYSICS, entry_texts, hash_of, hash_of_text
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import EntryTexts, SectionData, resolved
from hpcinv.job.states import StateSpec
from hpcinv.job.support import Support

_EQUATIONS = {"linear", "petsc", "maximum_iterations", "reuse_tangent"}
"""settings that solvers of equations have from their first job; all others are read from the job of each run"""
_NUMBER = "#"

_NEITHER = {key: reason for key, reason in NOT_CONTENT.items() if key != "mesh.partition"}
NOT_BODY: dict[str, str] = _NEITHER | dict.fromkeys(
    (
        *("directions", "analysis", "material", "fibres", "load_cases", "states", "effects", "supports", "cavities"),
        *("solver", "method", "fixed_point", "certificate", "quantities", "sensitivities", "accuracy"),
        *("expected_shape", "plugins", "inputs_of_plugins"),
        *(f"discretisation.{key}" for key in ("formulation", "pressure", "quadrature", "layers", "recovered_geometry")),
    ),
    "is not given to `build_body`; files that a generator reads are compared by `changed_inputs`",
)
"""What has no influence on the body of a job, with the reason."""


def body_key(job: Job, known: SectionData | None = None) -> str:
    """Hash (20 hex digits) of all that the body of a job depends on: everything except `NOT_BODY`."""
    return hash_of(resolved(job, NOT_BODY, known))


def reuse_group_of(job: Job, known: SectionData | None = None) -> str:
    """Hash (20 hex digits) of a job without the numbers of its laws, effects, fibres and supports.

    Args:
        known: data of sections of earlier jobs of the same file.
    """
    known = known or SectionData()
    return known.memo.of("reuse group", lambda job: hash_of_text(known.joined(job, _GROUP)), job)


def digests_of_structure(job: Job) -> dict[str, str]:
    """Hash of each section of a job without its numbers and solver: what solutions of jobs must have in common."""
    known = SectionData()
    texts = ((name, text(known, job)) for name, text in _STRUCTURE.texts)
    return {name: hash_of_text(text) for name, text in texts if text}


def _skeleton_text(name: str, known: SectionData, job: Job) -> str:
    entry = known.entry(job, name)
    return "" if entry is None else json.dumps(_SKELETONS[name](job, entry))


def _solver_text(_: SectionData, job: Job) -> str:
    return json.dumps(job.solver.model_dump(mode="json", include=_EQUATIONS))


def _partition_text(_: SectionData, job: Job) -> str:
    return json.dumps(job.mesh.partition)


def _no_cavities_text(known: SectionData, job: Job) -> str:
    return json.dumps({}) if known.entry(job, "cavities") is None else ""


def _order_text(_: SectionData, job: Job) -> str:
    return json.dumps([[solve.mesh, solve.start] for solve in job.plan]) if job.states else ""


def _skeletons_of_laws(job: Job, material: Any) -> dict[str, Any]:
    laws = {"": material} if "material" in job.laws else material
    return {name: _skeleton(law, laws[name]) for name, law in zip(laws, job.laws.values(), strict=True)}


def _skeletons_of_states(job: Job, states: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [_skeleton_of_state(state, data) for state, data in zip(job.states, states, strict=True)]


def structure_of(job: Job, known: SectionData | None = None) -> str:
    """Hash of what states of one job must have in common to share equations: `reuse_group_of` in any direction.

    A state with functions that the solver updates, such as contact pressures, keeps its own.
    """
    if any(effect.functions(1) for effect in job.effects):
        return job.state
    return reuse_group_of(job.model_copy(update={"analysis": "inverse", "first": None}), known)


def numbers_of(job: Job, known: SectionData | None = None) -> tuple[float, ...]:
    """The numbers (SI) that `reuse_group_of` omits, in the same order for all jobs of a reuse group.

    Quantities of laws whose names begin with an underscore follow from others.

    Args:
        known: data of sections of earlier jobs of the same file.
    """
    return (*chain(*(known or SectionData()).memo.each_of(_NUMBERS, job)),)


def _jobs_of_solves(job: Job) -> list[Job]:
    return [solve.job for solve in job.plan] if job.states else [job]


def _numbers_of_laws(job: Job) -> list[float]:
    return [*chain(*map(_numbers_of_ingredient, job.laws.values()))]


def _numbers_of_effects(job: Job) -> list[float]:
    return [*chain(*(_numbers_of_ingredient(effect) for each in _jobs_of_solves(job) for effect in each.effects))]


def _numbers_of_fibres(job: Job) -> list[float]:
    return [*chain(*map(_numbers_of_ingredient, job.fibres.values()))]


def _numbers_of_supports(job: Job) -> list[float]:
    return [*chain(*(_numbers_of_support(support) for each in _jobs_of_solves(job) for support in each.supports))]


def _numbers_of_cavities(job: Job) -> list[float]:
    cavities = chain(*(each.cavities.values() for each in _jobs_of_solves(job)))
    return [*chain(*map(_numbers_of_cavity, cavities))]


_NUMBERS = (_numbers_of_laws, _numbers_of_effects, _numbers_of_fibres, _numbers_of_supports, _numbers_of_cavities)


def _numbers_of_ingredient(ingredient: Ingredient) -> Iterator[float]:
    for name, (value, _) in ingredient.quantities().items():
        if name.startswith("_"):
            continue
        if isinstance(value, float) and math.isfinite(value):
            yield float(value)
        else:
            yield from _numbers(value)


def _skeletons_of_effects(part: Job | StateSpec, effects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [_skeleton(*effect) for effect in zip(part.effects, effects, strict=True)]


def _skeletons_of_supports(part: Job | StateSpec, supports: list[dict[str, Any]] | None) -> list[dict[str, Any]] | None:
    if part.supports is None:
        return None
    return [_skeleton_of_support(*support) for support in zip(part.supports, supports or (), strict=True)]


def _skeleton_of_state(state: StateSpec, data: Mapping[str, Any]) -> dict[str, Any]:
    volumes = {"volumes": list(state.volumes), "unloaded_volumes": list(state.unloaded_volumes)}
    loads = {
        "effects": _skeletons_of_effects(state, data["effects"]),
        "supports": _skeletons_of_supports(state, data.get("supports")),
    }
    return {**data, **volumes, **loads}


def _skeleton_of_cavity(cavity: Cavity, data: Mapping[str, Any]) -> dict[str, Any]:
    return {**data, **{key: _marked_control(getattr(cavity, key)) for key in CONTROLS}}


def _marked_control(value: Any) -> Any:
    return {name: _marked(entry) for name, entry in value} if isinstance(value, Spec) else _marked(value)


def _numbers_of_cavity(cavity: Cavity) -> Iterator[float]:
    for value in (getattr(cavity, key) for key in CONTROLS):
        yield from (number for _, number in value) if isinstance(value, Spec) else _numbers(value)


def _skeleton(ingredient: Ingredient, data: Mapping[str, Any]) -> dict[str, Any]:
    left_out = {*quantities_of(type(ingredient)), "constants", "parameters"}
    plain = {name: value for name, value in data.items() if name not in left_out}
    kinds = {name: _marked(value) for name, (value, _) in ingredient.quantities().items()}
    return plain | {"quantities": kinds, "structure": ingredient.structure()}


def _marked(value: Any) -> Any:
    """JSON data of a quantity, with a placeholder for each number."""
    if isinstance(value, tuple):
        return [_marked(entry) for entry in value]
    if isinstance(value, Field):
        return [value.plain(with_definitions=True), sorted(value.numbers)]
    return value if value is None or math.isinf(value) else _NUMBER


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for entry in value:
            yield from _numbers(entry)
    elif isinstance(value, Field):  # the numbers of regions are values of a function, not entries of a constant
        yield from (number for _, number in sorted(value.numbers.items()) if not value.is_regional)
    elif value is not None and value != math.inf:
        yield float(value)


def _skeleton_of_support(support: Support, data: Mapping[str, Any]) -> dict[str, Any]:
    formulas = [f if f is None else f.whole if f.names else _NUMBER for f in support.displacement or ()]
    constants = sorted(support.constants) if support.surface is None else dict(support.constants)
    return {**data, "displacement": formulas, "constants": constants}


def _numbers_of_support(support: Support) -> Iterator[float]:
    yield from (float(f.evaluate()) for f in support.displacement or () if f is not None and not f.names)
    if support.surface is None:
        yield from (support.constants[name] for name in sorted(support.constants))


_SKELETONS: Mapping[str, Callable[[Job, Any], Any]] = {
    "effects": _skeletons_of_effects,
    "supports": _skeletons_of_supports,
    "material": _skeletons_of_laws,
    "fibres": lambda job, fibres: {name: _skeleton(family, fibres[name]) for name, family in job.fibres.items()},
    "cavities": lambda job, given: {name: _skeleton_of_cavity(one, given[name]) for name, one in job.cavities.items()},
    "states": _skeletons_of_states,
}
"""entries with numbers: their structure, by the job and the entry"""

_STRUCTURE = EntryTexts(
    ("format", lambda known, job: json.dumps(FORMAT)),
    *((name, partial(_skeleton_text, name) if name in _SKELETONS else text) for name, text in entry_texts(NOT_PHYSICS)),
    ("partition", _partition_text),
    ("cavities", _no_cavities_text),
    ("order", _order_text),
)
"""the fingerprint of a job with placeholders for its numbers"""
_GROUP = EntryTexts(*_STRUCTURE.texts, ("solver", _solver_text))
