"""Results of fits as text, as plain data, and as sections of a job."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import yaml

from hpcinv.base.files.names import escaped_line
from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.units import Dimension, readable
from hpcinv.studies.fitting.candidate import quantity, short
from hpcinv.studies.fitting.least_squares import Fit
from hpcinv.studies.fitting.linearised import correlations
from hpcinv.studies.fitting.material_stability import Range, stability

_POOR = 2.0  # scatter in standard deviations above which the law does not describe the tests


@dataclass(frozen=True)
class CheckedFit:
    """A fit with its stability; the better of two has the smaller criterion."""

    fit: Fit
    ranges: tuple[Range, ...]

    @classmethod
    def check(cls, fit: Fit) -> Self:
        return cls(fit, tuple(stability(fit.response, fit.values, fit.tests)))

    @property
    def label(self) -> str:
        return self.fit.candidate.label

    def job_sections(self) -> dict[str, Any]:
        """Return the sections ``material`` and ``sensitivities`` of a job."""
        fit = self.fit
        parameters = fit.candidate.parameters
        return {
            "material": fit.candidate.section([float(v) for v in fit.values]),
            "sensitivities": {
                p.key: rounded(float(s), p.dimension) for p, s in zip(parameters, fit.deviations, strict=True) if s > 0
            },
        }

    def as_yaml(self) -> str:
        """Return the sections as YAML, with the source of the figures in comments."""
        fit = self.fit
        tests = "; ".join(f"{t.name} ({len(t)} points)" for t in fit.tests)
        origin = f"fitted by 'hpcinv fit' to {tests}; R² {fit.r_squared:.6f}"
        correlation = f"correlation of the parameters: {_correlations(fit)}" if len(fit.values) > 1 else ""
        return commented(self.job_sections(), origin, correlation, self.warnings())

    def warnings(self) -> list[str]:
        """Return what a user should know before the law is used."""
        messages = []
        for r in self.ranges:
            if r.lost_at is not None:
                messages.append(
                    f"{self.label} is not stable {_place(r)}: {r.mode.name}, {r.mode.measure} {r.lost_at:.4g}"
                    f" (Drucker's condition, checked from {r.low:.4g} to {r.high:.4g})"
                )
            if r.not_elliptic_at is not None:
                messages.append(
                    f"{self.label} is not strongly elliptic {_place(r)}: {r.mode.name}, {r.mode.measure}"
                    f" {r.not_elliptic_at:.4g} (checked from {r.low:.4g} to {r.high:.4g}): results depend on the mesh"
                )
        fit = self.fit
        if fit.disagreements:
            messages.append(f"{self.label}: {_indeterminacy(fit)}")
        if fit.deviations_known and fit.scatter > _POOR:
            messages.append(
                f"{self.label} misses the tests by {fit.scatter:.3g} of their standard deviations, so that the"
                " parameters' deviations are too small"
            )
        for p, value in zip(fit.candidate.parameters, fit.values, strict=True):
            for bound in (p.lower, p.upper):
                if np.isfinite(bound) and abs(value - bound) <= 1e-6 * max(abs(bound), abs(value), 1e-3):
                    messages.append(
                        f"{self.label}: {p.name} is at the end of its range, {bound:.4g}; it has no use here"
                    )
        return messages

    def as_data(self) -> dict[str, Any]:
        """Return all figures, in SI, as plain data."""
        fit = self.fit
        parameters = zip(fit.candidate.parameters, fit.values, fit.deviations, strict=True)
        return {
            "law": self.label,
            "parameters": [
                {"key": p.key, "value": float(v), "unit": p.dimension.unit, "standard_deviation": float(s)}
                for p, v, s in parameters
            ],
            "covariance": fit.covariance,
            "correlation": fit.correlation,
            "equally_good": [dict(zip((p.key for p in fit.candidate.parameters), v, strict=True)) for v in fit.rivals],
            "disagreements": [
                {"test": d.probe.name, d.probe.mode.measure: d.measure, "share": d.share}
                | {"stress": d.stress[0], "stress_of_equally_good": d.stress[1:]}
                for d in fit.disagreements
            ],
            "points": fit.count,
            "r_squared": fit.r_squared,
            "aicc": fit.aicc,
            "chi_squared": fit.chi_squared if fit.deviations_known else None,
            "residual_standard_deviation": None if fit.deviations_known else fit.scatter,
            "tests": [
                {
                    "name": test.name,
                    "mode": test.mode.name,
                    "stress": "cauchy" if test.is_cauchy else "nominal",
                    "points": len(test),
                    "points_at_rest": test.rest_count,
                    **dict(zip(("rms_residual", "largest_residual", "r_squared"), fit.quality(i), strict=True)),
                    "measure": test.measure,
                    "measured": test.stress,
                    "fitted": test.stress + fit.residuals[i],
                }
                for i, test in enumerate(fit.tests)
            ],
            "stability": [
                {"mode": r.mode.name, "from": r.low, "to": r.high, "tested": r.tested}
                | {"lost_at": r.lost_at, "not_elliptic_at": r.not_elliptic_at}
                for r in self.ranges
            ],
            "warnings": self.warnings(),
            **self.job_sections(),
        }


def commented(sections: dict[str, Any], origin: str, correlation: str, warnings: Sequence[str]) -> str:
    """Return sections of a job as YAML, below comments: their origin, correlations if there are any, and warnings."""
    comments = [origin]
    if correlation:
        comments += [correlation, "(sensitivities take the standard deviations as independent of each other)"]
    lines = [f"# {escaped_line(comment)}\n" for comment in (*comments, *warnings)]
    body = yaml.safe_dump(sections, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    return "".join([*lines, body])


def describe(outcome: CheckedFit) -> list[str]:
    """Return the lines on one law: parameters, residuals of each test, stability."""
    fit = outcome.fit
    lines = [f"{outcome.label}:"]
    for p, value, deviation in zip(fit.candidate.parameters, fit.values, fit.deviations, strict=True):
        share = f" ({deviation / abs(value):.1%})" if value else ""
        lines.append(f"  {p.name} = {short(value, p.dimension)} ± {short(deviation, p.dimension, 2)}{share}")
    if len(fit.values) > 1:
        lines.append(f"  correlation: {_correlations(fit)}")
    for values in fit.rivals:
        lines.append(f"  equally good: {_assignments(fit, values)}")
    for i, test in enumerate(fit.tests):
        rms, largest, r_squared = fit.quality(i)
        lines.append(
            f"  {test.name}: {len(test)} points, residual {readable(rms, 'Pa')} (rms), {readable(largest, 'Pa')}"
            f" (largest), R² {r_squared:.5f}"
        )
    stable = [r for r in outcome.ranges if r.lost_at is None]
    elliptic = [r for r in outcome.ranges if r.not_elliptic_at is None]
    for name, ranges in (("stable", stable), ("strongly elliptic", elliptic)):
        texts = [f"{r.mode.name} {r.low:.3g} to {r.high:.3g}{'' if r.tested else ' (not tested)'}" for r in ranges]
        if texts:
            lines.append(f"  {name}: {', '.join(texts)}")
    return lines


def _assignments(fit: Fit, values: Floats) -> str:
    parameters = fit.candidate.parameters
    return ", ".join(f"{p.name} = {short(v, p.dimension)}" for p, v in zip(parameters, values, strict=True))


def _indeterminacy(fit: Fit) -> str:
    """Return what equally good parameters leave open, the rule that chose one, and the test that decides."""
    first = fit.disagreements[0]
    at = f"{first.probe.name} at {first.probe.mode.measure} {first.measure:.4g}"
    stresses = [readable(float(s), "Pa") if np.isfinite(s) else "no stress" for s in first.stress]
    others = f"{len(fit.rivals)} other sets of parameters fit" if len(fit.rivals) > 1 else "another set fits"
    return (
        f"{others} these tests equally well: {at} would have {stresses[0]} by this one, {' or '.join(stresses[1:])} by "
        f"{'others' if len(fit.rivals) > 1 else 'the other'}. This one is stable in more modes, or else closer to the "
        f"neo-Hookean law; a test in {first.probe.name} decides"
    )


def _place(checked: Range) -> str:
    return "within the tested range" if checked.tested else "in a mode that was not tested"


def ranking(outcomes: Sequence[CheckedFit]) -> list[tuple[str, ...]]:
    """Return the rows of the comparison, best first: law, parameters, R², scatter, AICc, difference, weight, checks."""
    known = outcomes[0].fit.deviations_known
    ordered = sorted(outcomes, key=lambda outcome: outcome.fit.aicc)
    differences = np.array([o.fit.aicc for o in ordered]) - ordered[0].fit.aicc
    weights = np.exp(-np.nan_to_num(differences, nan=0.0, posinf=np.inf) / 2)
    rows: list[tuple[str, ...]] = []
    for outcome, difference, weight in zip(ordered, differences, weights / weights.sum(), strict=True):
        fit = outcome.fit
        stable = _extent([r for r in outcome.ranges if r.lost_at is not None])
        elliptic = _extent([r for r in outcome.ranges if r.not_elliptic_at is not None])
        rows.append(
            (
                outcome.label,
                str(len(fit.values)),
                f"{fit.r_squared:.5f}",
                f"{fit.scatter:.3g}" if known else readable(fit.scatter, "Pa"),
                f"{fit.aicc:.1f}" if np.isfinite(fit.aicc) else "too few data",
                f"{difference:.1f}" if np.isfinite(difference) else "",
                f"{weight:.2g}" if np.isfinite(difference) else "",
                stable,
                elliptic,
            )
        )
    return rows


def _extent(lost: Sequence[Range]) -> str:
    """Return where a condition holds, from the ranges in which it is lost."""
    return "yes" if not lost else "not in the tests" if any(r.tested for r in lost) else "in the tests"


def _correlations(fit: Fit) -> str:
    return correlations([p.name for p in fit.candidate.parameters], fit.correlation)


def rounded(value: float, dimension: Dimension) -> float | str:
    """Return a value (SI) with four digits in the form of a job."""
    return quantity(float(f"{value:.4g}"), dimension)
