"""Checks that need the mesh: regions exist, parameters are admissible everywhere, directions are not zero."""

import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.quantity import quantities_of, quantity_of
from hpcinv.base.quantity.spatial_fields import entries, is_uniform
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.body_kinds import SHELL
from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.model.fields import BodyFields, law_cells
from hpcinv.physics.materials import MaterialLaw

_FACES = (0, 5)
"""local numbers of the facets of a hexahedron across its third axis"""


def check_fields(job: Job, fields: BodyFields) -> None:
    """Check the regions of laws and effects, and fields at points inside of every cell; collective.

    Raises:
        MeshError: on all ranks, for the first invalid region or field.
    """
    law_cells(fields.body, job.laws)
    _check_regions(job, fields)
    for where, ingredient in [*job.laws.items(), *job.named_effects]:
        _check_bounds(fields, where, ingredient)
    for where, law in job.laws.items():
        if _varies(law):
            _check_moduli(fields, where, law)
    for where, family in job.families.items():
        ((direction, _),) = family.quantities().values()
        length = np.linalg.norm(fields.vector_samples(direction, where), axis=-1)
        _require_positive(fields, length, f"{where}: the length of the direction")
    for where, effect in job.named_effects:
        if _varies(effect) or effect.families:
            directions = {name: _directions(fields, job.families[f"fibres.{name}"], where) for name in effect.families}
            for what, values in effect.positive(_samples(fields, where, effect), directions).items():
                _require_positive(fields, values, f"{where}: {what}")


def _check_regions(job: Job, fields: BodyFields) -> None:
    """Check the regions of the boundary on which effects act."""
    for where, effect in job.named_effects:
        for region, field in effect.surfaces.items():
            with naming_field(f"{where}.{field}"):
                facets = fields.body.boundary_facets(region)
                _REGION_CHECKS.get(effect.only_of_kind, _admit)(fields, region, facets)


def _check_moduli(fields: BodyFields, where: str, law: MaterialLaw) -> None:
    par = _samples(fields, where, law)
    finite = (law.shear_modulus,) if law.is_incompressible else (law.shear_modulus, law.bulk_modulus)
    for modulus in finite:
        _require_positive(fields, modulus(par), f"{where}: the {modulus.__name__.replace('_', ' ')}")


def _varies(ingredient: Ingredient) -> bool:
    """Return whether some of its quantities varies in the body."""
    return any(not is_uniform(value) for value, _ in ingredient.quantities().values())


def _check_bounds(fields: BodyFields, where: str, ingredient: Ingredient) -> None:
    """Check that fields are within the bounds of their quantities; collective."""
    for name in quantities_of(type(ingredient)):
        value = getattr(ingredient, name)
        if value is None or is_uniform(value):
            continue
        expected = quantity_of(type(ingredient), name)
        admits = np.vectorize(expected.admits, otypes=[bool])
        for entry in entries(value):
            _require(fields, fields.samples(entry, f"{where}.{name}"), admits, f"{where}.{name}", expected.bounds)


def _require_positive(fields: BodyFields, values: Any, what: str) -> None:
    _require(fields, np.atleast_1d(values), lambda samples: samples > 0, what, "positive")


def shear_modulus(job: Job, fields: BodyFields) -> float:
    """Return a typical shear modulus (Pa) of the body, the geometric mean of the extremes; collective."""
    comm = fields.body.mesh.comm
    values = [np.atleast_1d(law.shear_modulus(_samples(fields, where, law))) for where, law in job.laws.items()]
    least = comm.allreduce(min(float(v.min(initial=math.inf)) for v in values), op=MPI.MIN)
    most = comm.allreduce(max(float(v.max(initial=0.0)) for v in values), op=MPI.MAX)
    return math.sqrt(least) * math.sqrt(most)


def young_moduli(job: Job, fields: BodyFields) -> tuple[float, float]:
    """Return the least and largest Young's modulus (Pa) of the undeformed body without fibres; collective."""
    comm, values = fields.body.mesh.comm, []
    for where, law in job.laws.items():
        par = _samples(fields, where, law)
        mu = np.atleast_1d(law.shear_modulus(par))
        values.append(3 * mu if law.is_incompressible else 9 * mu / (3 + mu / np.atleast_1d(law.bulk_modulus(par))))
    least = comm.allreduce(min(float(v.min(initial=math.inf)) for v in values), op=MPI.MIN)
    return least, comm.allreduce(max(float(v.max(initial=0.0)) for v in values), op=MPI.MAX)


def _samples(fields: BodyFields, where: str, law: MaterialLaw | Ingredient) -> Any:
    def sampled(name: str, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(sampled(name, entry) for entry in value)
        return value if value is None or is_uniform(value) else fields.samples(value, f"{where}.{name}")

    return SimpleNamespace(**{name: sampled(name, value) for name, (value, _) in law.quantities().items()})


def _directions(fields: BodyFields, family: Ingredient, where: str) -> Floats:
    """Return samples of a family's unit vectors, (cells, points, 3) after broadcasting."""
    ((direction, _),) = family.quantities().values()
    vectors = fields.vector_samples(direction, where)
    unit: Floats = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _check_edge(fields: BodyFields, region: str, facets: LocalIndices) -> None:
    """Check that facets are the band of an edge of a shell; collective."""
    topology = fields.body.mesh.topology
    entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, facets)
    is_on_face = bool(np.isin(entities.reshape(-1, 2)[:, 1], _FACES).any())
    if fields.body.mesh.comm.allreduce(is_on_face, op=MPI.LOR):
        raise MeshError(
            f"{fields.body.source.path}: region '{region}' has parts of a face of the shell",
            "Name an edge, a curve of its surface.",
        )


def _admit(fields: BodyFields, region: str, facets: LocalIndices) -> None:
    """Admit all facets of the boundary."""


_REGION_CHECKS: Mapping[str, Callable[[BodyFields, str, LocalIndices], None]] = {SHELL.name: _check_edge}
"""checks of the facets of an effect by the kind of body that it is for"""


def _require(fields: BodyFields, values: Floats, admits: Callable[[Floats], Any], what: str, wanted: str) -> None:
    finite = np.isfinite(values)
    bad = values[~finite] if not finite.all() else values[~np.asarray(admits(values), dtype=bool)]
    worst = fields.body.mesh.comm.allgather(float(bad.flat[0]) if bad.size else None)
    if (value := next((w for w in worst if w is not None), None)) is not None:
        must = f"must be {wanted}" if math.isfinite(value) and wanted else "must be finite"
        raise MeshError(
            f"{fields.body.source.path}: {what} {must}, but is {value:g} in some cell",
            "Correct the formula or the data, or give these cells another value by their region.",
        )
