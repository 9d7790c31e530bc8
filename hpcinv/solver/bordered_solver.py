"""Linear solves with the tangent of a system and the equations of its unknown numbers, by the factors of K alone.

The residuals ``R(x, q)`` and ``C(x, q)`` of a state x and unknown numbers q vanish to first order after the corrections

    Δx = -d - g Δq,      (B g - ∂C/∂q) Δq = C - B d,

with ``K d = R``, ``K g = ∂R/∂q``, ``K = ∂R/∂x`` and ``B = ∂C/∂x``.

Numbers are pressures of cavities, motions of regions, and the load factor λ of a path that is followed by its length.

Source: Keller, *Lectures on Numerical Methods in Bifurcation Problems*, 1987 (bordering).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.solver.border import Border
from hpcinv.solver.linear_solver import LinearSolver


class BorderedSolver:
    """The unknown numbers of a system, if there are any, with their linearised equations; collective.

    Args:
        borders: the load factor of a path is the last of them.

    Attributes:
        count: number of numbers.
        is_stale: whether the columns belong to an earlier tangent.
    """

    def __init__(self, system: System, linear: LinearSolver, borders: Sequence[Border] = ()) -> None:
        self._system, self._linear, self.borders = system, linear, borders
        ends = np.cumsum([border.count for border in borders], dtype=int).tolist()
        self._places = [slice(end - border.count, end) for border, end in zip(borders, ends, strict=True)]
        self._own_count = sum(border.count for border in borders if border.load is None)
        self.count = ends[-1] if ends else 0
        self._r = [system.position()] if self.count else []
        self._columns = [system.position() for _ in range(self.count)]
        self._by_numbers = [system.position() for _ in range(self.count)]  # ∂R/∂q
        self._condensed: Floats = np.zeros((0, 0))
        self._slopes_by_numbers: Floats = np.zeros((0, 0))  # ∂C/∂q
        self._least_load = max((border.least_load for border in borders), default=0.0)
        self.is_stale = True

    @property
    def least(self) -> float:
        """Displacement (scaled) that rounding errors of C let count as none."""
        return max((border.least for border in self.borders), default=0.0)

    def load_of(self, load: float) -> float:
        """Return the load factor if it is one of the numbers, else the given one."""
        return next((border.load for border in self.borders if border.load is not None), load)

    def kept_numbers(self) -> Any:
        """Return the present numbers for `restore`."""
        return [border.kept_numbers() for border in self.borders]

    def restore(self, numbers: Any) -> None:
        """Take numbers that `kept_numbers` returned; they are not put into the system."""
        for border, own in zip(self.borders, numbers, strict=True):
            border.restore(own)

    def change(self, change: Floats) -> None:
        """Change the numbers by ``Δq``; they are not put into the system."""
        for border, place in zip(self.borders, self._places, strict=True):
            border.change(change[place])

    def _begun(self, load: float) -> float:
        """Return a load factor, or the least one at which all numbers can be put in."""
        return max(load, self._least_load) if load >= 0 else load

    def put(self, load: float) -> None:
        """Put the present numbers and a load factor into the system."""
        load = self._begun(load)
        self._system.set_load(load)
        for border in self.borders:
            border.put(load)

    def recover(self, load: float) -> None:
        """Put the numbers in that the present state has, an equilibrium at this load factor, such as a checkpoint."""
        self._system.set_load(load)
        for border in self.borders:
            border.recover(load)
            border.put(load)

    def begin_path(self) -> None:
        """Let C lead from its values at the present state, where the system's path begins, to those at full load."""
        for border in self.borders:
            border.begin_path()

    def equations(self, load: float) -> Floats:
        """Return C at the present state."""
        return np.concatenate([np.zeros(0), *(border.equations(self._begun(load)) for border in self.borders)])

    def size(self, change: Floats) -> float:
        """Return the size of a change by which a correction is measured too, relative to the norm of the state."""
        sizes = (border.size(change[place]) for border, place in zip(self.borders, self._places, strict=True))
        return max(sizes, default=0.0)

    def linearise(self, load: float) -> bool:
        """Assemble K at the present state, and solve for the columns ``g``; return whether that succeeded."""
        self._system.set_load(self._begun(load))
        self._system.tangent()
        return self.set_columns(load)

    def set_columns(self, load: float, *, may_fall_back: bool = True) -> bool:
        """Solve for the columns ``g`` with K of the present state; return whether that succeeded.

        Args:
            may_fall_back: whether the linear solver may take another configuration if it fails.
        """
        load, slopes = self._begun(load), np.zeros((self.count, self.count))
        if self.count:
            self._system.residual(self._r[0])
        for border, place in zip(self.borders, self._places, strict=True):
            border.set_columns(self._by_numbers[place], self._r[0], load)
            slopes[: place.start, place] = border.others_by_numbers()
            slopes[place, place] = border.linearise(load)
        for by_number, column in zip(self._by_numbers, self._columns, strict=True):
            if not self._linear.solve(by_number, column, may_fall_back=may_fall_back):
                return False
        by_columns = [self.slopes(column) for column in self._columns]
        self._slopes_by_numbers = slopes
        self._condensed = (np.stack(by_columns, axis=1) if by_columns else slopes) - slopes
        self.is_stale = False
        return True

    @property
    def condensed(self) -> Floats:
        """``dC/dq`` along states of equilibrium at the last linearisation, (numbers, numbers)."""
        return -self._condensed

    @property
    def sign(self) -> int:
        """Sign by which the determinant of the whole matrix, at a fixed load factor, differs from K's."""
        own = self._own_count
        return int(np.linalg.slogdet(self.condensed[:own, :own])[0]) if own else 1

    def path(self) -> PETSc.Vec:
        """Return the derivative of states of equilibrium by the load factor at the last linearisation.

        Raises:
            LinAlgError: it does not exist.
        """
        own = self._own_count
        rates = np.linalg.solve(self._condensed[:own, :own], -self._condensed[:own, -1]) if own else np.zeros(0)
        g = self._columns[-1].copy()
        for column, rate in zip(self._columns[:own], rates, strict=True):
            g.axpy(float(rate), column)
        g.scale(-1.0)
        return g

    def solve(self, r: PETSc.Vec, values: Floats, d: PETSc.Vec) -> Floats | None:
        """Set ``d`` to ``-Δx`` for the residuals R and C; return ``Δq``, ``None`` if K cannot be solved with.

        Raises:
            LinAlgError: the numbers do not determine C, such as a pressure that moves no volume.
        """
        return self.complete(values, d) if self._linear.solve(r, d) else None

    def complete(self, values: Floats, d: PETSc.Vec) -> Floats:
        """Add to ``d = K⁻¹ R`` what the numbers change, and return ``Δq``, as `solve` does."""
        if not self.count:
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
        change = self.solve(r, values, d)
        if change is None or not self.count or self._system.director is not None:
            return change
        rest, correction = self._r[0], r.duplicate()
        self._system.matrix.mult(d, rest)
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
        return np.concatenate([np.zeros(0), *(border.slopes(direction) for border in self.borders)])

    def destroy(self) -> None:
        """Free PETSc objects; the borders have their own."""
        for vector in (*self._r, *self._columns, *self._by_numbers):
            vector.destroy()
