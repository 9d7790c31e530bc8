"""Products of the derivative of a solution with covectors (``vjp``), by one solve for any number of parameters.

The solution of ``R(u; θ) = 0`` gives results ``J(u, θ)``. With ``Kᵀ λ = (∂J/∂u)ᵀ w`` the gradient of ``w·J`` is
``w·∂J/∂θ - λ·∂R/∂θ``. Parameters are numbers of the job, fields, and the nodes of the given body.

Source: Plessix, Geophys. J. Int. 167, 495-503, 2006, doi:10.1111/j.1365-246X.2006.02978.x.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter, tied_parameters
from hpcinv.job.support import Support
from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.analysis import moves_nodes
from hpcinv.trust.sensitivity.field_parameters import FieldParameter
from hpcinv.trust.sensitivity.linear_products import solve
from hpcinv.trust.sensitivity.linearised import SHAPE, Linearised
from hpcinv.trust.sensitivity.quantity_covectors import is_at_points
from hpcinv.trust.sensitivity.sensitivities import Gradient
from hpcinv.trust.sensitivity.variations import Variations


def vjp(
    equations: Equations,
    solution: Solution,
    job: Job,
    covector: Mapping[str, Any],
    fields: Iterable[str] = (),
    *,
    nodes: bool = False,
) -> Gradient:
    """Return the gradient of ``Σ weight · result``, by one solve with the transposed tangent; collective.

    Args:
        covector: weights by the name of a quantity, or ``shape``, (nodes, 3) in the order of the job's mesh.
        fields: keys of quantities of laws, effects or fibres, which have a value in each cell, facet or node.
        nodes: whether to differentiate by the nodes of the given body too.

    Raises:
        JobError: on all ranks: unknown names, wrong shapes, or what has no adjoint derivative.
        SolveError: on all ranks, if the tangent at the solution is singular.
    """
    return _Adjoint(equations, solution, job, "vjp").gradient(covector, list(fields), nodes=nodes)


class _Adjoint(Linearised):
    """Derivatives by one solve with the transposed tangent; methods are collective."""

    def gradient(self, covector: Mapping[str, Any], fields: list[str], *, nodes: bool) -> Gradient:
        weights = self._weights(covector)
        asked = {key: self._field(key) for key in fields}
        if nodes and (reason := self._fault_of_nodes()):
            raise self._error(reason)
        with self._equations.timings("sensitivities"):
            by_state, by_mesh, forms = self._by_results(weights)
            by_held = self._solve_transposed(by_state)
            return self._collected([(1.0, self._work), *forms], by_held, by_mesh, asked, nodes=nodes)

    def _weights(self, covector: Mapping[str, Any]) -> dict[str, Floats]:
        """Return checked weights by name."""
        known = {SHAPE, *self._quantities}
        weights = {}
        for name, given in covector.items():
            if name not in known:
                raise self._error(f"unknown result '{name}'.{did_you_mean(str(name), known)}")
            quantity = None if name == SHAPE else self._quantities[name]
            shape: tuple[int, ...] = (self.maps.node_count, 3) if quantity is None else (3,) * quantity.is_vector
            weights[name] = self._array(given, shape, f"the covector of '{name}'")
            if quantity is not None and (reason := self._fault_of(quantity)):
                raise self._error(f"'{name}' {reason}")
        return weights

    def _by_results(self, weights: Mapping[str, Floats]) -> tuple[Floats, Floats, list[tuple[float, Variations]]]:
        """Return the derivatives of the weighted results by what they depend on explicitly.

        Returns:
            By the local unknowns, scaled; by the mesh's nodes (N, 3), of positions; and weighted forms of the state.
        """
        nodes = self._unknowns.displacement_dofs_of_nodes
        by_u, by_mesh, forms = np.zeros((len(nodes), 3)), np.zeros((self.maps.node_count, 3)), []
        vector = np.zeros(len(self._unknowns.state.x.array))
        for name, weight in weights.items():
            if name == SHAPE:
                owned = self._solution.sign * self.maps.scattered(weight)
                by_u += self.maps.displacement.at_nodes(owned, len(nodes))
                by_mesh += weight
            elif is_at_points(self._quantities[name]):
                for w, (at_u, at_mesh) in zip(np.atleast_1d(weight), self._point_gradients(name), strict=True):
                    by_u += w * at_u
                    by_mesh += w * at_mesh
            else:
                forms.append((float(weight), self._form_of(name)))
                vector += float(weight) * forms[-1][1].by_state()
        vector[nodes] += self._length * by_u
        return vector, by_mesh, forms

    @property
    def _adjoint(self) -> fem.Function:
        adjoint: fem.Function = self._kept("adjoint", lambda: fem.Function(self._unknowns.space))
        return adjoint

    @property
    def _work(self) -> Variations:
        """Virtual work of the equations' residual on the adjoint state."""
        made: Variations = self._kept(
            "work of the adjoint",
            lambda: Variations(self._weak_form.residual, self._weak_form, self._adjoint),
        )
        return made

    def _solve_transposed(self, by_state: Floats) -> Floats:
        """Set the adjoint state for derivatives by the local unknowns.

        Returns:
            Derivatives (local unknowns) by the displacements that supports prescribe, scaled.
        """
        equations, adjoint = self._equations, self._adjoint
        equilibrium = equations.equilibrium(self._weak_form)
        system = equilibrium.system
        try:
            self._linearise(system)
            b, x = system.rhs.duplicate(), system.rhs.duplicate()
            with b.localForm() as local:
                local.array[:] = by_state
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            whole = b.array.copy()
            equations.supports.free(b.array)
            by_contact: Floats | float = 0.0
            if self._weak_form.contacts.pairs:
                by_contact = self._settled(equilibrium).solve_transposed(b, x)
            else:
                solve(system, equilibrium.linear, b, x, is_transposed=True)
            equations.supports.free(x.array)
            adjoint.x.array[: len(x.array)] = -x.array
            adjoint.x.scatter_forward()
            by_held = np.zeros(len(adjoint.x.array))
            if self._depends_on_held:
                held = system.rhs.duplicate()
                with held.localForm() as local:
                    local.array[:] = self._work.by_state()
                held.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
                by_held[: len(whole)] = whole + held.array - by_contact
                held.destroy()
            b.destroy()
            x.destroy()
        finally:
            equations.release(equilibrium)
        return by_held

    @property
    def _depends_on_held(self) -> bool:
        """Whether prescribed displacements change with parameters."""
        numbers = tied_parameters(self._parameters)
        return self._equations.supports.prescribe_motion or any(isinstance(p.owner, Support) for p in numbers)

    def _collected(
        self,
        forms: Sequence[tuple[float, Variations]],
        by_held: Floats,
        by_mesh: Floats,
        asked: Mapping[str, FieldParameter],
        *,
        nodes: bool,
    ) -> Gradient:
        numbers = tied_parameters(self._parameters)
        if nodes or any(moves_nodes(p, self._job) for p in numbers):
            for weight, form in forms:
                by_motion = weight / self._length * form.by_nodes()
                by_mesh = by_mesh + self.maps.nodal(form.motion.function_space, by_motion)
            by_mesh = by_mesh + self._supports.by_nodes(by_held, self.maps)
        totals, found = dict.fromkeys((p.key for p in numbers), 0.0), {k: np.zeros(f.shape) for k, f in asked.items()}
        for p in numbers:
            totals[p.key] += self._by_number(p, by_held, by_mesh)
        for weight, form in forms:
            by_entries = form.by_entries()
            for p in numbers:
                if isinstance(p.owner, Ingredient):
                    totals[p.key] += weight * self._field_of(p).total(form, by_entries)
            for key, parameter in asked.items():
                found[key] += weight * parameter.gradient(form, by_entries)
        summed = {p.key: sum(number.ratio * totals[number.key] for number in (p, *p.ties)) for p in self._parameters}
        return Gradient(summed, found, by_mesh if nodes else None)

    def _by_number(self, parameter: Parameter, by_held: Floats, by_mesh: Floats) -> float:
        """Return the derivative by a number of a support or of the mesh; 0 for others."""
        if isinstance(parameter.owner, Support):
            return self._supports.by_number(parameter, by_held)
        if moves_nodes(parameter, self._job):
            return float((by_mesh * self._node_rates(parameter)).sum())
        return 0.0
