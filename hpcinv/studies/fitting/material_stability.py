"""Stability of a law over ranges of stretch: Drucker's condition, and strong ellipticity.

Drucker's condition is ``dτ : dε > 0``: a change of stress does work on the change of strain. It is demanded for all
changes of the principal logarithmic strains ``ε``, with Kirchhoff's stress ``τ``; of an incompressible material for
changes that keep the volume. Without it, a body may have no solution or several.

Strong ellipticity (`hpcinv.studies.fitting.ellipticity`) excludes jumps of the strain across surfaces. Neither implies
the other.

Source: Hill (1970), "Constitutive inequalities for isotropic elastic solids under finite strain",
doi:10.1098/rspa.1970.0018.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats
from hpcinv.studies.fitting.ellipticity import is_elliptic
from hpcinv.studies.fitting.homogeneous import MODES, Mode, Response
from hpcinv.studies.fitting.measurements import Test

_POINTS = 200  # at which each side of a range is checked
_KEEP_VOLUME = np.array([[1, -1, 0], [1, 1, -2]]).T / np.sqrt([2, 6])  # basis of logarithmic strains (3, 2)


@dataclass(frozen=True)
class Range:
    """A range of one mode, and where in it the law is not stable.

    Attributes:
        low, high: ends of the measure (stretch, amount of shear or volume ratio).
        tested: whether it is the range of a test; otherwise it has the stretches of the other tests.
        lost_at: the measure nearest to the undeformed state at which Drucker's condition does not hold, or ``None``.
        not_elliptic_at: the same of strong ellipticity.
    """

    mode: Mode
    low: float
    high: float
    tested: bool
    lost_at: float | None
    not_elliptic_at: float | None


def stability(response: Response, parameters: Floats, tests: Sequence[Test]) -> list[Range]:
    """Check the ranges of the tests, then the other modes up to the largest tested stretch."""
    ranges: dict[str, tuple[float, float]] = {}
    for test in tests:
        low, high = ranges.get(test.mode.name, (test.mode.rest_measure, test.mode.rest_measure))
        ranges[test.mode.name] = min(low, float(test.measure.min())), max(high, float(test.measure.max()))
    largest = max((float(t.largest_stretch.max()) for t in tests if not t.mode.is_volumetric), default=1.0)
    checked = []
    for name, mode in MODES.items():
        tested = name in ranges
        low, high = ranges.get(name, (mode.rest_measure, largest - 1 / largest if mode.is_shear else largest))
        if tested or (not mode.is_volumetric and high > low):
            points = _points(mode, low, high)
            lost_at, not_elliptic_at = (
                _nearest(mode, points, ~holds(response, parameters, mode, points))
                for holds in (_is_stable, is_elliptic)
            )
            checked.append(Range(mode, low, high, tested, lost_at, not_elliptic_at))
    return checked


def _points(mode: Mode, low: float, high: float) -> Floats:
    """Return the measures at which a range is checked, without the undeformed state."""
    ends = [end for end in (low, high) if end != mode.rest_measure]
    return np.concatenate([np.linspace(mode.rest_measure, end, _POINTS + 1)[1:] for end in ends])


def _nearest(mode: Mode, measure: Floats, lost: npt.NDArray[np.bool_]) -> float | None:
    """Return the measure nearest to the undeformed state among those that are marked."""
    marked = measure[lost]
    return float(marked[np.abs(marked - mode.rest_measure).argmin()]) if len(marked) else None


def _is_stable(response: Response, parameters: Floats, mode: Mode, measure: Floats) -> npt.NDArray[np.bool_]:
    return smallest_stiffness(response, parameters, mode, measure) > 0


def smallest_stiffness(response: Response, parameters: Floats, mode: Mode, measure: Floats) -> Floats:
    """Return the smallest eigenvalue (n,) of ``dτ/dε`` in Pa; not a number where the law is not defined."""
    stretches = response.state(mode, measure, parameters)
    W = response.energy(stretches, parameters, slopes=False)
    tangent = W.hessian * stretches[:, :, None] * stretches[:, None, :]
    tangent[:, range(3), range(3)] += W.gradient * stretches
    if response.is_incompressible:
        tangent = _KEEP_VOLUME.T @ tangent @ _KEEP_VOLUME
    smallest = np.full(len(measure), np.nan)
    defined = np.isfinite(tangent).all(axis=(1, 2)) & np.isfinite(W.value)
    smallest[defined] = np.linalg.eigvalsh(tangent[defined])[:, 0]
    return smallest
