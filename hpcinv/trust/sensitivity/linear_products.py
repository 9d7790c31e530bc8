"""Linear solves with a tangent or its transpose, by the factors that a solve has left.

The factors of Newton's last tangent precondition the tangent at the solution, which takes a few iterations of FGMRES
instead of a factorization. Multigrid is set up once at the solution. Its transpose preconditions the transposed
tangent, unless the job has PETSc options: they may choose a preconditioner without a transpose.

Source: Saad, SIAM J. Sci. Comput. 14, 461-469, 1993, doi:10.1137/0914028.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.errors import SolveError
from hpcinv.model.assembly.system import System
from hpcinv.solver.linear_solver import LinearSolver

_TOLERANCE, _MULTIGRID_TOLERANCE = 1e-13, 1e-11
"""Residual over the right-hand side at which iterations end, with factors and with multigrid, whose iterations are
dear; raised, gradients have such a relative error."""
_ENOUGH = 1e-9
"""The same above which a solve has failed, unless that is by rounding; raised, gradients of nearly singular tangents
are inaccurate."""
_ROUNDING = 10 * 2.0**-53
"""Residual over ``‖K‖ ‖x‖`` that is taken for rounding; 0.2 to 0.4 times 2⁻⁵³ remain of shells. Raised, iterations
that have not converged are accepted."""
_GROWTH = 1e13
"""``‖K‖ ‖x‖`` over the right-hand side up to which rounding is accepted. A shell that is 370 times as long as thick has
3e11, and gradients with errors of 2e-6. Raised, singular tangents are accepted, whose growth is about 1e16."""
_ITERATIONS, _MULTIGRID_ITERATIONS = 30, 300
"""Iterations after which factors of an earlier tangent are given up, and those with multigrid."""
_MULTIGRID_RESTART = 100
"""Krylov vectors with multigrid; lowered, slender bodies stagnate; raised, memory grows by two vectors for each."""


def solve(system: System, linear: LinearSolver, b: PETSc.Vec, x: PETSc.Vec, *, is_transposed: bool) -> None:
    """Solve ``K x = b`` or ``Kᵀ x = b`` with the last assembled tangent; collective.

    Raises:
        SolveError: on all ranks, if the tangent is singular.
    """
    size = norm(b)
    if size == 0.0:
        x.set(0.0)
        return
    for renews in (False, True) if linear.has_factors else (True,):
        if renews and linear.has_factors:
            linear.factorize()
        elif renews:
            linear.factorize_if_needed()  # multigrid of this tangent may be left
        residual, growth = _solved(system, linear, b, x, is_transposed)
        if residual <= _ENOUGH * size or (growth <= _GROWTH and residual <= _ROUNDING * growth * size):
            return
    raise SolveError(
        "the tangent at the solution is singular or nearly so, so that there are no derivatives there",
        "Take a load at which the solution is not at a limit point.",
    )


def _krylov_method(operator: PETSc.Mat, linear: LinearSolver, is_transposed: bool) -> PETSc.KSP:
    """Return FGMRES for the tangent or its transpose, with the factors or the multigrid that a solve has left."""
    if linear.configuration.name == "direct":
        tolerance, most, restart = _TOLERANCE, _ITERATIONS, _ITERATIONS
    else:
        tolerance, most, restart = _MULTIGRID_TOLERANCE, _MULTIGRID_ITERATIONS, _MULTIGRID_RESTART
    ksp = PETSc.KSP().create(operator.comm)
    ksp.setType(PETSc.KSP.Type.FGMRES)
    ksp.setOperators(operator)
    ksp.setTolerances(rtol=tolerance, atol=0.0, max_it=most)
    ksp.setGMRESRestart(restart)
    ksp.pc.setType(PETSc.PC.Type.PYTHON)
    ksp.pc.setPythonContext(_Factors(linear.ksp.pc, is_transposed=is_transposed and linear.has_transpose))
    return ksp


def _solved(
    system: System, linear: LinearSolver, b: PETSc.Vec, x: PETSc.Vec, is_transposed: bool
) -> tuple[float, float]:
    """Set ``x`` to a solution; return the norm of its residual, and ``‖K‖ ‖x‖`` over the right-hand side."""
    matrix, director = system.matrix, system.director
    operator = PETSc.Mat().createTranspose(matrix) if is_transposed else matrix
    ksp = _krylov_method(operator, linear, is_transposed)
    given, r = b.copy(), b.duplicate()
    if director is not None:
        (director.enter_transposed if is_transposed else director.enter)(given)
    with linear.options.blamed():
        ksp.solve(given, x)
    operator.mult(x, r)
    r.axpy(-1.0, given)
    residual = norm(r) * (norm(b) / (norm(given) or 1.0))
    size: Any = matrix.norm(PETSc.NormType.FROBENIUS)  # its hints allow a pair, too
    growth = float(size) * norm(x) / (norm(given) or 1.0)
    if director is not None:
        (director.leave_transposed if is_transposed else director.to_nodes)(x)
    for part in (ksp, given, r, *([operator] if is_transposed else [])):
        part.destroy()
    return residual if residual == residual else float("inf"), growth  # NaN of failed factors


class _Factors:
    """Preconditioner of PETSc by the factors of another solver, or their transpose."""

    def __init__(self, pc: PETSc.PC, *, is_transposed: bool) -> None:
        self._pc, self._is_transposed = pc, is_transposed

    def apply(self, _: Any, x: PETSc.Vec, y: PETSc.Vec) -> None:
        if self._is_transposed:
            self._pc.applyTranspose(x, y)
        else:
            self._pc.apply(x, y)
