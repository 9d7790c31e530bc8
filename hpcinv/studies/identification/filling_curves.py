"""Pressure-volume curves of filling, which the volumes of a cavity are compared with.

Klotz's curve is estimated from one point (V, P) at the end of diastole, with An = 27.78 mmHg and Bn = 2.76 of human
hearts:

    V₀ = V (0.6 - 0.006 P/mmHg),      V₃₀ = V₀ + (V - V₀) (An/P)^(1/Bn),      p = α v^β.

α and β are such that the curve passes through (V, P) and (V₃₀, 30 mmHg), or above 22 mmHg through (V₁₅, 15 mmHg) with
V₁₅ = V₀ + 0.8 (V₃₀ - V₀). Below V₀ the power law is cut off.

Sources: Klotz et al. (2006), doi:10.1152/ajpheart.01240.2005; Klotz, Dickstein & Burkhoff, Nature Protocols 2,
2152-2158, 2007; figures as in ansys/pyansys-heart@7d61ce9, src/ansys/health/heart/post/klotz_curve.py.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from hpcinv.job.filling_points import pressure_in
from hpcinv.job.identification import Observation, PressureAndVolume
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.model.cavities import enclosed_volume

MMHG = 133.322387415
"""one mmHg in Pa"""
_AN, _BN = 27.78, 2.76  # mmHg, and 1: of the normalised curve of human hearts
_STEEP = 22.0  # mmHg from which on the second point is at 15 mmHg: near 30 mmHg two points are too close


class FillingCurve(ABC):
    """A curve of volume over pressure. All in SI."""

    @abstractmethod
    def volume(self, pressure: float) -> float:
        """Return the volume at a pressure."""


@dataclass(frozen=True)
class KlotzCurve(FillingCurve):
    """Klotz's curve through a point at the end of diastole, in m³ and Pa."""

    end_volume: float
    end_pressure: float

    @property
    def unloaded_volume(self) -> float:
        return self.end_volume * (0.6 - 0.006 * self.end_pressure / MMHG)

    @property
    def _second_point(self) -> tuple[float, float]:
        """A further point: volume (m³) and pressure (mmHg)."""
        pressure, unloaded = self.end_pressure / MMHG, self.unloaded_volume
        at_30 = (self.end_volume - unloaded) * (_AN / pressure) ** (1 / _BN)
        return (unloaded + at_30, 30.0) if pressure <= _STEEP else (unloaded + 0.8 * at_30, 15.0)

    @property
    def exponent(self) -> float:
        """β."""
        volume, pressure = self._second_point
        return math.log(self.end_pressure / MMHG / pressure) / math.log(self.end_volume / volume)

    def volume(self, pressure: float) -> float:
        if pressure <= 0.0:
            return self.unloaded_volume
        volume: float = self.end_volume * (pressure / self.end_pressure) ** (1 / self.exponent)
        return max(self.unloaded_volume, volume)


@dataclass(frozen=True)
class MeasuredCurve(FillingCurve):
    """Straight lines between measured points (pressure, volume), in order of pressure."""

    points: Sequence[tuple[float, float]]

    def volume(self, pressure: float) -> float:
        import numpy as np

        pressures, volumes = zip(*self.points, strict=True)
        return float(np.interp(pressure, pressures, volumes))


def filling_curve(observation: Observation, job: Job, body: Body) -> FillingCurve:
    """Return the curve of an observation; collective."""
    if observation.curve is not None:
        return MeasuredCurve([(point.pressure, point.volume) for point in observation.curve])
    if isinstance(observation.klotz, PressureAndVolume):
        return KlotzCurve(observation.klotz.volume, observation.klotz.pressure)
    return KlotzCurve(*given_point(job, body, str(observation.cavity)))


def given_point(job: Job, body: Body, cavity: str) -> tuple[float, float]:
    """Return volume (m³) and pressure (Pa) of a cavity of the given body; collective."""
    given = next(state for state in job.states if state.given)
    pressure, _ = pressure_in(given.effects, job.cavities[cavity])
    return enclosed_volume(job, body, cavity).volume(body.given_nodes), pressure
