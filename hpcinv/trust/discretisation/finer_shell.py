"""The finer problem of a shell: the same unknowns on cells of half the size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from dolfinx import fem

from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh.source import Floats
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import Forecast
from hpcinv.solver.observer import Observer, stop_if_asked
from hpcinv.trust.discretisation import halved_cells
from hpcinv.trust.discretisation.estimate import Correction, LayerError
from hpcinv.trust.discretisation.finer_problem import Budget, FinerProblem, Found, put_with_ghosts
from hpcinv.trust.discretisation.layer_errors import layer_errors

_TANGENTS = 10
"""Tangents that the finer solve may take in any case; raised, more lines are decided"""


class FinerShell(FinerProblem):
    """A solve on halved cells."""

    where: ClassVar[str] = "on cells of half the size"

    @staticmethod
    def forecast(given: Equations) -> Forecast:
        return Equations(given.job, given.body.halved, given.timings).chooser.forecast

    @staticmethod
    def attempts(forecast: Forecast) -> str:
        return f" {FinerShell.where}"

    def solve(self, observer: Observer) -> Found | None:
        given, finer = self.given, self.equations
        forecast = finer.chooser.forecast
        if forecast.least > given.chooser.room:
            return None
        budget = Budget(observer, max(_TANGENTS, self.tangents_allowed(forecast)))
        is_solved = halved_cells.solve(given, self.solution, finer, budget)
        stop_if_asked(finer.body.mesh.comm, observer)
        found = replace(self.moved(), is_solved=is_solved, tangents=max(budget.used, 1))
        return found if is_solved else replace(found, largest=np.inf)

    def change(self, found: Found, start: fem.Function) -> fem.Function:
        """Return the correction on the given cells: indicators belong to these."""
        return halved_cells.nodal_function(self.given.unknowns, found.nodal - self.solution.u)

    def layer_errors(
        self, quantities: Sequence[QuantityOfInterest], computed: Mapping[str, Any]
    ) -> Mapping[str, LayerError]:
        return layer_errors(self.given, self.solution, quantities, computed)

    def correction(self, moved: Floats, displacement: fem.Function) -> Correction:
        nodes = self.equations.body.nodes
        nodes = nodes + self.solution.sign * self.equations.unknowns.geometry_values(displacement)
        return replace(super().correction(moved, displacement), finer_nodes=nodes)

    def _equations(self) -> Equations:
        given, solution, correction = self.given, self.solution, self.rest_correction
        body, unknowns = given.body, given.unknowns
        with given.timings("mesh"):
            finer = Equations(solution.job, body.halved, given.timings)
            finer.take_supports_as_checked()
        given.put(solution.moved_to(self.nodes))
        corrected = None if correction is None else correction.finer_nodes
        nodes = halved_cells.refined_values(body, solution.mesh_nodes) if corrected is None else corrected
        state = replace(finer.unloaded(nodes=None if solution.is_on_given_mesh else nodes), load=solution.load)

        def refined(displacement: fem.Function) -> fem.Function:
            return halved_cells.refined_function(body, unknowns, displacement, finer.unknowns)

        if (other := solution.given_displacement) is not None:
            state = replace(state, given_displacement=refined(other) if correction is None else correction.displacement)
        state = replace(state, displacement=refined(solution.displacement))
        if solution.pressure is not None:
            pressure = halved_cells.refined_pressure(body, unknowns, solution.pressure, finer.unknowns)
            state = replace(state, pressure=pressure)
        put_with_ghosts(finer, state)
        return finer

    def _node_values(self, displacement: fem.Function) -> Floats:
        return halved_cells.given_values(self.given.body, self.equations.unknowns.geometry_values(displacement))
