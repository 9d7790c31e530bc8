"""Contact with one obstacle: its pressure at the vertices, which a solver updates between solves, and its resultant."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import ufl
from dolfinx import fem, la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.spatial_fields import Field
from hpcinv.errors import MeshError
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contact_reports import ContactReport
from hpcinv.model.obstacle_passage import Passage
from hpcinv.model.obstacle_surface import ObstacleSurface
from hpcinv.model.parameters import entry_of, present_value
from hpcinv.model.spaces import Unknowns
from hpcinv.model.surface_distance import SurfaceDistance
from hpcinv.physics.effects.contact import PENALTY, QUADRATURE, Contact
from hpcinv.physics.kinematics.kinematics import Kinematics
from hpcinv.physics.kinematics.staged_derivatives import remove_stages

_EXACT = 2.0**-16
"""Change of distances from a triangulated surface at which it has settled, in tolerated penetrations."""
_OVERLAP = 2.0**-6
"""Overlap of a rigid obstacle and the undeformed body that is refused, in lengths of the body."""
_FAST = 8.0
"""Factor by which an update must reduce the penetration; else the penalty grows fourfold."""
_STIFFEST = 64.0
"""Largest growth of the penalty."""
_THICK = 0.02
"""Thickness of a shell by its length below which the penalty falls with its cube, as the stiffness in bending does.
With the penalty of a solid, points of shells of 1/500 go in and out of contact, and no load step is small enough."""


class PenaltyDirection(Protocol):
    """A rigid obstacle with a uniform penalty; methods are collective."""

    where: str

    @property
    def penalty(self) -> float:
        """Present penalty, scaled."""

    def moved(self, step: float, rates: Floats) -> AbstractContextManager[None]:
        """Context with the penalty raised by a share ``step``, and pressures at the vertices by ``step * rates``."""

    def vertex_values(self) -> tuple[Floats, Floats]:
        """Return present pressures and gaps at the vertices of the region, scaled."""


class _Nodal:
    """A UFL vector at the nodes of Lagrange elements; a call returns its present values (local nodes, components)."""

    def __init__(self, vector: Any, body: Body, degree: int) -> None:
        mesh, count = body.mesh, vector.ufl_shape[0]
        self.space = fem.functionspace(mesh, ("Lagrange", degree, (count,)))
        points = self.space.element.interpolation_points
        self._expression = fem.Expression(remove_stages(vector), points, comm=mesh.comm)
        self.values, self._count = fem.Function(self.space), count

    def __call__(self) -> Floats:
        # On all cells: a rank may own a node on the edge of a region without having a facet of it.
        mesh = self.space.mesh
        values: Floats = self.values.x.array.reshape(-1, self._count)
        count = mesh.topology.index_map(3).size_local + mesh.topology.index_map(3).num_ghosts
        cells = np.arange(count, dtype=np.int32)
        values[self.space.dofmap.list] = self._expression.eval(mesh, cells)
        self.values.x.scatter_forward()
        return values


def _softness(body: Body) -> float:
    """Return the share of a solid's penalty that a shell has, which bends more easily; 1 of a solid."""
    relative = body.source.thickness / (body.length * body.length_scale)
    return float(min(relative / _THICK, 1.0) ** 3) if relative > 0 else 1.0


def first_penalty(modulus: float, body: Body) -> float:
    """Return the scaled penalty at first, for a shear modulus; a shell that bends more easily has a lower one."""
    return PENALTY * modulus / body.length * _softness(body)


