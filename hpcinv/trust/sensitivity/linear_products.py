"""Linear solves with a tangent or its transpose, by the factors that a solve has left.

The factors of Newton's last tangent precondition the tangent at the solution, which takes a few iterations of FGMRES
instead of a factorization. So does multigrid, if its memory was not freed. Its transpose preconditions the transposed
tangent, unless the job has PETSc options: they may choose a preconditioner without a transpose.

Multigrid for displacements alone is linear, so that GMRES can be preconditioned from the left. Its residual then
measures the error of the solution. By the residual of the tangent, a block took 52 iterations instead of 30.

Source: Saad, SIAM J. Sci. Comput. 14, 461-469, 1993, doi:10.1137/0914028.
"""

from __future__ import annotations

from typing import Any, cast

from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.errors import SolveError
from hpcinv.model.assembly.system import System
from hpcinv.solver.linear_solver import LinearSolver

_TOLERANCE, _MULTIGRID_TOLERANCE, _ERROR = 1e-13, 1e-11, 1e-9
"""Residual over the right-hand side at which iterations end, with factors and with multigrid, whose iterations are
dear, and preconditioned residual with linear multigrid, which leaves gradients by cell with errors of 3e-8 of the
largest; raised, these errors grow in proportion."""
_ENOUGH = 1e-9
"""Residual over the right-hand side above which a solve has failed, unless rounding explains it; raised, gradients of
nearly singular tangents are inaccurate."""
_ROUNDING = 10 * 2.0**-53
"""Residual over ``‖K‖ ‖x‖`` that is taken for rounding; shells leave 0.2 to 0.4 times 2⁻⁵³. Raised, iterations that
have not converged are accepted."""
_GROWTH = 1e13
"""``‖K‖ ‖x‖`` over the right-hand side up to which rounding is accepted. A shell that is 370 times as long as thick has
3e11, and gradients with errors of 2e-6. Raised, singular tangents are accepted, whose growth is about 1e16."""
_ITERATIONS, _MULTIGRID_ITERATIONS = 30, 300
"""Iterations after which factors of an earlier tangent are given up, and those with multigrid."""
_MULTIGRID_RESTART = 100
"""Krylov vectors with multigrid, and iterations after which an earlier tangent's is set up anew; lowered, slender
bodies stagnate; raised, memory grows by two vectors for each."""


def solve(system: System, linear: LinearSolver, b: PETSc.Vec, x: PETSc.Vec, *, is_transposed: bool) -> None:
    """Solve ``K x = b`` or ``Kᵀ x = b`` with the last assembled tangent; collective.

    Raises:
        SolveError: on all ranks, if the tangent is singular.
    """
    size = norm(b)
    if size == 0.0:
        x.set(0.0)
        return
    for renews in (False, True) if linear.has_set_up else (True,):
        if renews and linear.has_set_up:
            linear.factorize()
        elif renews:
            linear.factorize_if_needed()
        if _solves(system, linear, b, x, is_transposed=is_transposed, is_earlier=not renews):
            return
    raise SolveError(
        "the tangent at the solution is singular or nearly so, so that there are no derivatives there",
        "Take a load at which the solution is not at a limit point.",
    )


def _solves(
    system: System, linear: LinearSolver, b: PETSc.Vec, x: PETSc.Vec, *, is_transposed: bool, is_earlier: bool
) -> bool:
    """Set ``x`` to a solution with the present set-up; return whether it is accurate.

    Args:
        is_earlier: whether the set-up may be of an earlier tangent, and a new one is made if it fails.
    """
    matrix, director = system.matrix, system.director
    operator = PETSc.Mat().createTranspose(matrix) if is_transposed else matrix
    given, r = b.copy(), b.duplicate()
    if director is not None:
        (director.enter_transposed if is_transposed else director.enter)(given)
    ksp = _krylov(linear, operator, is_earlier=is_earlier)
    ksp.pc.setType(PETSc.PC.Type.PYTHON)
    ksp.pc.setPythonContext(_Factors(linear.ksp.pc, is_transposed=is_transposed and linear.has_transpose))
    with linear.options.blamed():
        ksp.solve(given, x)
    operator.mult(x, r)
    r.axpy(-1.0, given)
    residual, size, frobenius = norm(r), norm(given), cast(float, matrix.norm(PETSc.NormType.FROBENIUS))
    is_accurate = _is_accurate(ksp, residual, size, frobenius * norm(x) / (size or 1.0))
    if director is not None:
        (director.leave_transposed if is_transposed else director.to_nodes)(x)
    for part in (ksp, given, r, *([operator] if is_transposed else [])):
        part.destroy()
    return is_accurate


def _is_accurate(ksp: PETSc.KSP, residual: float, size: float, growth: float) -> bool:
    """Return whether a solution is accurate, by its residual, the right-hand side, and ``‖K‖ ‖x‖`` over that.

    NaN, which failed factors give, is not.
    """
    if residual <= _ENOUGH * size:
        return True
    if ksp.getType() == PETSc.KSP.Type.GMRES:
        return growth <= _GROWTH and cast(int, ksp.getConvergedReason()) > 0
    return growth <= _GROWTH and residual <= _ROUNDING * growth * size


def _krylov(linear: LinearSolver, operator: PETSc.Mat, *, is_earlier: bool) -> PETSc.KSP:
    """Return Krylov iterations for an operator, without their preconditioner."""
    ksp = PETSc.KSP().create(operator.comm)
    ksp.setOperators(operator)
    ksp.setType(PETSc.KSP.Type.FGMRES)
    if linear.configuration.name == "direct":
        ksp.setTolerances(rtol=_TOLERANCE, atol=0.0, max_it=_ITERATIONS)
        ksp.setGMRESRestart(_ITERATIONS)
        return ksp
    tolerance = _MULTIGRID_TOLERANCE
    if linear.has_linear_preconditioner:
        ksp.setType(PETSc.KSP.Type.GMRES)
        left: Any = PETSc.PC.Side.LEFT  # an int, whatever its stub says
        ksp.setPCSide(left)
        tolerance = _ERROR
    limit = _MULTIGRID_RESTART if is_earlier else _MULTIGRID_ITERATIONS
    ksp.setTolerances(rtol=tolerance, atol=0.0, max_it=limit)
    ksp.setGMRESRestart(_MULTIGRID_RESTART)
    return ksp


class _Factors:
    """Preconditioner of PETSc by the factors of another solver, or their transpose."""

    def __init__(self, pc: PETSc.PC, *, is_transposed: bool) -> None:
        self._pc, self._is_transposed = pc, is_transposed

    def apply(self, _: Any, x: PETSc.Vec, y: PETSc.Vec) -> None:
        if self._is_transposed:
            self._pc.applyTranspose(x, y)
        else:
            self._pc.apply(x, y)
