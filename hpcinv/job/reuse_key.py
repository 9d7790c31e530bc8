"""Reuse groups: jobs that can share mesh, equations and symbolic factorization, and the numbers in which they differ.

The numbers of laws, effects, fibres and supports are entries of one constant of the forms (`Parameters`), so that jobs
that differ only in these use the same kernels and the same matrix.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hpcinv.job.fingerprint import WITH_DEFINITIONS, file_digest, fingerprint
from hpcinv.job.job import Job
from hpcinv.job.sections import Support
from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.quantity import quantities_of
from hpcinv.quantity.spatial_fields import Field

_EQUATIONS = {"linear", "petsc", "maximum_iterations", "reuse_tangent"}
_NUMBER = "#"


def reuse_group_of(job: Job, digest: Callable[[Path], str] = file_digest) -> str:
    """Hash (20 hex digits) of a job without the numbers of its laws, effects, fibres and supports.

    Args:
        digest: SHA-256 of a file; callers with many jobs on the same files can cache it.
    """
    content = _structure(job, digest) | {"solver": job.solver.model_dump(mode="json", include=_EQUATIONS)}
    return _hash(content)


def digests_of_structure(job: Job, digest: Callable[[Path], str] = file_digest) -> dict[str, str]:
    """Hash of each section of a job without its numbers and solver: what solutions of jobs must have in common."""
    return {section: _hash(content) for section, content in _structure(job, digest).items()}


def _hash(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]


def _structure(job: Job, digest: Callable[[Path], str]) -> dict[str, Any]:
    content = (
        fingerprint(job, digest)
        | _skeleton_of_loads(job)
        | {
            "material": {where: _skeleton(law) for where, law in job.laws.items()},
            "fibres": {where: _skeleton(family) for where, family in job.families.items()},
            "partition": job.mesh.partition,
        }
    )
    if controlled := job.controlled_cavities:
        content["cavities"] = {name: [cavity.regions, cavity.apex] for name, cavity in controlled.items()}
    if job.states:
        content["states"] = [_skeleton_of_loads(solve.job) | {"state": solve.job.state} for solve in job.plan]
        content["order"] = [[solve.mesh, solve.start] for solve in job.plan]
    return content


def structure_of(job: Job, digest: Callable[[Path], str] = file_digest) -> str:
    """Hash of what states of one job must have in common to share equations: `reuse_group_of` in any direction.

    A state with functions that the solver updates, such as contact pressures, keeps its own.
    """
    if any(effect.functions(1) for effect in job.effects):
        return job.state
    return reuse_group_of(job.model_copy(update={"analysis": "inverse", "first": None}), digest)


def numbers_of(job: Job) -> tuple[float, ...]:
    """The numbers (SI) that `reuse_group_of` omits, in the same order for all jobs of a reuse group.

    Quantities of laws whose names begin with an underscore follow from others.
    """
    jobs = [solve.job for solve in job.plan] if job.states else [job]
    effects = (effect for each_job in jobs for effect in each_job.effects)
    ingredients = (*job.laws.values(), *effects, *job.families.values())
    values = (v for i in ingredients for name, (v, _) in i.quantities().items() if not name.startswith("_"))
    ingredient_numbers = (number for value in values for number in _numbers(value))
    return (
        *ingredient_numbers,
        *(n for each_job in jobs for support in each_job.supports for n in _numbers_of_support(support)),
    )


def _skeleton_of_loads(job: Job) -> dict[str, Any]:
    return {
        "effects": [_skeleton(effect) for effect in job.effects],
        "supports": [_skeleton_of_support(support) for support in job.supports],
    }


def _skeleton(ingredient: Ingredient) -> dict[str, Any]:
    left_out = {*quantities_of(type(ingredient)), "constants", "parameters"}
    plain = ingredient.model_dump(mode="json", exclude=left_out, context=WITH_DEFINITIONS)
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


def _skeleton_of_support(support: Support) -> dict[str, Any]:
    plain = support.model_dump(mode="json", exclude={"displacement", "constants"}, context=WITH_DEFINITIONS)
    formulas = [f if f is None else f.whole if f.names else _NUMBER for f in support.displacement or ()]
    constants = sorted(support.constants) if support.surface is None else dict(support.constants)
    return plain | {"displacement": formulas, "constants": constants}


def _numbers_of_support(support: Support) -> Iterator[float]:
    yield from (float(f.evaluate()) for f in support.displacement or () if f is not None and not f.names)
    if support.surface is None:
        yield from (support.constants[name] for name in sorted(support.constants))
