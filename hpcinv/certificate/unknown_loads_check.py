"""Checks of cavities of unknown pressure and of remote loads: their equations, and what other lines say with numbers
that no load gives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hpcinv.certificate.check import Line, Verdict, skipped, upper_bound_line
from hpcinv.certificate.forward_factors import ForwardFactors
from hpcinv.certificate.limit_point_check import LIMIT_POINTS
from hpcinv.quantity.units import readable
from hpcinv.results.solution import Solution
from hpcinv.results.unknown_numbers import solved_motions
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.equations import Equations

_WARN, _FAIL = 1e-8, 1e-5
"""Residual of an equation, relative to the larger volume or to the forces on a region; larger ones accept
wrong volumes and loads."""
_POTENTIAL = 1e-8
"""Asymmetry of a stiffness that rounding errors leave; raised, moments count as loads with a potential."""
_STABLE = "stability of remote loads: unstable motions"


def unknown_loads(solution: Solution) -> Iterator[Line]:
    """Yield the line of each cavity of unknown pressure and of each remote load."""
    for cavity in solution.cavities:
        name = f"equation of cavity '{cavity.name}', relative to its volume"
        note = f"pressure {readable(cavity.pressure, 'Pa', 6)}, volume {readable(cavity.volume, 'm^3', 6)}"
        yield upper_bound_line(name, cavity.residual, _WARN, _FAIL, note=note)
    for load in solution.remote_loads:
        name = f"balance of the remote load on '{load.region}', relative to its forces"
        note = f"turned by {np.degrees(load.motion.rotate):.4g}°, moved by {load.moved}"
        yield upper_bound_line(name, load.residual, _WARN, _FAIL, note=note)


def stable_motions(equations: Equations, forward: ForwardFactors) -> Iterator[Line]:
    """Yield the line on unstable motions of regions under remote loads; collective.

    A body is stable if it is stable with these motions held, and the stiffness (6 n, 6 n) that it has against changes
    of the n motions is positive definite: the number of negative eigenvalues of the whole tangent is the sum of both.
    """
    solution = forward.solution
    with forward.tangent() as equilibrium:
        bordered = BorderedSolver(equilibrium, solved_motions(equations, solution, equilibrium.system))
        is_solved = bordered.linearise(1.0)
        stiffness = bordered.condensed
        bordered.destroy()
    if not is_solved:
        yield skipped(_STABLE, "the tangent could not be factorized")
        return
    symmetric, skew = (stiffness + stiffness.T) / 2, (stiffness - stiffness.T) / 2
    unstable = int(np.count_nonzero(np.linalg.eigvalsh(symmetric) <= 0.0))
    asymmetry = float(np.linalg.norm(skew) / np.linalg.norm(symmetric))
    rule, note = "no negative eigenvalue of the stiffness against these motions", ""
    if asymmetry > _POTENTIAL:
        note = f"loads without a potential (asymmetry {asymmetry:.1g}): only the symmetric part was checked"
    verdict = (Verdict.WARN if note else Verdict.FAIL) if unstable else Verdict.PASS
    yield Line(_STABLE, float(unstable), "", rule, verdict, note)


def no_limit_points(solution: Solution) -> Iterator[Line]:
    """Yield the line on limit points of a path along which a volume is prescribed, or a region moves."""
    if solution.remote_loads:
        yield skipped(LIMIT_POINTS, "with remote loads they are not looked for")
    else:
        yield skipped(LIMIT_POINTS, "the pressure is unknown, and its limit points do not end the path")


def judged_with_given_numbers(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines of checks that keep pressures of cavities, and motions; what they do not pass is not decided.

    A body that is stable under a given pressure is stable with a given volume too, but not the other way round.
    """
    for line in lines:
        if line.verdict in (Verdict.PASS, Verdict.SKIPPED):
            yield line
        else:
            note = "checked with the pressure or motion that was found, not with the given volume, gas or load"
            yield replace(line, verdict=Verdict.UNDECIDED, note="; ".join(filter(None, [line.note, note])))
