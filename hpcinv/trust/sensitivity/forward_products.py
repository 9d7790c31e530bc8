"""Products of the derivative of a solution with directions of its parameters (``jvp``), by one solve.

A direction dθ of numbers, fields, and nodes of the given body gives ``K du = -∂R/∂θ dθ``, and results follow by
``∂J/∂u du + ∂J/∂θ dθ``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.component import Ingredient
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.support import Support
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.analysis import moves_nodes
from hpcinv.trust.sensitivity.field_parameters import FieldParameter
from hpcinv.trust.sensitivity.linear_products import solve
from hpcinv.trust.sensitivity.linearised import NODES, SHAPE, Linearised
from hpcinv.trust.sensitivity.quantity_covectors import is_at_points
from hpcinv.trust.sensitivity.variations import Variations


def jvp(equations: Equations, solution: Solution, job: Job, direction: Mapping[str, Any]) -> dict[str, Any]:
    """Return the derivatives of the shape and of the quantities along a direction, by one solve; collective.

    Args:
        direction: rates (SI) by keys of numbers under ``sensitivities``, by keys of fields (arrays as of `vjp`), and
            ``nodes``, (nodes, 3).

    Returns:
        ``shape`` (nodes, 3) in m, and each quantity that has a derivative.

    Raises:
        JobError, SolveError: as `vjp`.
    """
    return _Along(equations, solution, job, "jvp").along(direction)


class _Along(Linearised):
    """Derivatives along a direction; methods are collective."""

    def along(self, direction: Mapping[str, Any]) -> dict[str, Any]:
        forces, held, moved = self._rates(direction)
        with self._equations.timings("sensitivities"):
            rates = self._solve_along(forces, held)
            u = self._length * rates[self._unknowns.displacement_dofs_of_nodes]
            shape = np.zeros((len(self.maps.numbers), 3))
            shape[self.maps.displacement.points] = self._solution.sign * self.maps.displacement.at_points(u)
            results: dict[str, Any] = {SHAPE: self.maps.gathered(shape) + moved}
            for name, quantity in self._quantities.items():
                if self._fault_of(quantity):
                    continue
                if is_at_points(quantity):
                    parts = [
                        self._sum(at_u * u) + float((at_mesh * moved).sum())
                        for at_u, at_mesh in self._point_gradients(name)
                    ]
                    results[name] = parts if quantity.is_vector else parts[0]
                else:
                    results[name] = self._along_form(self._form_of(name), direction, rates, moved)
        return results

    def _sum(self, values: Floats) -> float:
        return float(self._comm.allreduce(float(values.sum()), op=MPI.SUM))

    def _rates(self, direction: Mapping[str, Any]) -> tuple[Floats, Floats, Floats]:
        """Return derivatives of nodal forces, prescribed displacements (local unknowns), and nodes (N, 3) m."""
        forces, held = np.zeros(len(self._unknowns.state.x.array)), np.zeros(len(self._unknowns.state.x.array))
        moved = np.zeros((self.maps.node_count, 3))
        for key, given in direction.items():
            if key == NODES:
                if reason := self._fault_of_nodes():
                    raise self._error(reason)
                moved += self._array(given, moved.shape, "the direction of 'nodes'")
                continue
            for parameter, rate in self._numbers_of(key, given):
                if isinstance(parameter.owner, Support):
                    held += rate * self._supports.rates(parameter)
                elif moves_nodes(parameter, self._job):
                    moved += rate * self._node_rates(parameter)
        for field, values in self._fields_of(direction):
            forces += field.along(self._residual, values)
        if moved.any():
            local = self.maps.on_motion(self._residual.motion.function_space, moved)
            forces += self._residual.along_motion(local / self._length)
            held += self._supports.along_nodes(moved[self.maps.numbers], self.maps)
        return forces, held, moved

    def _numbers_of(self, key: str, given: Any) -> list[tuple[Parameter, float]]:
        """Return the numbers that change with a key of the direction, and their rates; none for fields."""
        found = [p for p in self._parameters if p.key == key]
        if np.ndim(given) or not found:
            return []
        rate = float(self._array(given, (), f"the direction of '{key}'"))
        return [(number, number.ratio * rate) for number in (found[0], *found[0].ties)]

    def _fields_of(self, direction: Mapping[str, Any]) -> Iterator[tuple[FieldParameter, Floats]]:
        """Yield fields and their rates, of numbers of laws, effects and fibres too."""
        for key, given in direction.items():
            if key == NODES:
                continue
            if numbers := self._numbers_of(key, given):
                for parameter, rate in numbers:
                    if isinstance(parameter.owner, Ingredient):
                        whole = FieldParameter.of_number(
                            parameter, self._equations, self._weak_form, self.maps, by_facet=False
                        )
                        yield whole, np.full(whole.shape, rate)
            else:
                field = self._field(key)
                yield field, self._array(given, field.shape, f"the direction of '{key}'")

    def _along_form(self, form: Variations, direction: Mapping[str, Any], rates: Floats, moved: Floats) -> float:
        """Return the derivative of a quantity that is a form."""
        value = self._sum(form.by_state() * rates)
        by_entries = form.by_entries()
        for field, values in self._fields_of(direction):
            value += float((field.gradient(form, by_entries) * values).sum())
        if moved.any():
            by_nodes = self.maps.nodal(form.motion.function_space, form.by_nodes() / self._length)
            value += float((by_nodes * moved).sum())
        return value

    @property
    def _residual(self) -> Variations:
        made: Variations = self._kept("residual", lambda: Variations(self._weak_form.residual, self._weak_form))
        return made

    def _solve_along(self, forces: Floats, held: Floats) -> Floats:
        """Return rates of the local unknowns for rates of nodal forces and of prescribed displacements."""
        equations = self._equations
        equilibrium = equations.equilibrium(self._weak_form)
        system = equilibrium.system
        try:
            self._linearise(system)
            b, x = system.rhs.duplicate(), system.rhs.duplicate()
            with b.localForm() as local:
                local.array[:] = forces
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            if equations.supports.prescribe_motion:
                x.array[:] = held[: len(x.array)]
                b.array[:] += system.force_rates(x)
            equations.supports.free(b.array)
            b.scale(-1.0)
            b.array[:] += held[: len(b.array)]
            if self._weak_form.contacts.pairs:
                self._settled(equilibrium).solve(b, np.zeros(0), x)
            else:
                solve(system, equilibrium.linear, b, x, is_transposed=False)
            found = fem.Function(self._unknowns.space)
            found.x.array[: len(x.array)] = x.array
            found.x.scatter_forward()
            b.destroy()
            x.destroy()
        finally:
            equations.release(equilibrium)
        return np.asarray(found.x.array)
