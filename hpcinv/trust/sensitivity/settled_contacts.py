"""Derivatives of solutions with interfaces, whose multipliers follow a parameter with the state.

With the forces F of the interfaces and the errors r of their multipliers (`hpcinv.model.interfaces.settled_rates`),
state and multipliers of a solution follow a parameter θ as

    (K + ∂F/∂u) du/dθ + ∂F/∂m dm/dθ = -∂R/∂θ,      ∂r/∂u du/dθ + ∂r/∂m dm/dθ = 0,

with the tangent K of the bodies. What presses, sticks and slides is assumed to stay so.

Source: Michaleris, Tortorelli & Vidal (1994), doi:10.1002/nme.1620371408.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.errors import SolveError
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.entries import DIFFERENT_PATTERN, matrix_of_entries
from hpcinv.model.interfaces.settled_rates import Rates, settled_rates
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.sensitivity.followed_numbers import FollowedNumbers

_ENOUGH = 1e-9
"""Residual over the right-hand side above which the matrix is singular; raised, gradients are inaccurate."""


class SettledContacts(FollowedNumbers):
    """The tangent of a solution with the equations of its multipliers. Methods are collective.

    Jobs with interfaces have no unknown numbers of loads.

    Raises:
        SolveError: on all ranks, if the tangent is singular.
    """

    def __init__(self, equations: Equations, solution: Solution, equilibrium: Equilibrium) -> None:
        self._solution, self._borders, self.count = solution, [], 0
        self._equations, self._system = equations, equilibrium.system
        system, comm = self._system, self._system.comm
        system.linearise(1.0)
        self._pairs = system.weak_form.contacts.pairs
        self._owned, self._size = system.rhs.getSizes()
        self._first = system.rhs.getOwnershipRange()[0]
        self._is_last = comm.rank == comm.size - 1
        self._lift = [pair.stiffness(self._ones()) for pair in self._pairs]
        body = self._body_tangent()
        found = self._rates()
        self._multipliers = sum(rates.count for rates in found)
        self.assumption = _assumption(solution)
        self._free = self._vector()
        self._free.set(1.0)
        free = self._free.array[: self._owned]
        equations.supports.free(free)
        self._contact = self._matrix(*_joined(found, self._size))
        masked = self._contact.copy()
        masked.diagonalScale(self._free, self._free)
        self._whole = self._matrix(*_entries(body, self._first))
        self._whole.axpy(1.0, masked, DIFFERENT_PATTERN)
        masked.destroy()
        body.destroy()
        self._ksp = self._factorized()

    def _ones(self) -> PETSc.Vec:
        ones: PETSc.Vec = self._system.rhs.duplicate()
        ones.set(1.0)
        return ones

    def _body_tangent(self) -> PETSc.Mat:
        """Return the tangent without the interfaces, whose rows and columns of held unknowns are identity."""
        free, matrix = self._ones(), self._system.matrix.copy()
        self._equations.supports.free(free.array)
        for pair in self._pairs:
            stiffness = pair.stiffness(free)
            matrix.axpy(-1.0, stiffness, DIFFERENT_PATTERN)
            stiffness.destroy()
        free.destroy()
        return matrix

    def _rates(self) -> list[Rates]:
        system = self._system
        state = system.state
        space = system.weak_form.unknowns.space.dofmap
        block = space.index_map_bs
        values = state.x.array.copy()

        def move(numbers: Ints, distance: float) -> None:
            local = space.index_map.global_to_local(numbers // block).astype(np.int64)
            here = local >= 0
            moved = state.x.array.copy()
            moved[local[here] * block + numbers[here] % block] += distance
            system.set_values(moved)

        for pair in self._pairs:
            pair.begin_unloaded()
        found = [settled_rates(pair, move, self._first, self._size) for pair in self._pairs]
        system.set_values(values)
        system.locate_contacts()
        return found

    def _vector(self) -> PETSc.Vec:
        return PETSc.Vec().createMPI((self._local_size, PETSc.DETERMINE), comm=self._system.comm)

    @property
    def _local_size(self) -> int:
        return int(self._owned) + (self._multipliers if self._is_last else 0)

    def _matrix(self, rows: Ints, columns: Ints, values: Floats) -> PETSc.Mat:
        sizes = self._local_size, PETSc.DETERMINE
        return matrix_of_entries(self._system.comm, sizes, sizes, (rows, columns), values)

    def _factorized(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self._system.comm)
        ksp.setOperators(self._whole)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.pc.setType(PETSc.PC.Type.LU)
        ksp.pc.setFactorSolverType("mumps")
        return ksp

    def solve(self, b: PETSc.Vec, by_parameter: Floats, x: PETSc.Vec) -> Floats:
        """Set ``x`` to the derivative of the state, for ``-∂R/∂θ`` that was lifted with the tangent of the solver."""
        whole, held = self._vector(), b.copy()
        whole.array[: self._owned] = b.array
        free = self._free.array[: self._owned]
        held.array[:] *= 1.0 - free
        if norm(held) > 0.0:
            self._lift_again(held, whole)
        self._solved(whole, x, is_transposed=False)
        whole.destroy()
        held.destroy()
        return np.zeros(0)

    def _lift_again(self, held: PETSc.Vec, whole: PETSc.Vec) -> None:
        """Let held unknowns that move carry the surfaces along, instead of the tangent of the solver."""
        free, product = self._free.array[: self._owned], held.duplicate()
        for stiffness in self._lift:
            stiffness.mult(held, product)
            whole.array[: self._owned] += free * product.array
        at_held, carried = self._vector(), self._vector()
        at_held.array[: self._owned] = held.array
        self._contact.mult(at_held, carried)
        whole.axpy(-1.0, _times(carried, self._free))
        for vector in (product, at_held, carried):
            vector.destroy()

    def solve_transposed(self, b: PETSc.Vec, x: PETSc.Vec) -> Floats:
        """Set ``x`` to the adjoint state.

        Returns:
            Transposed derivative of the interfaces' equations by the owned unknowns, times the adjoint state.
        """
        whole = self._vector()
        whole.array[: self._owned] = b.array
        adjoint = self._solved(whole, x, is_transposed=True)
        self._contact.multTranspose(adjoint, whole)
        found = np.array(whole.array[: self._owned])
        whole.destroy()
        adjoint.destroy()
        return found

    def _solved(self, b: PETSc.Vec, x: PETSc.Vec, *, is_transposed: bool) -> PETSc.Vec:
        """Set ``x`` to the part of the state of a solution; return all of it."""
        found, rest, correction = b.duplicate(), b.duplicate(), b.duplicate()
        found.set(0.0)
        b.copy(rest)
        for _ in range(3):
            if norm(rest) == 0.0:
                break
            (self._ksp.solveTranspose if is_transposed else self._ksp.solve)(rest, correction)
            found.axpy(1.0, correction)
            (self._whole.multTranspose if is_transposed else self._whole.mult)(found, rest)
            rest.aypx(-1.0, b)
        if not norm(rest) <= _ENOUGH * norm(b):
            raise SolveError(
                "the tangent at the solution is singular or nearly so, so that there are no derivatives there",
                "Take a load at which the solution is not at a limit point, and at which contact holds the bodies.",
            )
        x.array[:] = found.array[: self._owned]
        rest.destroy()
        correction.destroy()
        return found

    def destroy(self) -> None:
        """Free PETSc objects."""
        for part in (self._ksp, self._whole, self._contact, self._free, *self._lift):
            part.destroy()


def _times(vector: PETSc.Vec, other: PETSc.Vec) -> PETSc.Vec:
    vector.pointwiseMult(vector, other)
    return vector


def _entries(matrix: PETSc.Mat, first: int) -> tuple[Ints, Ints, Floats]:
    """Return rows, columns and values of the rows on this rank."""
    starts, columns, values = matrix.getValuesCSR()
    rows = first + np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return rows, columns, values


def _joined(found: list[Rates], size: int) -> tuple[Ints, Ints, Floats]:
    """Return the entries of all interfaces, whose multipliers follow each other."""
    rows, columns, values, first = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)], 0
    for rates in found:
        rows.append(rates.rows + np.where(rates.rows >= size, first, 0))
        columns.append(rates.columns + np.where(rates.columns >= size, first, 0))
        values.append(rates.values)
        first += rates.count
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def _assumption(solution: Solution) -> str:
    """Return what derivatives assume, in words."""
    parts = []
    for contact in solution.contacts:
        part = f"'{contact.region}' presses on {contact.area:.3g} m²"
        if contact.friction is not None:
            part += f" and slides on {contact.friction.sliding_area:.3g} m²"
        parts.append(part)
    return f"what presses, sticks and slides stays so ({'; '.join(parts)})"
