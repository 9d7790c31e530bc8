"""Correction of a solution in spaces of one degree more, without a matrix or a factorization there.

The linear system ``K δ = -R(u_h)`` of these spaces is solved to the accuracy that an estimate needs. K is applied by
its moduli (`hpcinv.model.assembly.tangent_product`), which are those at the solution, on the geometry of its mesh: a
finer one changes K as little as the shape of cells. The contributions of surface integrals, and of residuals that have
no moduli, are differences of the residual between two states. The preconditioner changes between two levels: in most
iterations it is a diagonal, for what the finer spaces add, and then the factors of the solve, or its multigrid, for
what the spaces of the solution can represent. GCR finds the combination of all directions so far with the least
residual, whatever the preconditioner of each was, in the norm of the inverse diagonal: as errors in energy, residuals
of displacements and pressures then compare on all meshes. A last correction by the factors does not have to be
multiplied by K. The number of iterations hardly depends on the number of unknowns.

The residual of the corrected state is of second order in the correction, as are errors of quantities that converge
with twice the degree. A second correction, by the factors of the solve alone, adds what the first one leaves of them.

Source: Eisenstat, Elman & Schultz, SIAM J. Numer. Anal. 20, 345–357 (1983), doi:10.1137/0720023; Elman, Silvester &
Wathen, *Finite Elements and Fast Iterative Solvers* (2014), ch. 2 and 4, doi:10.1093/acprof:oso/9780199678792.001.0001.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Singles
from hpcinv.mesh.cells import kind_and_degree, quadrature, scalar_element
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.csr_tangent import surface_tangent
from hpcinv.model.assembly.moduli_at_points import ModuliAtPoints, moduli_at_points, moduli_of_two_rules
from hpcinv.model.assembly.tangent import cells_of
from hpcinv.model.assembly.tangent_moduli import UnsupportedForm
from hpcinv.model.assembly.tangent_product import TangentProduct
from hpcinv.model.spaces import Unknowns
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import CONTRACTING
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.observer import SILENT, Observer, freeing, stop_if_asked
from hpcinv.trust.discretisation.tangent_scale import diagonals_of_cells, tangent_scale
from hpcinv.trust.discretisation.transfer import Transfer

MANY = 5e9
"""Operations of a factorization in the finer spaces from which iterations are worth their error: it takes seconds."""
_SMOOTHING = 8  # iterations with the diagonal before one with the factors
_CYCLES = 10  # of these
_RESIDUAL = 0.15  # relative; the correction is looked for below it
_CHANGE = 0.3  # of the displacement in one cycle, relative; its error is then at most half of that, mostly a third
_STIFFEST = 4.0  # ratio of stiffnesses up to which corrections are right to a fifth
_SAMPLE = 500  # cells of each rank by which it is found
_STRAIGHT = 0.03  # offset of a node, relative to its cell, up to which moduli are extended: corrections change by 0.004
_FEW = 20_000  # points of a mesh (10 µs each) up to which one kernel for both rules takes less time than two
_INCREMENT = 1e-7  # length of the difference by which the residual is differentiated, in scaled unknowns


def correct(equations: Equations, direction: Direction, finer: Equations, observer: Observer = SILENT) -> bool:
    """Add the correction to the state of ``finer``, the solution in finer spaces; return whether it converged.

    Iterations are not made where the body is much stiffer than by its shear modulus, as against stiff fibres, or
    changes of volume in the displacement form: they would end long before they have found the correction, since the
    diagonal does not separate soft motions from stiff ones there. Collective.

    Args:
        equations: in the state of the solution, with the factors of its last tangent.
        finer: in the same state, in spaces of one degree more, on the same cells, perhaps with a finer geometry. That
            changes the tangent by as little as the shape of cells: the factors still serve as a preconditioner.
        observer: asked whether to stop, in each iteration.
    """
    equilibrium = equations.equilibrium(equations.weak_form(direction))
    equilibrium.system.set_load(1.0)
    if equilibrium.system.tangents == 0:
        equilibrium.system.tangent()
    equilibrium.linear.factorize_if_needed()
    if equilibrium.linear.configuration.name == "iterative":
        equilibrium.linear.free_krylov_vectors()
    product = _volume_product(equations, finer, direction)
    with freeing(lambda: equations.release(equilibrium), equations.free_multigrid), finer.timings("linear solve"):
        coarse = _Coarse(equations, finer.unknowns, equilibrium.linear)
        with freeing(coarse.destroy):
            return _FinerProblem(finer, direction, coarse, product).solve(observer)


def _volume_product(equations: Equations, finer: Equations, direction: Direction) -> TangentProduct | None:
    """Return the product by the moduli at the solution, ``None`` if the residual has none; collective."""
    if equations.supports.is_curved:  # the planes of reactions turn with the state
        return None
    residual, coarse, degree = equations.weak_form(direction).residual, equations.unknowns, finer.quadrature_degree
    try:
        with finer.timings("programs"):
            # In strongly curved cells the moduli vary too much to be extended from the points of the solve.
            curved = _curved_cells(coarse.mesh)
            if coarse.mesh.comm.allreduce(bool(curved.any()), op=MPI.LOR):
                moduli, all_moduli = _moduli_of_both(residual, coarse, equations.quadrature_degree, degree)
                moduli = [*_moduli_of_cells(moduli, ~curved), *_moduli_of_cells(all_moduli, curved)]
            else:
                moduli = moduli_at_points(residual, coarse)
    except UnsupportedForm:
        return None
    with finer.timings("tangent"):
        return TangentProduct(moduli, coarse, finer.unknowns, degree)


def _moduli_of_both(
    residual: Any, unknowns: Unknowns, degree: int, finer_degree: int
) -> tuple[list[ModuliAtPoints], list[ModuliAtPoints]]:
    """Return the moduli at the points of the solve and of the finer spaces, by one kernel on a small mesh."""
    kind = unknowns.mesh.basix_cell().name
    points = sum(len(quadrature(kind, rule_degree)[1]) for rule_degree in (degree, finer_degree))
    if cells_of(unknowns.mesh) * points <= _FEW:
        return moduli_of_two_rules(residual, unknowns, finer_degree)
    return (
        moduli_at_points(residual, unknowns),
        moduli_at_points(residual, unknowns, finer_degree),
    )


def _curved_cells(mesh: Mesh) -> npt.NDArray[np.bool_]:
    """Return for each owned cell whether its nodes are far off their places in the straight cell."""
    kind, degree = kind_and_degree(mesh)
    nodes = mesh.geometry.x[mesh.geometry.dofmaps[0][: mesh.topology.index_map(3).size_local]]
    shapes = scalar_element(kind, 1).tabulate(0, scalar_element(kind, degree).points)[0, :, :, 0]
    offsets = np.abs(nodes - shapes @ nodes[:, : shapes.shape[1]])
    return np.asarray(offsets.max(axis=(1, 2)) > _STRAIGHT * np.ptp(nodes, axis=1).max(axis=1))


def _moduli_of_cells(moduli: Sequence[ModuliAtPoints], chosen: npt.NDArray[np.bool_]) -> Iterator[ModuliAtPoints]:
    """Yield the moduli of those cells that are among the owned cells ``chosen``."""
    for entry in moduli:
        cells = np.arange(len(chosen), dtype=np.int32) if entry.cells is None else entry.cells
        yield replace(entry, cells=cells[chosen[cells]])


class _Coarse:
    """Solution in the spaces of the solution, of residuals in the finer ones."""

    def __init__(self, equations: Equations, finer: Unknowns, linear: LinearSolver) -> None:
        self._linear, self._supports = linear, equations.supports
        self._transfer = Transfer(equations.unknowns, finer)
        self._b, self._x = (fem_petsc.create_vector(equations.unknowns.space) for _ in range(2))
        linear.configuration.set_rough(rough=True)

    def solve(self, residual: Singles) -> Singles:
        """Return the solution for a residual, both at the owned unknowns of the finer spaces."""
        self._b.array[:] = self._transfer.restrict(residual)
        self._supports.free(self._b.array)
        self._linear.limit_iterations()
        self._linear.back_substitute(self._b, self._x)
        return self._transfer.interpolate(self._x.array).astype(np.float32)

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._linear.configuration.set_rough(rough=False)
        self._b.destroy()
        self._x.destroy()


class _FinerProblem:
    """``K δ = -R`` of the finer problem, at the present state of its equations."""

    def __init__(
        self, finer: Equations, direction: Direction, coarse: _Coarse, volume_product: TangentProduct | None
    ) -> None:
        self._coarse, self._comm, self._volume_product = coarse, finer.body.mesh.comm, volume_product
        self._unknowns, self._supports = finer.unknowns, finer.supports
        weak_form, state = finer.weak_form(direction), finer.unknowns.state.x
        self._put = finer.put_unknowns
        finer.impose_supports(direction)
        with finer.timings("programs"):
            self._form = fem.form(weak_form.residual)
            self._differentiated = self._form if volume_product is None else _surface_form(weak_form)
        self._origin: Floats = state.array.copy()
        self._b = fem_petsc.create_vector(self._unknowns.space)
        self._residual = self._assemble(self._form)
        self._undisturbed = self._residual if self._differentiated is None else self._assemble(self._differentiated)
        diagonals = diagonals_of_cells(weak_form)
        self._scale = tangent_scale(self._unknowns, diagonals).astype(np.float32)
        self._stiffness = diagonals[0].sum(axis=1)
        self._signs = np.ones_like(self._scale)
        if self._unknowns.p is not None:
            self._signs[self._unknowns.owned_pressure_dofs] = -1.0

    def solve(self, observer: Observer) -> bool:
        """Add the solution to the state, if the iterations converge; return whether they did."""
        x = self._solution(observer)
        self._put(self._origin)
        if x is not None:
            self._subtract(x)
            second = self._coarse.solve(self._assemble(self._form).astype(np.float32))
            self._supports.free(second, displacements=True)
            if self._length(second) < CONTRACTING * self._length(x):  # not if it is not a number
                self._subtract(second)
        self._b.destroy()
        return x is not None

    def _subtract(self, x: Singles) -> None:
        """Subtract owned unknowns from the state; collective."""
        self._put(self._unknowns.state.x.array[: len(x)] - x)

    def _is_too_stiff(self) -> bool:
        """Return whether a tenth of the cells is much stiffer than by the shear modulus of the undeformed material."""
        if self._volume_product is None:
            return False
        cells, stiffness = self._volume_product.stiffness(_SAMPLE)
        ratios = np.concatenate(self._comm.allgather(stiffness / self._stiffness[cells]))
        # A ratio that is not a number does not count: the iterations find out.
        return bool(np.count_nonzero(ratios > _STIFFEST) > 0.1 * len(ratios))

    def _solution(self, observer: Observer) -> Singles | None:
        """Return ``K⁻¹ R`` at the owned unknowns; ``None`` if iterations do not find it."""
        if self._is_too_stiff():
            return None
        r = self._scale * self._residual.astype(np.float32)  # which is enough for an estimate
        last, start = np.zeros_like(r), self._length(r)
        if start == 0.0:
            return last
        u, count = self._unknowns.owned_displacement_dofs, _CYCLES * (_SMOOTHING + 1)
        # The products are orthonormal; products of K and the directions are their combinations, columns of `triangle`.
        # Directions by the diagonal are not kept, since residuals are combinations of the first one and the products.
        first, corrections, products = r.copy(), list[Singles](), np.empty((count, len(r)), r.dtype)
        triangle, shares = np.zeros((count, count)), np.zeros(count)
        for k in range(count):
            stop_if_asked(self._comm, observer)
            is_smoothing = k % (_SMOOTHING + 1) < _SMOOTHING
            direction = self._smoothed(r) if is_smoothing else self._coarse.solve(r / self._scale)
            if not is_smoothing:
                self._supports.free(direction, displacements=True)
                weights = np.linalg.solve(triangle[:k, :k], shares[:k])
                by_diagonal = np.where(np.arange(k) % (_SMOOTHING + 1) < _SMOOTHING, weights, 0.0)
                later = by_diagonal.sum() - np.cumsum(by_diagonal)  # weights of the residuals after each product
                residuals = r.dtype.type(by_diagonal.sum()) * first
                residuals -= (shares[:k] * later).astype(r.dtype) @ products[:k]
                solution, residual = direction + self._smoothed(residuals), self._length(r)
                for weight, correction in zip(weights[_SMOOTHING :: _SMOOTHING + 1], corrections, strict=True):
                    solution += r.dtype.type(weight) * correction
                corrections.append(direction)
                change, size = self._length((solution - last)[u]), self._length(solution[u])
                if not np.isfinite(size + residual):
                    return None
                if residual <= _RESIDUAL * start and change <= _CHANGE * size:
                    return solution
                last = solution
            product = self._scale * self._times(direction)
            parts = self._sum(products[:k] @ product)
            product -= parts @ products[:k]
            if not (length := self._length(product)) > 0.0:  # also if it is not a number
                return None
            products[k] = product / length
            triangle[:k, k], triangle[k, k] = parts, length
            shares[k] = share = self._sum(products[k] @ r)
            r -= share * products[k]
        return None

    def _smoothed(self, residual: Singles) -> Singles:
        """Return the direction by the diagonal for a scaled residual; linear in it."""
        direction = self._scale * self._signs * residual
        self._supports.free(direction, displacements=True)  # the scale mixes directions along a slide and across it
        return direction

    def _times(self, x: Singles) -> Singles:
        """Return ``K x``."""
        product = np.zeros_like(x) if self._volume_product is None else self._volume_product(x)
        if self._differentiated is not None:
            share = _INCREMENT / self._length(x)
            self._put(self._origin[: len(x)] + share * x)
            product += ((self._assemble(self._differentiated) - self._undisturbed) / share).astype(np.float32)
        self._supports.free(product)
        return product

    def _assemble(self, form: fem.Form) -> Floats:
        """Return a residual at the state, zero at prescribed displacements."""
        with self._b.localForm() as local:
            local.set(0.0)
        fem_petsc.assemble_vector(self._b, form)
        self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self._supports.free(self._b.array)
        return np.array(self._b.array)

    def _sum(self, a: Any) -> Any:
        return self._comm.allreduce(a, op=MPI.SUM)

    def _length(self, a: Singles) -> float:
        return math.sqrt(self._sum(float(a @ a)))


def _surface_form(weak_form: WeakForm) -> fem.Form | None:
    """Return the surface integrals of a residual, ``None`` if they do not depend on the unknowns; collective."""
    if surface_tangent(weak_form.residual, weak_form.unknowns.state) is None:
        return None
    surface = [integral for integral in weak_form.residual.integrals() if integral.integral_type() != "cell"]
    return fem.form(ufl.Form(surface))
