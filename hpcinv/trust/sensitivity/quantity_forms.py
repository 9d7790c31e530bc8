"""Quantities of interest that are integrals of fields, or fields at a point, as forms of the state.

A field at a point is an integral over its cell, with one quadrature point. Means and roots of mean squares are
integrals with weights that hold to first order.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.stress_measures import components_of, measure_named
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh.cells import quadrature_metadata
from hpcinv.mesh.location import locate
from hpcinv.mesh.regions import find
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.kinematics.ufl_formulas import UFL_FUNCTIONS
from hpcinv.results.point_fields import PointFields
from hpcinv.results.quantities_of_interest import fields_for
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.variations import Variations


class QuantityForm:
    """A quantity by integrals over parts of the body; methods are collective.

    Args:
        quantity: not at points of positions alone (`hpcinv.trust.sensitivity.quantity_covectors.is_at_points`).
    """

    def __init__(self, quantity: QuantityOfInterest, equations: Equations, weak_form: WeakForm) -> None:
        self._quantity, self._equations, self._weak_form = quantity, equations, weak_form
        fields = fields_for([quantity], equations.body, weak_form, equations.scales)
        assert fields is not None
        self._fields: PointFields = fields
        self._measure: Any = None
        self._weights = [fem.Constant(equations.body.mesh, 1.0) for _ in range(2)]
        terms = [self._terms(*place) for place in self._places()]
        power = 2 if quantity.reduce == "rms" else 1
        self._values = Variations(_sum(size * f**power * dx for f, size, dx in terms), weak_form)
        self._sizes = Variations(_sum(size * dx for _, size, dx in terms), weak_form)
        a, b = self._weights
        self._whole = Variations(_sum((a * f**power - b) * size * dx for f, size, dx in terms), weak_form)

    def linearised(self) -> Variations:
        """Return a form whose derivatives are the quantity's at the present state."""
        comm, reduce = self._equations.body.mesh.comm, self._quantity.reduce
        a, b = self._weights
        a.value, b.value = 1.0, 0.0
        if reduce in ("mean", "rms"):
            size = comm.allreduce(self._sizes.value(), op=MPI.SUM)
            mean = comm.allreduce(self._values.value(), op=MPI.SUM) / size
            slope = 1.0 if reduce == "mean" else (0.5 / mean**0.5 if mean > 0 else 0.0)
            a.value, b.value = slope / size, slope * mean / size
        return self._whole

    def _places(self) -> Iterator[tuple[str, int, Any]]:
        """Yield kind of the samples, part of the body, and measure."""
        body, quantity = self._equations.body, self._quantity
        mesh, parts = body.mesh, self._weak_form.parts
        if quantity.at is not None:
            place = locate(body, [quantity.at])[quantity.at]
            assert place is not None  # the quantity was evaluated
            cells = np.array([place.cell] if mesh.comm.rank == place.rank else [], dtype=np.int32)
            rule = {
                "quadrature_rule": "custom",
                "quadrature_degree": 1,
                "quadrature_points": (tuple(place.xi.tolist()),),
                "quadrature_weights": (1.0,),
            }
            yield from self._by_part("points", "dx", cells, cells, rule)
            return
        region = find(body.regions, quantity.on or "", body.source)
        degree = self._fields.quadrature_degree
        if region.cell_count:
            owned = region.cells[region.cells < mesh.topology.index_map(3).size_local]
            yield from self._by_part("cells", "dx", owned, owned, quadrature_metadata(body.source.kind, degree))
        else:
            entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, mesh.topology, region.facets)
            pairs = np.asarray(entities).reshape(-1, 2)
            yield from self._by_part("facets", "ds", pairs, pairs[:, 0], {"quadrature_degree": int(degree)})
        assert parts

    def _by_part(
        self, kind: str, measure: str, entities: LocalIndices, cells: LocalIndices, rule: Any
    ) -> Iterator[tuple[str, int, Any]]:
        mesh = self._equations.body.mesh
        data, numbers = [], []
        for number, part in enumerate(self._weak_form.parts):
            here = np.ones(len(cells), dtype=bool) if part.cells is None else np.isin(cells, part.cells)
            if mesh.comm.allreduce(bool(here.any()), op=MPI.LOR):
                data.append((number + 1, np.ascontiguousarray(entities[here].ravel(), dtype=np.int32)))
                numbers.append(number)
        whole = ufl.Measure(measure, mesh, subdomain_data=data, metadata=rule)
        for number in numbers:
            yield kind, number, whole(number + 1)

    def _terms(self, kind: str, part: int, dx: Any) -> tuple[Any, Any, Any]:
        """Return the quantity's formula (SI), the size (SI) per scaled size of the mesh, and the measure."""
        names, quantity = self._quantity.of.names, self._quantity
        known = {name: unit * f for name, (f, unit) in self._fields.expressions(part, kind).items()}
        for name in names:
            if (measure := measure_named(name)) is not None:
                known[name] = measure(*(known[c] for c in components_of(name)))
        f = ufl.as_ufl(quantity.of.apply({name: known[name] for name in names}, UFL_FUNCTIONS))
        kin, length = self._weak_form.kinematics, self._equations.scales.length
        if kind == "points":
            return f, 1 / abs(ufl.JacobianDeterminant(self._equations.body.mesh)), dx
        sizes = kin.volumes if kind == "cells" else kin.areas
        size = sizes[1] if quantity.over == "current" else sizes[0]
        return f, size * length ** (3 if kind == "cells" else 2), dx


def _sum(terms: Iterator[Any]) -> Any:
    first, *others = terms
    return sum(others, first)
