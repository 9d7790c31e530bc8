"""Linear solves with the tangent of a system and the equations of its borders, by the factors of K alone.

The residuals ``R(x, q)`` and ``C(x, q)`` of a state x and unknown numbers q vanish to first order after the corrections

    Δx = -d - g Δq,      (B g - ∂C/∂q) Δq = C - B d,

with ``K d = R``, ``K g = ∂R/∂q``, ``K = ∂R/∂x`` and ``B = ∂C/∂x``.

Source: Keller, *Lectures on Numerical Methods in Bifurcation Problems*, 1987 (bordering).
"""

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from hpcinv.mesh.source import Floats
from hpcinv.solver.border import Border
from hpcinv.solver.equilibrium import Equilibrium


class BorderedSolver:
    """Solves of the linearised equations of an equilibrium and its borders, if there are any; collective."""

    def __init__(self, equilibrium: Equilibrium, borders: Sequence[Border]) -> None:
        self._equilibrium, self._borders = equilibrium, borders
        position = equilibrium.system.position
        self._r = position()
        self._groups = [[position() for _ in range(border.count)] for border in borders]
        self._columns = [column for group in self._groups for column in group]
        self._by_numbers = [position() for _ in self._columns]  # ∂R/∂q
        self._condensed: Floats = np.zeros((0, 0))
        self._slopes_by_numbers: Floats = np.zeros((0, 0))  # ∂C/∂q

    def linearise(self, load: float) -> bool:
        """Factorize K at the present state, and solve for the columns ``g``; return whether that succeeded."""
        system, linear = self._equilibrium.system, self._equilibrium.linear
        if self._borders:
            system.residual(self._r)
        for border, columns in zip(self._borders, self._groups, strict=True):
            border.set_columns(columns, self._r, load)
        system.tangent()
        for column, by_number in zip(self._columns, self._by_numbers, strict=True):
            column.copy(by_number)
            if not linear.solve(by_number, column):
                return False
        self._slopes_by_numbers = _block_diagonal([border.linearise(load) for border in self._borders])
        slopes = [self.slopes(column) for column in self._columns]
        self._condensed = (np.stack(slopes, axis=1) if slopes else np.zeros((0, 0))) - self._slopes_by_numbers
        return True

    @property
    def condensed(self) -> Floats:
        """``dC/dq`` along states of equilibrium at the last linearisation, (numbers, numbers)."""
        return -self._condensed

    def solve(self, r: PETSc.Vec, values: Floats, d: PETSc.Vec) -> Floats | None:
        """Set ``d`` to ``-Δx`` for the residuals R and C; return ``Δq``, ``None`` if K cannot be solved with.

        Raises:
            LinAlgError: the numbers do not determine C, such as a pressure that moves no volume.
        """
        if not self._equilibrium.linear.solve(r, d):
            return None
        if not self._borders:
            return np.zeros(0)
        change: Floats = np.asarray(np.linalg.solve(self._condensed, values - self.slopes(d)), dtype=np.float64)
        for column, dq in zip(self._columns, change, strict=True):
            d.axpy(float(dq), column)
        return change

    def solve_refined(self, r: PETSc.Vec, values: Floats, d: PETSc.Vec) -> Floats | None:
        """Solve as `solve` does, with one refinement, which is accurate even where K alone is singular.

        Such a place is the largest pressure of a balloon. In thin shells, whose K has other unknowns, it is left out.

        Source: Govaerts & Pryce, BIT 30, 490 (1990).
        """
        change, system = self.solve(r, values, d), self._equilibrium.system
        if change is None or not self._borders or system.director is not None:
            return change
        rest, correction = self._r, r.duplicate()
        system.matrix.mult(d, rest)
        rest.aypx(-1.0, r)
        for by_number, dq in zip(self._by_numbers, change, strict=True):
            rest.axpy(float(dq), by_number)
        missing = values - self.slopes(d) + self._slopes_by_numbers @ change
        further = self.solve(rest, missing, correction)
        d.axpy(1.0, correction)
        correction.destroy()
        return None if further is None else change + further

    def slopes(self, direction: PETSc.Vec) -> Floats:
        """Return ``B`` times a direction."""
        return np.concatenate([border.slopes(direction) for border in self._borders])

    def destroy(self) -> None:
        """Free PETSc objects."""
        for vector in (self._r, *self._columns, *self._by_numbers):
            vector.destroy()


def _block_diagonal(blocks: Sequence[Floats]) -> Floats:
    """Return a matrix with square blocks on its diagonal."""
    size, start = sum(len(block) for block in blocks), 0
    matrix = np.zeros((size, size))
    for block in blocks:
        end = start + len(block)
        matrix[start:end, start:end] = block
        start = end
    return matrix
