"""Factors of the forward tangent at a solution, or multigrid in their place, which stability and round trip share.

Factors of the solve on up to eight ranks are taken, if they are symmetric and have the inertia of the tangent at the
end.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Protocol

from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.quantity.spatial_fields import fields_in
from hpcinv.job.job import Job
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.stability.inertia import SymmetricFactors, factorize_symmetric

SHARE = 0.5
"""Largest time of the factorization, relative to an iterative solve of the same body."""
LOW_RANK = 3e10
"""Operations of a factorization L U from which it pays to compress blocks of the rounded factors L D Lᵀ."""


class TangentSolver(Protocol):
    """What solves with the symmetric part of the forward tangent: factors, or multigrid."""

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve for ``x``; return whether that succeeded."""


class ForwardFactors:
    """Factors L D Lᵀ of the symmetric part of the forward tangent at a solution, made when they are first needed."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        self._equations, self.solution = equations, solution

    @cached_property
    def factors(self) -> SymmetricFactors | None:
        """The factors; ``None`` if they are not `affordable` or MUMPS fails; collective at the first access."""
        equations = self._equations
        if not self.affordable:
            return None
        choice = equations.chooser.choose(equations.job.solver)
        with self.tangent() as equilibrium, equations.timings("factorization"):
            kept_factors = equilibrium.linear.symmetric_factors
            return factorize_symmetric(
                equilibrium.system.matrix,
                equations.symmetric_factors() if kept_factors is None else [kept_factors],
                rounded=choice.precision == "single",
                low_rank=equations.chooser.forecast.operations >= LOW_RANK,
                minimum_fill=choice.minimum_fill,
                unknowns=equations.unknowns,
                director=equilibrium.system.director,
            )

    @cached_property
    def multigrid(self) -> Any:
        """A solver for the same matrix, where factors are not `affordable`; collective at the first access."""
        self._equations.destroy()  # matrices of other weak forms take as much memory as this one
        with self.tangent() as equilibrium, self._equations.timings("factorization"):
            return on_demand("multigrid for the certificate")(equilibrium.system.matrix, equilibrium.system.weak_form)

    @property
    def affordable(self) -> bool:
        """True if there is memory for the factors, and they take no longer than a share of an iterative solve."""
        chooser, solution = self._equations.chooser, self.solution
        if solution.linear is not None and solution.linear.configuration == "iterative":
            solve = chooser.forecast.multigrid_time(
                solution.factorizations, sum(solve_report.linear_iterations for solve_report in solution.solves)
            )
            # L D Lᵀ takes half the operations of L U.
            if chooser.forecast.factorization / 2 > SHARE * solve:
                return False
        return chooser.can_factorize_symmetric

    @contextmanager
    def tangent(self) -> Iterator[Equilibrium]:
        """Context with the forward tangent assembled; the equations have the solution's mesh and state in it."""
        equations, solution = self._equations, self.solution
        equations.put(solution.moved_to(solution.reference_nodes))
        equilibrium = equations.equilibrium(equations.weak_form("forward", given_u_of(equations)))
        equilibrium.system.linearise(1.0)
        try:
            yield equilibrium
        finally:
            equations.release(equilibrium)

    def destroy(self) -> None:
        """Free the factors; those that are needed again are made again."""
        for name in ("factors", "multigrid"):
            if (factors := self.__dict__.pop(name, None)) is not None:
                factors.destroy()


def given_u_of(equations: Equations) -> fem.Function | None:
    """Return the state's displacement if properties of the material are given on the loaded body, else ``None``.

    The forward weak form needs it, to keep them attached to the material. If they are given in another state, the
    weak forms of the equations have its displacement already.
    """
    if equations.has_attached:
        return None
    return equations.unknowns.displacement() if _seen_on_the_current_body(equations.job) else None


def _seen_on_the_current_body(job: Job) -> bool:
    """Return whether fibres, inelastic strains or parameters of the material are given on the current body."""
    effects = [effect for effect in job.effects if not effect.is_load]
    if any(family.given_on == "current" for family in job.families.values()):
        return True
    if any(effect.strain_given_on == "current" for effect in effects):
        return True
    parts = (*job.laws.values(), *job.families.values(), *effects)
    quantities = (value for part in parts for value, _ in part.quantities().values())
    return any(field.is_current for value in quantities for field in fields_in(value))
