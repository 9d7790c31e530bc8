"""The finer problem by which the discretisation error of a solution is estimated: one class for each kind of body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh.source import Floats
from hpcinv.model.state import State
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import Forecast
from hpcinv.solver.newton import NewtonIteration
from hpcinv.solver.observer import IterationObserver, Observer, SolveEvent
from hpcinv.trust.discretisation.estimate import Correction, LayerError

SHARE = 0.5
"""Largest forecast time of the finer solve, relative to the solve; larger decides more lines."""
LEAST = 1.0
"""Seconds that the finer solve may take in any case, since starting a run takes longer."""
_OVERHEAD = 0.02  # seconds of an iteration in a body of few unknowns


@dataclass(frozen=True)
class Found:
    """What the finer problem gave; displacements in m.

    Attributes:
        displacement: displacement of the finer problem.
        nodal: the same at the geometry nodes of the given equations' body, (n, 3).
        moved: correction of these nodes, (n, 3).
        largest: length of the largest correction, infinite if one is not finite.
        is_solved, is_too_dear, tangents: as in `Estimate`.
    """

    displacement: fem.Function
    nodal: Floats
    moved: Floats
    largest: float
    is_solved: bool = False
    is_too_dear: bool = False
    tangents: int = 1


class FinerProblem(ABC):
    """The finer problem of a solution; methods are collective.

    Args:
        given: equations of the solution.
        rest_correction: correction of the rest shape from which a further state is solved.

    Attributes:
        where: where the finer problem is solved, as text for a note.
    """

    where: ClassVar[str]

    def __init__(self, given: Equations, solution: Solution, rest_correction: Correction | None = None) -> None:
        self.given, self.solution, self.rest_correction = given, solution, rest_correction

    @cached_property
    def equations(self) -> Equations:
        """Equations of the finer problem, made at the first use.

        Their state is the solution on the mesh on which it was computed, or, with the correction of the rest shape, on
        the corrected one. The state of the given equations is the solution there too.
        """
        return self._equations()

    @staticmethod
    @abstractmethod
    def forecast(given: Equations) -> Forecast:
        """Return the forecast for a factorization of the finer problem."""

    @staticmethod
    @abstractmethod
    def attempts(forecast: Forecast) -> str:
        """Return what was tried where there is no memory for a factorization, as the end of a sentence."""

    @abstractmethod
    def solve(self, observer: Observer) -> Found | None:
        """Return the solution of the finer problem, or its first correction; ``None`` if there is no memory for it."""

    @abstractmethod
    def change(self, found: Found, start: fem.Function) -> fem.Function:
        """Return the correction of the displacement on cells of the given body, changing the one found.

        Args:
            start: displacement of the finer equations before they were solved.
        """

    def layer_errors(
        self, quantities: Sequence[QuantityOfInterest], computed: Mapping[str, Any]
    ) -> Mapping[str, LayerError]:
        """Return the errors that the finer problem has, too."""
        return {}

    def correction(self, moved: Floats, displacement: fem.Function) -> Correction:
        """Return the correction of the rest shape, for states that are solved from it."""
        return Correction(moved, displacement, self._omitted_geometry())

    @abstractmethod
    def _equations(self) -> Equations:
        """Return `equations`."""

    @abstractmethod
    def _node_values(self, displacement: fem.Function) -> Floats:
        """Return a displacement of the finer problem at the local geometry nodes of the given body."""

    @property
    def without_geometry(self) -> str:
        """Why the error of the geometry is left out; empty if it is included."""
        solution, correction = self.solution, self.rest_correction
        if not solution.is_on_given_mesh:
            return "the rest shape is taken as computed" if correction is None else correction.without_geometry
        return self.given.body.true_geometry_body[1]

    def _omitted_geometry(self) -> str:
        """Return why the error of the geometry is left out in states that are solved from this one."""
        body, unknown = self.given.body.true_geometry_body
        return unknown if body is None or body is self.given.body else "it is known for the given mesh only"

    @property
    def nodes(self) -> Floats:
        """Local geometry nodes (m) on which the solution is corrected."""
        nodes, correction = self.solution.mesh_nodes, self.rest_correction
        return nodes if correction is None else nodes + correction.nodes

    def moved(self) -> Found:
        """Return the difference of the state of `equations` from the solution."""
        u = self.equations.state().displacement
        nodal = self._node_values(u)
        moved = self.solution.sign * (nodal - self.solution.u)
        if self.rest_correction is not None:
            moved += self.rest_correction.nodes
        mine = np.linalg.norm(moved, axis=1)
        # The largest of NaN and a number depends on their order.
        largest = float(mine.max(initial=0.0)) if np.isfinite(mine).all() else np.inf
        return Found(u, nodal, moved, self.given.body.mesh.comm.allreduce(largest, op=MPI.MAX))

    def tangents_allowed(self, forecast: Forecast) -> int:
        """Return how many tangents the solve of the finer problem may take."""
        ranks, own = self.given.body.mesh.comm.size, self.given.chooser.forecast
        solve = self.solution.factorizations * (own.tangent(ranks) + _OVERHEAD)
        return int(max(SHARE * solve, LEAST) / (forecast.tangent(ranks) + _OVERHEAD))


class Budget(IterationObserver):
    """Observer that ends a solve after a number of tangents, the same on all ranks."""

    def __init__(self, observer: Observer, tangents: int) -> None:
        super().__init__(observer)
        self._left, self._of_this_solve = tangents, 0
        self._most = tangents

    @property
    def is_spent(self) -> bool:
        """True if no tangent is left."""
        return self._of_this_solve >= self._left

    @property
    def used(self) -> int:
        """Number of tangents so far."""
        return self._most - self._left + self._of_this_solve

    def iteration(self, iteration: NewtonIteration) -> None:
        super().iteration(iteration)
        self._of_this_solve += iteration.new_tangent

    def solved(self, event: SolveEvent) -> None:
        self._left -= max(event.solve.factorizations, self._of_this_solve)
        self._of_this_solve = 0

    def stop_asked(self) -> bool:
        return self.is_spent or super().stop_asked()


def put_with_ghosts(equations: Equations, state: State) -> None:
    """Put equations into a state whose ghosts are not set yet; collective."""
    for function in filter(None, state.fields):
        function.x.scatter_forward()
    equations.put(state)
