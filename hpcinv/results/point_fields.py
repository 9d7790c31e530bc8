"""Fields at points of the body: stress, stored energy, volume ratio, position."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.classes import FacetJacobianDeterminant

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.stress_measures import (
    COMPONENTS,
    PRESTRAIN,
    PRESTRAIN_COMPONENTS,
    PRESTRAIN_STRESSES,
    components_of,
    measure_named,
)
from hpcinv.job.vocabulary import NORMALS
from hpcinv.mesh import Body
from hpcinv.mesh.cells import FACET_KIND, LayerDegree, layer_interpolation, quadrature
from hpcinv.mesh.location import PointLocation
from hpcinv.mesh.source import Floats
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.kinematics.staged_derivatives import remove_stages

_POSITIONS = ("X", "Y", "Z", "x", "y", "z", "ux", "uy", "uz")
# FFCx takes shape functions within 1e-6 of 0 and ±1 for these numbers, which points of a user may happen to have.
_EXACT = {"table_rtol": 1e-15, "table_atol": 1e-15}


@dataclass(frozen=True)
class Samples:
    """Values (SI) by name at the quadrature points of this rank, and the weights of these points.

    ``reference`` and ``current`` are volumes (m³) of cells or areas (m²) of facets in the two bodies, (n,).
    """

    values: Mapping[str, Floats]
    reference: Floats
    current: Floats


class PointFields:
    """Fields in the present state, at the present coordinates of the mesh.

    These are ``X Y Z x y z ux uy uz`` (m), ``J``, the Cauchy stress ``sxx syy szz sxy syz sxz`` and its measures (Pa),
    and ``energy``, stored per reference volume (J/m³); on facets also ``nx ny nz``, the outward unit normal of the
    current body; with prestrain its stress-free stretch ``F0xx … F0zz``, and components and measures of the stress that
    it causes alone, with the prefix ``prestrain_``.
    """

    def __init__(self, body: Body, weak_form: WeakForm, scales: Scales, names: Collection[str]) -> None:
        self._body, self._weak_form, self._scales = body, weak_form, scales
        self._measures = [name for name in names if measure_named(name) is not None]
        self._names = set(names).union(*map(components_of, self._measures))
        self._has_prestrain = not self._names.isdisjoint({*PRESTRAIN_STRESSES, *PRESTRAIN_COMPONENTS})
        self._has_laws = self._has_prestrain or not self._names.isdisjoint({*COMPONENTS, "energy"})
        self._expressions: dict[tuple[str, int], fem.Expression] = {}

    def cell_samples(self, cells: LocalIndices) -> Samples:
        """Return values at quadrature points in a region's cells; collective."""
        owned = cells[cells < self._body.mesh.topology.index_map(3).size_local]
        return self._samples("cells", self._body.source.kind, owned, owned)

    def facet_samples(self, facets: LocalIndices) -> Samples:
        """Return values at quadrature points on a region's boundary facets; collective."""
        topology = self._body.mesh.topology
        entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, facets).reshape(-1, 2)
        return self._samples("facets", FACET_KIND[self._body.source.kind], entities, entities[:, 0])

    def point_values(self, places: Sequence[PointLocation]) -> list[dict[str, float]]:
        """Return values at single points, the same on all ranks; collective."""
        if not places:
            return []
        comm = self._body.mesh.comm
        mine = [i for i, place in enumerate(places) if place.rank == comm.rank]
        cells = np.array([places[i].cell for i in mine], dtype=np.int32)
        points = np.stack([place.xi for place in places])
        values = self._values("points", points, cells, cells)[np.arange(len(mine)), mine]
        named = self._named("points", values) | self._layer_values(cells, points[mine][:, None])
        rank_values = {i: {name: float(v[row]) for name, v in named.items()} for row, i in enumerate(mine)}
        everywhere = {i: values_there for part in comm.allgather(rank_values) for i, values_there in part.items()}
        return [everywhere[i] for i in range(len(places))]

    @cached_property
    def quadrature_degree(self) -> int:
        """Quadrature degree of the weak form, or the degree that integrates both volumes exactly, if that is higher."""
        element, kind = self._weak_form.unknowns.displacement_space.ufl_element(), self._body.source.kind
        degree = max(self._body.degree, int(element.degree))
        exact = 3 * degree - 1 if kind == "hexahedron" else 3 * (degree - 1)
        return max(exact, self._weak_form.quadrature_degree)

    def _samples(self, kind: str, shape: str, entities: LocalIndices, cells: LocalIndices) -> Samples:
        points, weights = quadrature(shape, self.quadrature_degree)
        values = self._values(kind, points, entities, cells)
        values[..., -2:] *= weights[:, None] * self._scales.length ** (3 if kind == "cells" else 2)
        flat = values.reshape(-1, values.shape[2])
        named = self._named(kind, flat[:, :-2])
        if isinstance(self._weak_form.quadrature_degree, LayerDegree):
            is_inside = kind == "cells"
            places = np.tile(points, (len(cells), 1, 1)) if is_inside else self._facet_places(points, entities)
            named |= self._layer_values(cells, places)
        return Samples(named, flat[:, -2], flat[:, -1])

    def _layer_values(self, cells: LocalIndices, places: Floats) -> dict[str, Floats]:
        """Return fields of a shell at places (cells, n, 3) in cells, without positions; none of other bodies."""
        degree = self._weak_form.quadrature_degree
        if not isinstance(degree, LayerDegree) or self._names.issubset({*_POSITIONS, *NORMALS}):
            return {}
        points, weights = layer_interpolation(degree, places.reshape(-1, 3))
        values = self._values("layers", points, cells, cells)
        at_places = np.einsum("cnp,cpf->cnf", weights.reshape(*places.shape[:2], len(points)), values)
        named = self._named("layers", at_places.reshape(-1, values.shape[2]))
        return {name: field for name, field in named.items() if name not in _POSITIONS}

    def _facet_places(self, points: Floats, entities: LocalIndices) -> Floats:
        """Return the points of facets in their cells, (entities, points, 3), in the order in which values are given."""
        mesh = self._body.mesh
        space = fem.functionspace(mesh, ("DG", 1, (3,)))
        place = fem.Function(space)
        place.x.array.reshape(-1, 3)[space.dofmap.list] = space.element.basix_element.points
        expression = fem.Expression(place, points, comm=mesh.comm)
        return np.asarray(expression.eval(mesh, entities)).reshape(len(entities), len(points), 3)

    def _values(self, kind: str, points: Floats, entities: LocalIndices, cells: LocalIndices) -> Floats:
        """Return the fields and the volume or area ratios at reference points, (entities, points, …); collective."""
        parts = [part.cells for part in self._weak_form.parts] if self._has_laws else [None]
        comm, values = self._body.mesh.comm, np.zeros((len(cells), len(points), 0))
        for number, part_cells in enumerate(parts):
            here = np.ones(len(cells), dtype=bool) if part_cells is None else np.isin(cells, part_cells)
            if not comm.allreduce(bool(here.any()), op=MPI.LOR):
                continue  # no cell of this law among the entities
            if (kind, number) not in self._expressions:
                expressions = [field for field, _ in self.expressions(number, kind).values()] + self._sizes(kind)
                self._expressions[kind, number] = fem.Expression(
                    remove_stages(ufl.as_vector(expressions)),
                    points,
                    comm=comm,
                    form_compiler_options=_EXACT,
                )
            part_values = self._expressions[kind, number].eval(self._body.mesh, entities[here])
            if not values.shape[2]:
                values = np.zeros((len(cells), *part_values.shape[1:]))
            values[here] = part_values
        return values

    def _sizes(self, kind: str) -> list[Any]:
        """Return volumes or areas in both bodies per unit of the reference cell or facet; none for points."""
        kin, mesh = self._weak_form.kinematics, self._body.mesh
        if kind in ("points", "layers"):
            return []
        if kind == "facets":
            return [abs(FacetJacobianDeterminant(mesh)) * ratio for ratio in kin.areas]
        return [abs(ufl.JacobianDeterminant(mesh)) * ratio for ratio in kin.volumes]

    def expressions(self, part: int, kind: str) -> dict[str, tuple[Any, float]]:
        """Return the UFL scalar and the SI value of its unit, by field name."""
        weak_form, kin, scales = self._weak_form, self._weak_form.kinematics, self._scales
        fields = dict(zip(_POSITIONS, ((c, scales.length) for v in (kin.X, kin.x, kin.u) for c in v), strict=True))
        fields["J"] = (weak_form.J, 1.0)
        if kind == "facets":
            fields |= {name: (kin.n[i], 1.0) for i, name in enumerate(NORMALS)}
        if self._has_laws:
            sigma, _ = weak_form.cauchy_stress[part]
            fields |= {name: (sigma[place], scales.stress) for name, place in COMPONENTS.items()}
            fields["energy"] = (weak_form.parts[part].energy, scales.stress)
        if self._has_prestrain:
            own, _ = weak_form.prestrain_stress[part]
            fields |= {PRESTRAIN + name: (own[place], scales.stress) for name, place in COMPONENTS.items()}
            fields |= {name: (weak_form.prestrain[place], 1.0) for name, place in PRESTRAIN_COMPONENTS.items()}
        return {name: field for name, field in fields.items() if name in self._names}

    def _named(self, kind: str, values: Floats) -> dict[str, Floats]:
        named = {name: values[:, i] * unit for i, (name, (_, unit)) in enumerate(self.expressions(0, kind).items())}
        measured = {m: measure_named(m) for m in self._measures}
        return named | {m: f(*(named[c] for c in components_of(m))) for m, f in measured.items() if f is not None}
