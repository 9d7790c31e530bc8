"""Cavities of unknown pressure: their equations, and what other lines say with a pressure that no load gives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from hpcinv.certificate.check import Line, Verdict, skipped, upper_bound_line
from hpcinv.certificate.limit_point_check import LIMIT_POINTS
from hpcinv.quantity.units import readable
from hpcinv.results.solution import Solution

_WARN, _FAIL = 1e-8, 1e-5
"""Residual of a cavity's equation, relative to the volume of the mesh's body; larger ones accept wrong volumes."""


def cavities(solution: Solution) -> Iterator[Line]:
    """Yield the line of each cavity of unknown pressure."""
    for cavity in solution.cavities:
        name = f"equation of cavity '{cavity.name}', relative to its volume"
        note = f"pressure {readable(cavity.pressure, 'Pa', 6)}, volume {readable(cavity.volume, 'm^3', 6)}"
        yield upper_bound_line(name, cavity.residual, _WARN, _FAIL, note=note)


def no_limit_points() -> Iterator[Line]:
    """Yield the line on limit points of a path along which the volume is prescribed."""
    yield skipped(LIMIT_POINTS, "the pressure is unknown, and its limit points do not end the path")


def judged_at_given_pressure(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines of checks that keep the pressure of cavities; what they do not pass is not decided.

    A body that is stable under a given pressure is stable with a given volume too, but not the other way round.
    """
    for line in lines:
        if line.verdict in (Verdict.PASS, Verdict.SKIPPED):
            yield line
        else:
            note = "checked under the pressure that was found, not with the given volume or gas"
            yield replace(line, verdict=Verdict.UNDECIDED, note="; ".join(filter(None, [line.note, note])))
