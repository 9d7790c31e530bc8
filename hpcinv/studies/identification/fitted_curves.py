"""Computed pressure-volume curves at the estimate, with their bands, over the curves that were observed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hpcinv.job.filling_points import filling_points
from hpcinv.job.identification import Observation
from hpcinv.job.job import Job
from hpcinv.output.result import Result
from hpcinv.pages.pictures.figures import as_files, new_figure, style
from hpcinv.studies.identification.filling_curves import MMHG, KlotzCurve, filling_curve, given_point
from hpcinv.studies.identification.posterior import Posterior

_SAMPLES = 100
"""points of the observed curve in the picture; more make it smoother"""
_KILOPASCAL, _MILLILITRE = 1e3, 1e-6


@dataclass(frozen=True)
class FittedPoint:
    """A computed volume (m³) at a pressure (Pa), and the volume of the observed curve there.

    Attributes:
        quantity: its name; empty for the volume of the given body.
        sd: standard deviation to first order.
        band: ±2 standard deviations, or quantiles of the posterior at 2.5 and 97.5 %.
    """

    quantity: str
    pressure: float
    volume: float
    sd: float
    band: tuple[float, float]
    observed: float


@dataclass(frozen=True)
class FittedCurve:
    """A curve of a cavity at the estimate.

    Attributes:
        kind: ``klotz`` or ``curve``.
        sd: standard deviation (m³) of the observed volumes.
        points: in order of pressure.
        end: volume (m³) and pressure (Pa) from which Klotz's curve was estimated.
        observed: the observed curve, pressures (Pa) and volumes (m³).
    """

    name: str
    cavity: str
    kind: str
    sd: float
    points: Sequence[FittedPoint]
    end: tuple[float, float] | None
    observed: tuple[list[float], list[float]]

    def as_data(self) -> dict[str, Any]:
        return asdict(self) | {"rows": [self._row(point) for point in self.points]}

    @property
    def pressure_unit(self) -> tuple[float, str]:
        """Size (Pa) and symbol of the unit in which pressures are shown."""
        return (MMHG, "mmHg") if self.kind == "klotz" else (_KILOPASCAL, "kPa")

    def _row(self, point: FittedPoint) -> list[str]:
        """Return a row of the table: name, pressure, volumes in ml."""
        unit, name = self.pressure_unit
        volumes = (point.volume, point.sd, *point.band, point.observed)
        texts = [f"{volume / _MILLILITRE:.4g} ml" for volume in volumes]
        return [point.quantity or "given body", f"{point.pressure / unit:.4g} {name}", *texts]


def fitted_curves(
    job: Job, result: Result, deviations: Mapping[str, float | list[float]], posterior: Posterior | None
) -> list[FittedCurve]:
    """Return the curves that a job observes; collective.

    Args:
        deviations: standard deviations of the quantities of the result.
        posterior: its quantiles are the bands, if there is one.
    """
    assert job.identify is not None
    specs = [spec for spec in job.identify.observations if spec.is_curve]
    return [_fitted_curve(spec, job, result, deviations, posterior) for spec in specs]


def _fitted_curve(
    spec: Observation,
    job: Job,
    result: Result,
    deviations: Mapping[str, float | list[float]],
    posterior: Posterior | None,
) -> FittedCurve:
    curve = filling_curve(spec, job, result.body)
    known = filling_points(str(spec.cavity), job.cavities, job.quantities, job.states)
    volume, pressure = given_point(job, result.body, str(spec.cavity))
    points = [FittedPoint("", pressure, volume, 0.0, (volume, volume), curve.volume(pressure))]
    for point in known:
        value, sd = (float(np.ravel(numbers[point.quantity])[0]) for numbers in (result.quantities, deviations))
        low, high = (value - 2 * sd, value + 2 * sd) if posterior is None else posterior.band(point.quantity)
        band = float(low), float(high)
        points.append(FittedPoint(point.quantity, point.pressure, value, sd, band, curve.volume(point.pressure)))
    points.sort(key=lambda point: point.pressure)
    end = (curve.end_volume, curve.end_pressure) if isinstance(curve, KlotzCurve) else None
    highest = max(point.pressure for point in points)
    pressures = np.linspace(0.0, highest, _SAMPLES) if spec.klotz else np.array([p.pressure for p in spec.curve or ()])
    observed = pressures.tolist(), [curve.volume(float(pressure)) for pressure in pressures]
    return FittedCurve(spec.name, str(spec.cavity), spec.kind, spec.sd.value, points, end, observed)


def picture(curve: FittedCurve) -> bytes:
    """Return the picture (PNG) of a curve with its band over the observed one ±2 standard deviations."""
    is_klotz, (unit, name) = curve.kind == "klotz", curve.pressure_unit
    pressures = np.array([point.pressure for point in curve.points]) / unit
    volumes = np.array([point.volume for point in curve.points]) / _MILLILITRE
    low, high = np.array([point.band for point in curve.points]).T / _MILLILITRE
    observed_pressures, observed = np.array(curve.observed[0]) / unit, np.array(curve.observed[1]) / _MILLILITRE
    with new_figure(6.0, 4.0) as figure:
        axes = figure.subplots()
        (colour, _, dashes), (other, marker, _) = style(1), style(0)
        axes.fill_betweenx(
            observed_pressures,
            observed - 2 * curve.sd / _MILLILITRE,
            observed + 2 * curve.sd / _MILLILITRE,
            color=colour,
            alpha=0.12,
            linewidth=0,
        )
        axes.plot(
            observed, observed_pressures, color=colour, linestyle=dashes, label="Klotz" if is_klotz else "measured"
        )
        axes.fill_betweenx(pressures, low, high, color=other, alpha=0.3, linewidth=0)
        axes.plot(volumes, pressures, color=other, marker=marker, label="computed")
        if curve.end:
            axes.plot(curve.end[0] / _MILLILITRE, curve.end[1] / unit, "k*", label="end of diastole")
        axes.set(xlabel=f"volume of '{curve.cavity}' (ml)", ylabel=f"pressure ({name})", title=curve.name)
        axes.legend()
        return as_files(figure)["png"]
