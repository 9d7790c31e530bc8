"""Solutions of the cases on a line through the space of numbers, as a power series at one of them.

The numbers of the job lead from a solved case (0) to another one (1), as the load factor leads from
the unloaded body to the full load (`hpcinv.solver.series_continuation`): one factorization serves all orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx.fem import Function

from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.mesh.source import Floats
from hpcinv.model.outcome import Outcome
from hpcinv.model.spaces import Unknowns
from hpcinv.model.state import State
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.power_series import PowerSeries
from hpcinv.solver.series_continuation import SeriesContinuation
from hpcinv.studies.sweep.neighbours import is_equal

STRATEGY = "power series in numbers"
"""Strategy of the solve of a case that begins with the value of a series."""

_ACCURACY = 1e-4
"""Error of a series up to which a solve starts from its value; from far larger ones it would need a new tangent all the
same."""
_EXACT = 1e-11
"""Error of a series at the farthest case at which orders end early; raised, cases take more corrections."""
_COLLINEAR = 1e-9  # largest distance of a case's numbers from the line, as a share of its length


@dataclass(frozen=True)
class ParameterSeries:
    """A power series in the numbers of a job.

    Attributes:
        key: key of the case at which it was made.
        first: numbers of that case.
        last: numbers of another case on the line.
        origin: owned unknowns in the first case.
        scales: of the unknowns.
        sign: as of `Guess`.
    """

    key: str
    first: Floats
    last: Floats
    series: PowerSeries
    origin: Floats
    unknowns: Unknowns
    scales: Scales
    sign: int

    @property
    def bytes(self) -> int:
        return self.series.states.nbytes + self.origin.nbytes

    def guess(self, numbers: Sequence[float]) -> tuple[Guess, float] | None:
        """Return the start of a case with some numbers, and its error; ``None`` out of range; collective."""
        share = share_of(self.first, self.last, np.array(numbers))
        found = None if share is None else self.series.at_load(share, _ACCURACY)
        if found is None:
            return None
        weights, error = found
        state = Function(self.unknowns.space)
        state.x.petsc_vec.array[:] = self.origin + weights @ self.series.states
        state.x.scatter_forward()
        u, p = self.unknowns.displacement(state), self.unknowns.pressure(state)
        pressure = None if p is None else self.scales.stress * p.x.array
        guess = Guess(self.scales.length * u.x.array, pressure, self.sign, STRATEGY, keeps_factors=True)
        return guess, error


def expanded(
    equations: Equations, solution: Solution, key: str, first: Sequence[float], last: Sequence[float]
) -> ParameterSeries:
    """Return the series at a solution, with the present factors if their tangent is near it; collective.

    Args:
        equations: with the numbers of another case of the reuse group; the path leads there.
        key: key of the case that was solved.
        first: numbers of the case that was solved.
        last: numbers of the other case.

    Raises:
        NotAnalytic: on all ranks, if there is no series; the message has the reason.
    """
    if solution.constraints:
        raise NotAnalytic(f"{solution.constraints[0].what} is unknown, and its equation has no series")
    equations.put(
        State(
            job=equations.job,
            mesh_nodes=solution.mesh_nodes,
            displacement=solution.displacement,
            pressure=solution.pressure,
        )
    )
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    try:
        if not equilibrium.linear.become_exact():
            raise NotAnalytic("its many solves need factors in double precision, and the body is too large for these")
        are_near = equilibrium.linear.reuse_factors()
        equilibrium.system.begin_line(solution.job)
        series = SeriesContinuation(equilibrium).expand(1.0, _EXACT, are_near=are_near)
        origin = equilibrium.system.position()
        values = np.array(origin.array)
        origin.destroy()
    finally:
        equations.release(equilibrium)
    if isinstance(series, Outcome):
        raise NotAnalytic(series.text)
    sign = solution.as_guess().sign
    ends = np.array(first), np.array(last)
    return ParameterSeries(key, *ends, series, values, equations.unknowns, equations.scales, sign)


def share_of(first: Floats, last: Floats, numbers: Floats) -> float | None:
    """Return the share of the way between two sets of numbers at which a third lies, ``None`` if not on the line."""
    varies = ~is_equal(first, last)
    if not is_equal(numbers, first)[~varies].all():
        return None
    shares = (numbers[varies] - first[varies]) / (last[varies] - first[varies])
    share = float(shares.mean())
    return share if np.abs(shares - share).max() <= _COLLINEAR * max(1.0, abs(share)) else None
