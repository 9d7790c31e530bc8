"""Reuse groups: jobs that can share mesh, equations and symbolic factorization, and the numbers in which they differ.

The numbers of laws, effects, fibres and supports are entries of one constant of the forms (`Parameters`), so that jobs
that differ only in these use the same programs and the same matrix.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.schema import Spec
from hpcinv.base.quantity.spatial_fields import Field
from hpcinv.job.cavities import CONTROLS, Cavity
from hpcinv.job.fingerprint import NOT_CONTENT, content_hash, fingerprint, hash_of, physics_in
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import SectionData, resolved
from hpcinv.job.sections import Support
from hpcinv.job.states import StateSpec

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


def keys_of(job: Job, known: SectionData) -> tuple[str, str]:
    """Return `content_key` and `reuse_group_of` of a job, whose data are made once for both."""
    content = resolved(job, NOT_CONTENT, known)
    return content_hash(content), _group(job, _structure(job, physics_in(content)))


def reuse_group_of(job: Job, known: SectionData | None = None) -> str:
    """Hash (20 hex digits) of a job without the numbers of its laws, effects, fibres and supports.

    Args:
        known: data of sections of earlier jobs of the same file.
    """
    return _group(job, _structure(job, fingerprint(job, known)))


def digests_of_structure(job: Job, known: SectionData | None = None) -> dict[str, str]:
    """Hash of each section of a job without its numbers and solver: what solutions of jobs must have in common."""
    return {section: hash_of(content) for section, content in _structure(job, fingerprint(job, known)).items()}


def _group(job: Job, structure: Mapping[str, Any]) -> str:
    return hash_of({**structure, "solver": job.solver.model_dump(mode="json", include=_EQUATIONS)})


def _structure(job: Job, physics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fingerprint ``physics`` of a job with placeholders for its numbers."""
    content = dict(physics)
    laws = {"": content["material"]} if "material" in job.laws else content["material"]
    fibres, cavities = content["fibres"], content.get("cavities", {})
    content |= _skeleton_of_loads(job, content) | {
        "material": {name: _skeleton(law, laws[name]) for name, law in zip(laws, job.laws.values(), strict=True)},
        "fibres": {name: _skeleton(family, fibres[name]) for name, family in job.fibres.items()},
        "partition": job.mesh.partition,
        "cavities": {name: _skeleton_of_cavity(cavity, cavities[name]) for name, cavity in job.cavities.items()},
    }
    if job.states:
        states = zip(job.states, content["states"], strict=True)
        content["states"] = [_skeleton_of_state(state, data) for state, data in states]
        content["order"] = [[solve.mesh, solve.start] for solve in job.plan]
    return content


def structure_of(job: Job, known: SectionData | None = None) -> str:
    """Hash of what states of one job must have in common to share equations: `reuse_group_of` in any direction.

    A state with functions that the solver updates, such as contact pressures, keeps its own.
    """
    if any(effect.functions(1) for effect in job.effects):
        return job.state
    return reuse_group_of(job.model_copy(update={"analysis": "inverse", "first": None}), known)


def numbers_of(job: Job) -> tuple[float, ...]:
    """The numbers (SI) that `reuse_group_of` omits, in the same order for all jobs of a reuse group.

    Quantities of laws whose names begin with an underscore follow from others.
    """
    jobs = [solve.job for solve in job.plan] if job.states else [job]
    ingredients = (*job.laws.values(), *chain(*(each.effects for each in jobs)), *job.fibres.values())
    supports = chain(*(each.supports for each in jobs))
    cavities = chain(*(each.cavities.values() for each in jobs))
    return (
        *chain(*map(_numbers_of_ingredient, ingredients)),
        *chain(*map(_numbers_of_support, supports)),
        *chain(*map(_numbers_of_cavity, cavities)),
    )


def _numbers_of_ingredient(ingredient: Ingredient) -> Iterator[float]:
    for name, (value, _) in ingredient.quantities().items():
        if not name.startswith("_"):
            yield from _numbers(value)


def _skeleton_of_loads(part: Job | StateSpec, data: Mapping[str, Any]) -> dict[str, Any]:
    effects = zip(part.effects, data["effects"], strict=True)
    supports = zip(part.supports or (), data.get("supports", ()), strict=True)
    return {
        "effects": [_skeleton(*effect) for effect in effects],
        "supports": None if part.supports is None else [_skeleton_of_support(*support) for support in supports],
    }


def _skeleton_of_state(state: StateSpec, data: Mapping[str, Any]) -> dict[str, Any]:
    volumes = {"volumes": list(state.volumes), "unloaded_volumes": list(state.unloaded_volumes)}
    return {**data, **volumes, **_skeleton_of_loads(state, data)}


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
    return value if value is None or value == math.inf else _NUMBER


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
