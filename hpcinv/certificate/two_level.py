"""Correction of a solution in spaces of one degree more, without a matrix or a factorization there.

The linear system ``K δ = -R(u_h)`` of these spaces is solved by FGMRES to the accuracy that an estimate needs. K is
applied by differences of the residual. The preconditioner has two levels: some iterations of GMRES with a diagonal
take care of what the finer spaces add, and the factors of the solve, or its multigrid, of what the spaces of the
solution can represent. The number of iterations hardly depends on the number of unknowns.

Source: Elman, Silvester & Wathen, *Finite Elements and Fast Iterative Solvers* (2014), ch. 2 and 4,
doi:10.1093/acprof:oso/9780199678792.001.0001.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.certificate.stiffness_diagonal import stiffness_diagonal
from hpcinv.effects import Direction
from hpcinv.mesh.refine.finer_geometry import on_mesh
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.jit import JIT_OPTIONS
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.results.solution import Solution
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.problem import Model

MANY = 1e11
"""Operations of a factorization in the finer spaces from which iterations take less time."""
_SMOOTHING = 16  # iterations of GMRES on the finer level
_ITERATIONS = 10
_ACCURACY = 0.1  # of the residual, and of the change of the displacement in one iteration, both relative
_SOLVED = 1e-3  # relative residual at which the correction is found in any case
_INCREMENT = 1e-7  # length of the difference by which the residual is differentiated, in scaled unknowns


def correct(model: Model, solution: Solution, finer: Model) -> bool:
    """Add the correction to the state of ``finer``, the solution in finer spaces; return whether it converged.

    Collective. The mesh of ``finer`` must lie where the solution was computed.

    Args:
        model: model of the solution, with the factors of its last tangent.
        finer: model in spaces of one degree more, on the same cells, perhaps with a finer geometry. The tangent of the
            spaces of the solution is then factorized on that geometry.
    """
    body, direction = finer.body, solution.direction
    given = model if body is model.body else Model(model.job, body, model.timings)
    if given is not model:
        contacts = given.scene(direction).contacts
        contacts.restore(solution.contacts, given.scales, partial(on_mesh, body.mesh))
    u, p = (None if f is None else on_mesh(body.mesh, f) for f in solution.fields)
    assert u is not None
    with given.at(body.mesh.geometry.x * body.length_scale, u, p):
        equilibrium = given.equilibrium(
            given.scene(direction, quadrature=None if given is model else finer.quadrature_degree)
        )
        if equilibrium.system.tangents == 0:
            equilibrium.system.linearise(1.0)
        equilibrium.linear.factorize(may_keep=True)
        with finer.timings("linear solve"):
            coarse = _Coarse(given, finer.unknowns, equilibrium.linear)
            converged = _FinerProblem(finer, direction, coarse).solve()
            coarse.destroy()
        given.release(equilibrium)
    if given is not model:
        given.destroy()
    return converged


class _Coarse:
    """Solution in the spaces of the solution, of residuals in the finer ones."""

    def __init__(self, given: Model, finer: Unknowns, linear: LinearSolver) -> None:
        self._given, self._finer, self._linear = given.unknowns, finer, linear
        self._conditions = given.supports.conditions
        pairs = [(self._given.displacement_space, finer.displacement_space)]
        if finer.p is not None:
            pairs.append((self._given.pressure_space, finer.pressure_space))
        self._interpolations = [fem_petsc.interpolation_matrix(*pair) for pair in pairs]
        for one in self._interpolations:
            one.assemble()
        self._b, self._x = (fem_petsc.create_vector(self._given.space) for _ in range(2))

    def apply(self, residual: PETSc.Vec, correction: PETSc.Vec) -> None:
        """Set ``correction`` to the solution for a residual."""
        parts = [one.createVecRight() for one in self._interpolations]
        for interpolation, of_finer, part in zip(
            self._interpolations, _split(self._finer, residual), parts, strict=True
        ):
            interpolation.multTranspose(of_finer.x.petsc_vec, part)
        _join(self._given, parts, self._b)
        fem_petsc.set_bc(self._b, self._conditions, alpha=0.0)
        self._linear.limit_iterations()
        self._linear.back_substitute(self._b, self._x)
        found = [one.createVecLeft() for one in self._interpolations]
        for interpolation, of_given, part in zip(
            self._interpolations, _split(self._given, self._x), found, strict=True
        ):
            interpolation.mult(of_given.x.petsc_vec, part)
        _join(self._finer, found, correction)
        for vector in (*parts, *found):
            vector.destroy()

    def destroy(self) -> None:
        """Free PETSc objects."""
        for one in (*self._interpolations, self._b, self._x):
            one.destroy()


class _FinerProblem:
    """``K δ = -R`` of the finer problem, at the present state of its model."""

    def __init__(self, finer: Model, direction: Direction, coarse: _Coarse) -> None:
        self._coarse = coarse
        self._unknowns, self._conditions = finer.unknowns, finer.supports.conditions
        scene, state = finer.scene(direction), finer.unknowns.state.x
        scene.parameters.set_load(1.0)
        finer.supports.scale(1.0)
        for condition in self._conditions:
            condition.set(state.array)
        state.scatter_forward()
        with finer.timings("compile"):
            self._form = fem.form(scene.residual, jit_options=JIT_OPTIONS)
        self._at: Floats = state.array.copy()
        self._residual = fem_petsc.create_vector(self._unknowns.space)
        self._assemble(self._residual)
        self._diagonal, stiffness = self._residual.duplicate(), stiffness_diagonal(scene)
        _join(self._unknowns, [stiffness.x.petsc_vec], self._diagonal)
        if self._unknowns.p is not None:
            configuration = Iterative(scene)
            self._diagonal.array[self._unknowns.owned_pressure_dofs] = -configuration.pressure_scale()
            configuration.destroy()
        self._start, self._last = 0.0, fem_petsc.create_vector(self._unknowns.displacement_space)

    def solve(self) -> bool:
        """Add the solution to the state, if the iterations converge; return whether they did."""
        sizes, comm = self._residual.getSizes(), self._residual.comm
        matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=comm)
        self._smoother = _krylov(PETSc.KSP.Type.GMRES, matrix, self._divide, 1e-3, _SMOOTHING)
        ksp = _krylov(PETSc.KSP.Type.FGMRES, matrix, self._precondition, _SOLVED, _ITERATIONS)
        ksp.setConvergenceTest(self._test_convergence)
        x = self._residual.duplicate()
        ksp.solve(self._residual, x)
        reason: Any = ksp.getConvergedReason()  # an int, whatever its stub says
        converged = reason > 0 and bool(np.isfinite(norm(x)))
        state = self._unknowns.state.x
        state.array[:] = self._at
        if converged:
            state.petsc_vec.axpy(-1.0, x)
            state.scatter_forward()
        for one in (x, ksp, self._smoother, matrix, self._residual, self._diagonal, self._last):
            one.destroy()
        return converged

    def mult(self, _matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply by K, for PETSc."""
        self._apply(x, y)

    def _apply(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set ``y`` to ``K x``."""
        length, state = norm(x), self._unknowns.state.x
        if length == 0.0:
            y.set(0.0)
            return
        share = _INCREMENT / length
        state.array[:] = self._at
        state.petsc_vec.axpy(share, x)
        state.scatter_forward()
        self._assemble(y)
        y.axpby(-1.0 / share, 1.0 / share, self._residual)

    def _test_convergence(self, ksp: PETSc.KSP, iteration: int, residual: float) -> Any:  # an int for PETSc
        """Convergence test of PETSc: a small residual alone does not tell that soft motions are right."""
        reasons, x = PETSc.KSP.ConvergedReason, self._residual.duplicate()
        ksp.buildSolution(x)
        displacement, *_ = _split(self._unknowns, x)
        if iteration == 0:
            self._start = residual
        u = displacement.x.petsc_vec  # its memory belongs to the function
        self._last.aypx(-1.0, u)
        settled = norm(self._last) <= _ACCURACY * norm(u)
        u.copy(self._last)
        x.destroy()
        if not np.isfinite(residual):
            return reasons.DIVERGED_NANORINF
        if residual <= _SOLVED * self._start or (settled and residual <= _ACCURACY * self._start):
            return reasons.CONVERGED_RTOL
        return reasons.DIVERGED_MAX_IT if iteration >= _ITERATIONS else reasons.CONVERGED_ITERATING

    def _assemble(self, b: PETSc.Vec) -> None:
        """Assemble the residual at the state into ``b``, zero at prescribed displacements."""
        vector = fem_petsc.assemble_vector(self._form)
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(vector, self._conditions, alpha=0.0)
        vector.copy(b)
        vector.destroy()

    def _divide(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        x.pointwiseDivide(b, self._diagonal)

    def _precondition(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        self._smoother.solve(b, x)
        left, more = b.duplicate(), b.duplicate()
        self._apply(x, left)
        left.aypx(-1.0, b)
        self._coarse.apply(left, more)
        x.axpy(1.0, more)
        left.destroy()
        more.destroy()


class _Preconditioner:
    """A function as a preconditioner of PETSc."""

    def __init__(self, function: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self._function = function

    def apply(self, _pc: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        self._function(b, x)


def _krylov(
    kind: str, matrix: PETSc.Mat, preconditioner: Callable[[PETSc.Vec, PETSc.Vec], None], accuracy: float, limit: int
) -> PETSc.KSP:
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setType(kind)
    ksp.setOperators(matrix)
    ksp.setTolerances(rtol=accuracy, max_it=limit)
    ksp.pc.setType(PETSc.PC.Type.PYTHON)
    ksp.pc.setPythonContext(_Preconditioner(preconditioner))
    return ksp


def _split(unknowns: Unknowns, x: PETSc.Vec) -> list[fem.Function]:
    """Return displacement and pressure of a vector of all unknowns."""
    state = unknowns.state.x
    kept = state.array.copy()
    x.copy(state.petsc_vec)
    state.scatter_forward()
    parts = [unknowns.displacement(), unknowns.pressure()]
    state.array[:] = kept
    return [part for part in parts if part is not None]


def _join(unknowns: Unknowns, parts: list[PETSc.Vec], x: PETSc.Vec) -> None:
    """Set a vector of all unknowns to displacement and pressure; the latter may be left out."""
    state = unknowns.state.x
    kept = state.array.copy()
    spaces = [unknowns.displacement_space, *([] if unknowns.p is None else [unknowns.pressure_space])]
    setters = (unknowns.set_displacement, unknowns.set_pressure)
    for space, part, take in zip(spaces, parts, setters, strict=False):
        function = fem.Function(space)
        part.copy(function.x.petsc_vec)
        function.x.scatter_forward()
        take(function)
    state.petsc_vec.copy(x)
    state.array[:] = kept
