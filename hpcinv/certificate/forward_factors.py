"""Factors of the forward tangent at a solution, which stability and round trip share."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from hpcinv.certificate.confirmation import known_displacement
from hpcinv.certificate.inertia import SymmetricFactors, factorize_symmetric

if TYPE_CHECKING:
    from hpcinv.results.solution import Solution
    from hpcinv.solver.problem import Model


class ForwardFactors:
    """Factors L D Lᵀ of the symmetric part of the forward tangent at a solution, made when they are first needed."""

    def __init__(self, model: Model, solution: Solution) -> None:
        self._model, self._solution = model, solution

    @cached_property
    def factors(self) -> SymmetricFactors | None:
        """The factors; ``None`` if there is no memory for them or MUMPS fails; collective at the first access."""
        model, solution = self._model, self._solution
        if not model.chooser.can_factorize_symmetric:
            return None
        with model.at(solution.reference_nodes, *solution.fields):
            equilibrium = model.equilibrium(model.scene("forward", known_displacement(model)))
            equilibrium.system.linearise(1.0)
            with model.timings("factorization"):
                found = factorize_symmetric(equilibrium.system.matrix)
            model.release(equilibrium)
        return found

    def destroy(self) -> None:
        """Free the factors."""
        if (found := self.__dict__.pop("factors", None)) is not None:
            found.destroy()
