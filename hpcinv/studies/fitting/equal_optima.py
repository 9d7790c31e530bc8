"""Sets of parameters that fit tests equally well, and what they predict in tests that were not made.

Simple shear and planar tension, for example, do not change if all exponents of Ogden's law change their sign, but
uniaxial tension does. Of such sets the preferred one is stable and strongly elliptic in most modes, up to the largest
tested stretch; among those it departs least from the neo-Hookean law with the same tests, as rubber and soft tissue do.

Source: Rivlin & Saunders (1951), doi:10.1098/rsta.1951.0004: the energy of rubber depends on I1 much more than on I2.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.physics.materials import laws
from hpcinv.studies.fitting.homogeneous import MODES, Mode, Response
from hpcinv.studies.fitting.material_stability import stability
from hpcinv.studies.fitting.measurements import Test

_POINTS = 8  # of each probe; raised, the comparison takes longer
_DIFFERENT = 0.02
"""Share of the largest stress of a probe above which two predictions differ; tests are hardly more accurate."""
_DEVIATIONS = 2.0  # of a prediction, from the covariance, which a difference must exceed
_VOLUME_CHANGE = 0.1  # of the probe of volume, if the law is compressible


@dataclass(frozen=True)
class Probe:
    """A test that could be made, in the range of stretch of the tests that were made."""

    name: str
    mode: Mode
    measure: Floats


@dataclass(frozen=True)
class Disagreement:
    """A test in which equally good sets of parameters differ.

    Attributes:
        measure: the stretch, amount of shear or volume ratio of the largest difference.
        stress: nominal stress (Pa) of the preferred set and of the others, (n,); not a number where undefined.
        share: largest difference relative to the largest stress of the test.
    """

    probe: Probe
    measure: float
    stress: Floats
    share: float


@dataclass(frozen=True)
class EqualOptima:
    """The preferred set of parameters (SI), the others that fit equally well, and where they differ, most first."""

    preferred: int
    others: tuple[int, ...]
    disagreements: tuple[Disagreement, ...]


def probes(tests: Sequence[Test], response: Response) -> list[Probe]:
    """Return the tests in which laws are compared, up to the largest tested stretch."""
    largest = max((float(t.largest_stretch.max()) for t in tests if not t.mode.is_volumetric), default=1.0)
    found = []
    if largest > 1:
        ends = [
            ("uniaxial tension", "uniaxial", largest),
            ("uniaxial compression", "uniaxial", 1 / largest),
            ("equibiaxial tension", "equibiaxial", largest),
            ("planar tension", "planar", largest),
            ("simple shear", "simple-shear", largest - 1 / largest),
        ]
        found = [Probe(name, MODES[mode], _measures(MODES[mode], end)) for name, mode, end in ends]
    if not response.is_incompressible:
        volumes = np.linspace(1 - _VOLUME_CHANGE, 1 + _VOLUME_CHANGE, _POINTS)
        found.append(Probe("change of volume", MODES["volumetric"], volumes))
    return found


def _measures(mode: Mode, end: float) -> Floats:
    return np.linspace(mode.rest_measure, end, _POINTS + 1)[1:]


class Predictions:
    """Stresses that sets of parameters predict in the probes."""

    def __init__(self, response: Response, tests: Sequence[Test]) -> None:
        self._response, self._tests = response, tests
        self.probes = probes(tests, response)
        self._sizes = np.array([p.measure.size for p in self.probes], dtype=int)

    def of(self, values: Floats) -> tuple[Floats, Floats]:
        """Return stresses (n,) in all probes and their slopes by the parameters (n, k)."""
        if not self.probes:
            return np.zeros(0), np.zeros((0, len(values)))
        with np.errstate(all="ignore"):
            parts = self._response.stresses([(p.mode, p.measure, False) for p in self.probes], values)
        stress, slopes = zip(*parts, strict=True)
        return np.concatenate(stress), np.concatenate(slopes)

    def shares(self, stress: Floats, other: Floats, deviation: Floats) -> Floats:
        """Return differences (n,) relative to the largest stress of each probe; 0 where they may be chance."""
        sizes = np.repeat([self._largest(stress[part], other[part]) for part in self._parts()], self._sizes)
        difference = np.abs(stress - other)
        share = np.where(difference > _DEVIATIONS * np.nan_to_num(deviation), difference / sizes, 0.0)
        undefined = np.isfinite(stress) != np.isfinite(other)
        return np.where(undefined, 1.0, np.nan_to_num(share))

    def departure(self, stress: Floats) -> float:
        """Return the largest relative difference from the neo-Hookean law with the same tests, but for volume."""
        neo_hookean = laws()["isochoric-neo-hookean"]
        law = neo_hookean.model_validate({**neo_hookean.example, "mu": "1 Pa", "kappa": "incompressible"})
        unit = Response(law, [])
        none = np.zeros(0)
        tests = [t for t in self._tests if not t.mode.is_volumetric]
        if not tests:
            return 0.0
        pattern = np.concatenate([unit.stress(t.mode, t.measure, none, cauchy=t.is_cauchy)[0] for t in tests])
        modulus = float(pattern @ np.concatenate([t.stress for t in tests]) / (pattern @ pattern))
        departures = [0.0]
        for probe, part in zip(self.probes, self._parts(), strict=True):
            if not probe.mode.is_volumetric:
                expected = modulus * unit.stress(probe.mode, probe.measure, none)[0]
                difference = np.nan_to_num(stress[part] - expected, nan=np.inf)
                departures.append(float(np.abs(difference).max() / np.abs(expected).max()))
        return max(departures)

    def disagreements(self, stresses: Sequence[Floats], shares: Floats) -> Iterator[Disagreement]:
        """Yield where the first stresses differ from the others, for each probe with a difference."""
        for probe, part in zip(self.probes, self._parts(), strict=True):
            place = int(shares[part].argmax())
            share = float(shares[part][place])
            if share > _DIFFERENT:
                stress = np.array([s[part][place] for s in stresses])
                yield Disagreement(probe, float(probe.measure[place]), stress, share)

    def _parts(self) -> list[slice]:
        ends = np.cumsum(self._sizes)
        return [slice(end - size, end) for end, size in zip(ends, self._sizes, strict=True)]

    @staticmethod
    def _largest(*stresses: Floats) -> float:
        finite = np.abs(np.concatenate([s[np.isfinite(s)] for s in stresses]))
        return float(finite.max(initial=0.0)) or 1.0


def different(predictions: Predictions, values: Floats, others: Sequence[Floats]) -> bool:
    """Return whether some values predict another stress than all of the others."""
    stress, _ = predictions.of(values)
    none = np.zeros_like(stress)
    return all(predictions.shares(stress, predictions.of(o)[0], none).max(initial=0.0) > _DIFFERENT for o in others)


def compare(
    predictions: Predictions,
    tests: Sequence[Test],
    response: Response,
    optima: Sequence[Floats],
    covariance: Callable[[int], Floats],
) -> EqualOptima:
    """Return the preferred one of equally good sets of parameters, and those that differ from it.

    Args:
        optima: their values (SI), the best fit first.
        covariance: of the parameters (SI) at the optimum of a number.
    """
    if len(optima) == 1:
        return EqualOptima(0, (), ())
    of_all = [predictions.of(values) for values in optima]

    def order(number: int) -> tuple[int, float]:
        ranges = stability(response, optima[number], tests)
        lost = sum((r.lost_at is not None) + (r.not_elliptic_at is not None) for r in ranges)
        return lost, predictions.departure(of_all[number][0])

    def shares_from(number: int) -> dict[int, Floats]:
        """Return the shares by which other optima differ from one, where that is not chance."""
        stress, slopes = of_all[number]
        variance = np.einsum("ni,ij,nj->n", slopes, covariance(number), slopes)
        deviation = np.sqrt(np.maximum(variance, 0.0))
        shares = {i: predictions.shares(stress, s, deviation) for i, (s, _) in enumerate(of_all) if i != number}
        return {i: share for i, share in shares.items() if share.max(initial=0.0) > _DIFFERENT}

    preferred = min((0, *shares_from(0)), key=order)
    shares = shares_from(preferred)
    if not shares:
        return EqualOptima(preferred, (), ())
    stresses = [of_all[i][0] for i in (preferred, *shares)]
    found = predictions.disagreements(stresses, np.max(list(shares.values()), axis=0))
    return EqualOptima(preferred, tuple(shares), tuple(sorted(found, key=lambda d: -d.share)))
