"""What a solve would cost on more ranks than there are: counts and times that were measured, and a network assumed.

A part of a mesh has ``m = n/p`` unknowns, ``N(p)`` neighbours and a surface of ``s(p) m^(2/3)`` (`halo`). Fitted by
least squares to runs on 1 to 16 ranks:

==========================  ==========================================================================================
work per rank               ``a + b m`` seconds of each phase, with a, b ≥ 0, from runs on one rank
messages                    ``N(p) (a + b ln n)`` with a, b ≥ 0: multigrid has about ``ln n`` levels
bytes                       ``c s(p) m^(2/3)``: coarser levels have a fixed share of the finest one's surface
reductions                  a fixed number of each iteration and set-up, in ``log₂ p`` steps each
iterations                  ``a + b ln n``
==========================  ==========================================================================================

A message takes a latency and its bytes over the bandwidth, a step of a reduction a latency. Not in the model: uneven
parts, contention in the network, waiting on the coarsest levels, where a few ranks work while the others wait.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

if TYPE_CHECKING:
    from hpcinv.bench.halo import Halo
    from hpcinv.bench.samples import Sample

_SOLVER = {"tangent": "setups", "residual": "newton", "factorization": "setups", "linear solve": "iterations"}
"""Phases, and what their seconds are proportional to beside the unknowns."""
_ONCE = ("set-up", "evaluation", "other")  # phases that each rank does on its part, once


@dataclass(frozen=True)
class Machine:
    """What is assumed: seconds of latency, bytes per second, and what a shared file system answers per second."""

    latency: float
    bandwidth: float
    file_operations: float


@dataclass(frozen=True)
class Start:
    """What each rank does before it has the job: seconds of its processor, and calls to the file system."""

    seconds: float
    calls: float


@dataclass(frozen=True)
class Line:
    """A fit ``a + b x`` by least squares, with the standard error of what it says elsewhere."""

    a: float
    b: float
    covariance: npt.NDArray[np.float64]

    @classmethod
    def rising(cls, x: Sequence[float], y: Sequence[float]) -> Line:
        """With a, b ≥ 0, and errors that are relative to y; zero where all y are."""
        known = [(u, v) for u, v in zip(x, y, strict=True) if v > 0]
        if not known:
            return cls(0.0, 0.0, np.zeros((2, 2)))
        (a, b), _ = nnls(np.array([[1 / v, u / v] for u, v in known]), np.ones(len(known)))
        return cls(float(a), float(b), np.zeros((2, 2)))

    @classmethod
    def through(cls, x: Sequence[float], y: Sequence[float]) -> Line:
        """Of two points or more."""
        design = np.stack([np.ones(len(x)), np.array(x)], axis=1)
        found, *_ = np.linalg.lstsq(design, np.array(y), rcond=None)
        left = np.array(y) - design @ found
        variance = float(left @ left) / max(len(x) - 2, 1)
        return cls(float(found[0]), float(found[1]), variance * np.linalg.pinv(design.T @ design))

    def at(self, x: float) -> float:
        return self.a + self.b * x

    def error(self, x: float) -> float:
        there = np.array([1.0, x])
        return math.sqrt(float(there @ self.covariance @ there))


@dataclass(frozen=True)
class Power:
    """A fit ``a n^q``."""

    a: float
    q: float

    @classmethod
    def through(cls, n: Sequence[float], y: Sequence[float]) -> Power:
        line = Line.through([math.log(v) for v in n], [math.log(v) for v in y])
        return cls(math.exp(line.a), line.b)

    def at(self, n: float) -> float:
        return float(self.a * n**self.q)


@dataclass(frozen=True)
class CostModel:
    """The fits; all functions take unknowns n and ranks p."""

    newton: float
    setups: float
    work: Mapping[str, Line]
    iterations: Line
    exchanges: Mapping[str, Line]
    surface_bytes: Mapping[str, float]
    reductions: Mapping[str, float]
    memory: Line

    @classmethod
    def fitted(cls, samples: Sequence[Sample], halos: Mapping[int, Halo]) -> CostModel:
        """From runs on one rank and on more."""
        alone, apart = [s for s in samples if s.ranks == 1], [s for s in samples if s.ranks > 1]

        def exchanges(messages: Callable[[Sample], float]) -> Line:
            per_neighbour = [messages(s) / halos[s.ranks].neighbours for s in apart]
            return Line.rising([math.log(s.unknowns) for s in apart], per_neighbour)

        def surface(size: Callable[[Sample], float]) -> float:
            x = np.array([halos[s.ranks].surface * s.unknowns_per_rank ** (2 / 3) for s in apart])
            return float(x @ np.array([size(s) for s in apart]) / (x @ x))

        return cls(
            newton=float(np.mean([s.newton for s in samples])),
            setups=float(np.mean([s.setups for s in samples])),
            work={phase: _work(alone, phase, of) for phase, of in _SOLVER.items()}
            | {phase: _work(alone, phase, None) for phase in (*_ONCE, "mesh")},
            iterations=Line.through([math.log(s.unknowns) for s in samples], [s.iterations for s in samples]),
            exchanges={
                "iteration": exchanges(lambda s: s.messages_per_iteration),
                "setup": exchanges(lambda s: s.messages_per_setup),
            },
            surface_bytes={
                "iteration": surface(lambda s: s.bytes_per_iteration),
                "setup": surface(lambda s: s.bytes_per_setup),
            },
            reductions={
                "iteration": float(np.mean([s.reductions_per_iteration for s in samples])),
                "setup": float(np.mean([s.reductions_per_setup for s in samples])),
            },
            memory=Line.through([s.unknowns for s in alone], [s.memory for s in alone]),
        )

    def terms(self, n: float, p: int, halo: Halo, machine: Machine, start: Start) -> dict[str, float]:
        """Seconds by term."""
        m, iterations = n / p, self.iterations.at(math.log(n))
        found = {
            "start: imports, files of all ranks from one file system": p * start.calls / machine.file_operations,
            "start: imports, processor": start.seconds,
            "mesh, read and checked by one rank": self.work["mesh"].at(n),
            "set-up and results": sum(self.work[phase].at(m) for phase in _ONCE),
            "tangents": self.setups * self.work["tangent"].at(m),
            "residuals": self.newton * self.work["residual"].at(m),
            "preconditioner, work": self.setups * self.work["factorization"].at(m),
            "Krylov, work": iterations * self.work["linear solve"].at(m),
        }
        for name, what, times in (("preconditioner", "setup", self.setups), ("Krylov", "iteration", iterations)):
            messages = halo.neighbours * self.exchanges[what].at(math.log(n))
            size = self.surface_bytes[what] * halo.surface * m ** (2 / 3)
            found[f"{name}, messages"] = times * messages * machine.latency
            found[f"{name}, bytes"] = times * size / machine.bandwidth
            found[f"{name}, reductions"] = times * self.reductions[what] * math.log2(max(p, 2)) * machine.latency
        return found


def _work(alone: Sequence[Sample], phase: str, of: str | None) -> Line:
    """Seconds of a phase over unknowns, for each of what it is done for (`_SOLVER`)."""
    seconds = [s.seconds.get(phase, 0.0) / (getattr(s, of) if of else 1) for s in alone]
    return Line.rising([s.unknowns for s in alone], seconds)
