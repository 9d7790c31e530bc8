"""Sign of the lowest eigenvalue of a tangent without factorizing it.

A body is stable if ``S = A + Bᵀ D⁻¹ B`` is positive definite, the tangent ``K = [[A, Bᵀ], [B, -D]]`` without its
pressures (for ``D = 0``: ``A`` on the kernel of ``B``). ``S`` is never formed: ``K (z, s) = (y, 0)`` gives
``z = S⁻¹ y``, and

    q(z) = zᵀ S z = wᵀ K w + Cᵀ D⁻¹ C,    w = (z, s),    C = B z - D s,

where ``C`` is the residual that the linear solver leaves in the rows of the pressures. Inverse iteration from a field
without symmetries, accelerated by the Ritz vectors of all steps, leads to the lowest eigenvalues. In the Ritz values,
``Cᵀ Q⁻¹ C`` stands for the last term, with the scaled mass matrix ``Q`` of the preconditioner: a displacement can be
made to satisfy the constraint by a change of about that energy.

The quotient of one vector proves that an eigenvalue is negative; the equations are solved precisely for that vector.
That none is cannot be proven so. It is estimated from a vector ``y`` of unit length, with ``μ = y·z`` and
``e = |z - μ y|``: there is an eigenvalue of ``S⁻¹`` within ``e`` of ``μ``, the one of largest size as far as the start
had a part in each eigenvector.

Sources: Parlett, *The Symmetric Eigenvalue Problem*, 1998, ch. 4 and 11, doi:10.1137/1.9781611971163; Golub & Ye, BIT
40, 671–684, 2000, doi:10.1023/A:1022388317839 (inexact inverse iteration).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh.source import Floats
from hpcinv.model.supports import Supports
from hpcinv.solver.observer import SILENT, Observer, stop_if_asked
from hpcinv.trust.stability.multigrid_solver import MultigridSolver

ACCURACY = 0.1  # of the reciprocal of an eigenvalue that is taken for the lowest one

_STEPS = 10
_FEWEST = 3  # steps before a body is taken for stable: an eigenvalue next to zero hides lower ones from the first two
_REPAIR = 1e4  # energy by which the constraint is satisfied, over the square of what is left of it; above 1/β² and Λ/μ
_ROUND_OFF = 1e-14  # of a quotient, relative to the norm of the matrix
_RESIDUAL = 2e-3  # of a solution that begins with a Ritz vector: the tolerance of Newton's corrections


@dataclass(frozen=True)
class Lowest:
    """The eigenvalue that the iteration found to be the lowest.

    Attributes:
        is_negative: proven; else the eigenvalue is positive by the estimate.
        error: bound of the error of the eigenvalue's reciprocal, relative to it.
        direction: displacement that belongs to it, of unit length, in the order of the unknowns of this rank.
        asymmetry: as of `Inertia`.
    """

    is_negative: bool
    error: float
    direction: Floats
    asymmetry: float


def lowest_eigenvalue(
    solver: MultigridSolver,
    supports: Supports,
    timings: Timings,
    start: Floats | None = None,
    observer: Observer = SILENT,
) -> Lowest | None:
    """Return the lowest eigenvalue of the symmetric part of a tangent; collective.

    ``None`` if it is not decided: the linear solver or the iteration did not converge.

    Args:
        solver: of the tangent, or of another matrix of the same structure.
        start: displacement to begin with, in the order of the unknowns of this rank.
        observer: asked whether to stop, before each linear solve.
    """
    search = _Search(solver, supports, observer)
    try:
        with timings("linear solve"):
            pair = search.run(start)
    finally:
        search.destroy()
    return None if pair is None else Lowest(*pair, solver.asymmetry)


class _Search:
    """Inverse iteration with Ritz vectors; all methods are collective."""

    def __init__(self, solver: MultigridSolver, supports: Supports, observer: Observer) -> None:
        self._observer = observer
        unknowns = solver.unknowns
        self._solver, self._matrix, self._comm = solver, solver.matrix, unknowns.mesh.comm
        self._u = unknowns.owned_displacement_dofs
        self._p = self._u[:0] if unknowns.p is None else unknowns.owned_pressure_dofs
        self._points = unknowns.owned_displacement_points()
        self._supports = supports
        self._b, self._x = solver.matrix.createVecRight(), solver.matrix.createVecRight()
        self._mass = solver.pressure_mass
        self._w: list[PETSc.Vec] = []  # solutions
        self._Kw: list[PETSc.Vec] = []
        self._small = np.zeros((3, _STEPS, _STEPS))  # wᵀ K w, Cᵀ Q⁻¹ C, zᵀ z

    def run(self, start: Floats | None) -> tuple[bool, float, Floats] | None:
        y = self._unit(self._irregular() if start is None else start)
        if y is None:  # nothing can move
            return False, 0.0, np.zeros(len(self._b.array))
        for step in range(_STEPS):
            stop_if_asked(self._comm, self._observer)
            if (z := self._add(y)) is None:
                return None
            mu, value, better = self._sum(y @ z), *self._lowest()
            error = self._sum((z - mu * y) @ (z - mu * y)) ** 0.5
            if value < 0:
                if self._is_proven(better):
                    return True, 0.0, better
            elif step + 1 >= _FEWEST and error <= ACCURACY * mu:
                return False, error / mu, y
            y = better
        return None

    def _add(self, y: Floats) -> Floats | None:
        """Solve for one more vector; return its displacements, ``None`` if that fails."""
        if not self._solve(y, precise=False):
            return None
        w = self._x.copy()
        Kw = w.duplicate()
        self._matrix.mult(w, Kw)
        self._w.append(w)
        self._Kw.append(Kw)
        last = len(self._w) - 1
        for i, (other, K_other) in enumerate(zip(self._w, self._Kw, strict=True)):
            a, b = np.array(Kw.array[self._p]), np.array(K_other.array[self._p])
            products = (
                dot(w, K_other),
                self._sum(a @ (b / self._mass)),
                self._sum(np.array(w.array[self._u]) @ np.array(other.array[self._u])),
            )
            self._small[:, last, i] = self._small[:, i, last] = products
        return self._displacement(w)

    def _lowest(self) -> tuple[float, Floats]:
        """Return the lowest Ritz value and its vector, of unit length."""
        n = len(self._w)
        energy, constraint, mass = self._small[:, :n, :n]
        scale = 1 / np.sqrt(np.diag(mass))
        sizes, basis = np.linalg.eigh(scale[:, None] * mass * scale)
        kept = sizes > 1e-12 * sizes[-1]
        basis = scale[:, None] * basis[:, kept] / np.sqrt(sizes[kept])
        values, vectors = np.linalg.eigh(basis.T @ (energy + constraint) @ basis)
        shares = basis @ vectors[:, 0]
        shares = self._comm.bcast(shares)  # the same on all ranks to the last digit
        value = float(self._comm.bcast(values[0]))
        self._x.set(0.0)
        self._x.maxpy(shares.tolist(), self._w)
        vector = self._displacement(self._x)
        self._x.scale(1 / value if value else 0.0)  # what the next solution would be, if the vector belonged to it
        return value, vector

    def _is_proven(self, y: Floats) -> bool:
        """Return whether the quotient of ``S⁻¹ y`` is certainly negative."""
        if not self._solve(y, precise=True):
            return False
        w, Kw = self._x, self._b
        self._matrix.mult(w, Kw)
        left = np.array(Kw.array[self._p])
        z = self._displacement(w)
        largest: Any = self._matrix.norm(PETSc.NormType.INFINITY)
        rounding = _ROUND_OFF * largest * self._sum(z @ z)
        return bool(dot(w, Kw) + _REPAIR * self._sum(left @ (left / self._mass)) < -rounding)

    def _solve(self, y: Floats, *, precise: bool) -> bool:
        self._b.array[:] = y
        # The vectors are of unit length; for the first one nothing is known.
        residual = _RESIDUAL if self._w else 0.0
        return self._solver.improve(self._b, self._x, precise=precise, residual=residual, start_from_zero=not self._w)

    def _displacement(self, w: PETSc.Vec) -> Floats:
        z = np.zeros(len(w.array))
        z[self._u] = w.array[self._u]
        return z

    def _irregular(self) -> Floats:
        """Return a smooth field without symmetries, the same on any number of ranks."""
        y, x = np.zeros(len(self._b.array)), self._points
        waves = np.array([[1.0, 2.3, 3.1], [2.9, 1.3, 1.7], [1.9, 3.7, 0.7]])
        field = sum(np.sin(k * x @ waves + np.array([0.3, 1.1, 2.2])) / k for k in (1.0, 2.7, 7.1))
        y[self._u] = np.ravel(field)
        self._supports.free(y)
        return y

    def _unit(self, y: Floats) -> Floats | None:
        size = self._sum(y @ y) ** 0.5
        return y / size if size else None

    def _sum(self, mine: Any) -> float:
        return float(self._comm.allreduce(float(mine)))

    def destroy(self) -> None:
        """Free PETSc objects."""
        for vector in (*self._w, *self._Kw, self._b, self._x):
            vector.destroy()