class ObstacleContact:
    """One contact among `Contacts`; methods are collective."""

    has_obstacle = True

    def __init__(
        self,
        name: str,
        where: str,
        effect: Contact,
        load: Any,
        par: Any,
        k: Kinematics,
        body: Body,
        resolve: Callable[[str], Path],
        degree: int,
        modulus: float,
    ) -> None:
        self._name, self.where, self.effect, self.load, self.par = name, where, effect, load, par
        self._k, self._body, self._degree = k, body, degree
        self._obstacle = ObstacleSurface(effect, load, par, body, resolve, body.mesh.comm)
        self._comm, self.depends_on_state = body.mesh.comm, k.sign > 0
        self._last_change = np.inf  # the last change by an update
        self._before_update: tuple[Floats, Floats | None] | None = None  # pressures and penalties
        self._growth = _STIFFEST
        self._first = first_penalty(modulus, body)
        if self._penalty is not None and not self._penalty.any():
            self._penalty[:] = self._first

    def update_parameters(self, effect: Contact, modulus: float) -> None:
        self.effect = self._obstacle.effect = effect
        self._first = first_penalty(modulus, self._body)

    @property
    def _penalty(self) -> Floats | None:
        """Penalty at the vertices, scaled, if the job gives none."""
        if not self.effect.is_augmented or self.effect.penalty is not None:
            return None
        penalty: Floats = self.par.penalty.x.array
        return penalty

    def reset(self) -> None:
        if self.effect.is_augmented:
            self.par.multiplier.x.array[:] = 0.0
        self._before_update, self._growth = None, _STIFFEST
        if self._penalty is not None:
            self._penalty[:], self._last_change = self._first, np.inf

    def restore(self, report: ContactReport, scales: Scales, transfer: Callable[[fem.Function], fem.Function]) -> None:
        if self.effect.is_augmented:
            _, multiplier = report.fields
            self.par.multiplier.x.array[:] = transfer(multiplier).x.array / scales.stress
        if self._penalty is not None:
            assert report.penalty is not None
            self._penalty[:] = report.penalty * scales.length / scales.stress

    @property
    def has_uniform_penalty(self) -> bool:
        given = self.effect.penalty
        return self.effect.is_augmented and not isinstance(given, Field)

    @property
    def penalty(self) -> float:
        """Uniform penalty, scaled. Collective: a rank without cells has no vertex."""
        return present_value(self.par.penalty) if self._penalty is None else self._largest(self._penalty)

    @contextmanager
    def moved(self, step: float, rates: Floats) -> Iterator[None]:
        values, entries = (self._penalty, slice(None)) if self._penalty is not None else entry_of(self.par.penalty)
        multiplier = self.par.multiplier.x.array
        kept_penalty, pressures = np.array(values[entries]), multiplier[self._vertices]
        values[entries] = (1 + step) * kept_penalty
        multiplier[self._vertices] = pressures + step * rates
        try:
            yield
        finally:
            values[entries], multiplier[self._vertices] = kept_penalty, pressures

    def vertex_values(self) -> tuple[Floats, Floats]:
        values = self._values_at_vertices()
        return values[:, 0].copy(), values[:, 1].copy()

    @property
    def is_iterated(self) -> bool:
        return self.depends_on_state and bool(self.effect.functions(1))

    @property
    def _surface(self) -> SurfaceDistance | None:
        return self._obstacle.triangles

    def passage(self, unknowns: Unknowns) -> Passage | None:
        return self._obstacle.passage(unknowns) if self.depends_on_state else None

    def _nodes(self, space: fem.FunctionSpace) -> Ints:
        facets = self._body.boundary_facets(self.effect.region)
        return np.asarray(fem.locate_dofs_topological(space, 2, facets), dtype=np.int64)

    @cached_property
    def _nodal(self) -> _Nodal:
        """Pressure, gap, and mismatch of the pressure (0 without one) at the nodes of the displacement."""
        args = self._k, self.load, self.par
        mismatch = self.effect.mismatch(*args) if self.effect.is_augmented else ufl.as_ufl(0.0)
        parts = [self.effect.contact_pressure(*args), self.effect.gap(*args)[0], mismatch]
        return _Nodal(ufl.as_vector(parts), self._body, self._degree)

    @cached_property
    def _vertex_function(self) -> fem.Function:
        return fem.Function(fem.functionspace(self._body.mesh, ("Lagrange", 1, (3,))))

    @cached_property
    def _vertices(self) -> Ints:
        return self._nodes(self._vertex_function.function_space)

    def _values_at_vertices(self) -> Floats:
        """Return present values of `_nodal` at the vertices of the region."""
        self._nodal()
        self._vertex_function.interpolate(self._nodal.values)
        self._vertex_function.x.scatter_forward()
        values: Floats = self._vertex_function.x.array.reshape(-1, 3)[self._vertices]
        return values

    @cached_property
    def _position(self) -> _Nodal:
        return _Nodal(self.effect.position(self._k, self.load, self.par), self._body, self._degree)

    def locate(self) -> None:
        if self._surface is not None:
            self._nearest()[1]()

    def _nearest(self) -> tuple[float, Callable[[], None]]:
        """Find the nearest points of a triangulated surface.

        Returns:
            The largest change of the distance of a node on this rank (scaled), and a function that sets the points.
        """
        assert self._surface is not None
        names = ("obstacle_distance", "obstacle_direction", "obstacle_position")
        distance, direction, position = (getattr(self.par, name).x.array for name in names)
        nodes = self._nodes(self.par.obstacle_distance.function_space)
        direction, position = direction.reshape(-1, 3), position.reshape(-1, 3)
        x, length = self._position()[nodes].copy(), self._body.length_scale
        distances, normals = self._surface(x * length)

        def apply() -> None:
            distance[nodes], direction[nodes], position[nodes] = distances / length, normals, x

        expected = distance[nodes] + np.einsum("ni,ni->n", direction[nodes], x - position[nodes])
        return float(np.abs(distances / length - expected).max(initial=0.0)), apply

    def change(self) -> tuple[float, Callable[[], None]]:
        """Return the change by an update, over the largest at which it has settled, and a function that makes it."""
        sizes, updates = [0.0], list[Callable[[], None]]()
        if self.effect.is_augmented:
            values = self._values_at_vertices()
            sizes.append(float(np.abs(values[:, 2]).max(initial=0.0)))
            updates.append(lambda: self._set_pressure(values[:, 0]))
        if self._surface is not None:
            moved, locate = self._nearest()
            sizes.append(moved / (_EXACT * self._tolerance))
            updates.append(locate)
        size = float(self._comm.allreduce(max(sizes), op=MPI.MAX))

        def apply() -> None:
            penalty = self._penalty
            if self.effect.is_augmented:
                kept = None if penalty is None else penalty.copy()
                self._before_update = self.par.multiplier.x.array[self._vertices], kept
            for update in updates:
                update()
            if penalty is not None and size > self._last_change / _FAST:
                penalty[:] = np.minimum(4 * penalty, self._growth * self._first)
            self._last_change = size

        return size, apply

    def halve_update(self) -> None:
        if self._before_update is None:
            return
        pressures, penalty = self._before_update
        self._set_pressure((pressures + self.par.multiplier.x.array[self._vertices]) / 2)
        if penalty is not None and self._penalty is not None:
            self._penalty[:] = penalty
            self._growth = float(penalty.max(initial=0.0)) / self._first

    def _set_pressure(self, values: Floats) -> None:
        self.par.multiplier.x.array[self._vertices] = values

    def check_start(self) -> None:
        gap = self._owned[:, 1]
        if not self.depends_on_state:
            if self.totals()[3] == 0.0:
                raise MeshError(
                    f"{self.where}: '{self.effect.region}' of the given body touches nothing: the gap is at least"
                    f" {-self._largest(-gap, -np.inf) * self._body.length_scale:.3g} m",
                    "Check place, travel and unit of the obstacle, or give a stand_off or a pressure.",
                )
        elif self.effect.is_augmented and (depth := self._largest(-gap)) > _OVERLAP * self._body.length:
            turn = "turn its normal" if self._surface is None else "turn its normals with 'flip'"
            raise MeshError(
                f"{self.where}: the obstacle overlaps '{self.effect.region}' of the unloaded body by"
                f" {depth * self._body.length_scale:.3g} m",
                f"Move it back and let it 'travel' into place, or {turn}; check its unit.",
            )

    @property
    def _owned(self) -> Floats:
        """Present pressure, gap and mismatch at the owned nodes of the region."""
        nodes = self._nodes(self._nodal.space)
        owned: Floats = self._nodal()[nodes[nodes < self._nodal.space.dofmap.index_map.size_local]]
        return owned

    def _largest(self, values: Floats, least: float = 0.0) -> float:
        return float(self._comm.allreduce(float(values.max(initial=least)), op=MPI.MAX))

    @property
    def _tolerance(self) -> float:
        """Tolerated penetration in scaled lengths."""
        penetration: float = present_value(self.par.penetration)
        return penetration

    @cached_property
    def _weighted(self) -> fem.Form:
        """Integrals over the current area of traction, contact, pressure and 1, weighted by the linear basis."""
        k, effect, mesh = self._k, self.effect, self._body.mesh
        args = k, self.load, self.par
        w = ufl.TestFunction(fem.functionspace(mesh, ("Lagrange", 1, (6,))))
        p, (_, m) = effect.contact_pressure(*args), effect.gap(*args)
        touches = ufl.conditional(ufl.gt(p, 0), 1.0, 0.0)
        values = [*(p * m[i] for i in range(3)), touches, p, 1.0]
        integrand = sum(value * w[i] for i, value in enumerate(values))
        return fem.form(remove_stages(k.da(integrand, effect.region, QUADRATURE)))

    def _penalty_in_si(self, scales: Scales) -> float | None:
        given = self.effect.penalty
        if self._penalty is not None:
            return self.penalty * scales.stress / scales.length
        return None if given is None or isinstance(given, Field) else float(given)

    def totals(self) -> Floats:
        """Return the present force and area in contact (4,), scaled."""
        sums = fem.assemble_vector(self._weighted).array.reshape(-1, 6)[:, :4].sum(axis=0)
        totals: Floats = self._comm.allreduce(sums)
        return totals

    def _mean_pressure(self, unit: float) -> fem.Function:
        """Return the pressure, linear between the vertices, with the same resultant on flat facets."""
        vector = fem.assemble_vector(self._weighted)
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        integrals, areas = vector.array.reshape(-1, 6)[self._vertices, 4:].T
        return self._linear(self._name, unit * integrals / areas)

    def _linear(self, name: str, values: Floats) -> fem.Function:
        """Return a function of a name that has these values at the vertices of the region."""
        function = fem.Function(fem.functionspace(self._body.mesh, ("Lagrange", 1)), name=name)
        function.x.array[self._vertices] = values
        return function

    def report(self, scales: Scales) -> ContactReport:
        *force, area = map(float, self.totals())
        p, gap = self._owned[:, :2].T
        most = self._largest(p)
        fields = [self._mean_pressure(scales.stress)]
        if self.effect.is_augmented:
            multiplier = self.par.multiplier.x.array[self._vertices] * scales.stress
            fields.append(self._linear(self._name.replace("pressure", "multiplier"), multiplier))
        unit = scales.stress * scales.length**2
        return ContactReport(
            where=self.where,
            region=self.effect.region,
            assumption=self.effect.assumption,
            force=(force[0] * unit, force[1] * unit, force[2] * unit),
            area=area * scales.length**2,
            penetration=self._largest(-gap) * scales.length,
            distance=self._largest(np.abs(gap[p > 0.01 * most])) * scales.length,
            largest_pressure=self._largest(fields[0].x.array),
            tolerance=self._tolerance * scales.length if self.effect.is_augmented else None,
            is_given=self.effect.pressure is not None,
            penalty=self._penalty_in_si(scales),
            fields=tuple(fields),
        )
