"""Plot of tests and fitted laws."""

import io
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hpcinv.base.files.atomic import write_output
from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.units import readable
from hpcinv.errors import OutputError
from hpcinv.studies.fitting.fit_report import CheckedFit
from hpcinv.studies.fitting.homogeneous import Mode
from hpcinv.studies.fitting.measurements import Test

FORMATS = (".png", ".pdf", ".svg")
_POINTS = 200
_SIZE, _RESOLUTION = (5.0, 4.0), 150  # inches of a panel, dots per inch


def check_format(path: Path) -> None:
    """Raise ``OutputError`` if a plot cannot have this name."""
    if path.suffix not in FORMATS:
        raise OutputError(f"{path}: a plot ends in {', '.join(FORMATS)}")


def plot(path: Path, outcomes: Sequence[CheckedFit]) -> None:
    """Write a plot with a panel for each mode: points of the tests, and a line for each law.

    Raises:
        OutputError: it cannot be written.
    """
    from matplotlib.figure import Figure

    panels: dict[tuple[str, bool], list[Test]] = {}
    for test in outcomes[0].fit.tests:
        panels.setdefault((test.mode.name, test.is_cauchy), []).append(test)
    figure = Figure(figsize=(_SIZE[0] * len(panels), _SIZE[1]), layout="constrained")
    for axes, (key, tests) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        size, unit = _unit(max(float(np.abs(t.stress).max()) for t in tests))
        for test, marker in zip(tests, itertools.cycle("osD^v"), strict=False):
            errors = None if test.deviation is None else test.deviation / size
            axes.errorbar(
                test.measure, test.stress / size, errors, fmt=marker, ms=4, mfc="none", color="black", label=test.name
            )
        axes.legend(fontsize="small")
        mode, cauchy = tests[0].mode, key[1]
        low = min(mode.rest_measure, *(float(t.measure.min()) for t in tests))
        high = max(mode.rest_measure, *(float(t.measure.max()) for t in tests))
        measure = np.linspace(low, high, _POINTS)
        lines = [
            axes.plot(measure, _stress(outcome, mode, measure, cauchy=cauchy) / size, style)[0]
            for outcome, style in zip(outcomes, _styles(), strict=False)
        ]
        kind = "pressure" if mode.is_volumetric else "Cauchy stress" if cauchy else "nominal stress"
        axes.set(title=mode.name, xlabel=mode.measure, ylabel=f"{kind} [{unit}]")
        axes.grid(alpha=0.3)
    names = [f"{outcome.label}, R² {outcome.fit.r_squared:.4f}" for outcome in outcomes]
    figure.legend(lines, names, loc="outside lower center", ncols=min(len(names), 2 * len(panels)), fontsize="small")
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix[1:], dpi=_RESOLUTION)
    write_output(path, content.getvalue())


def _stress(outcome: CheckedFit, mode: Mode, measure: Floats, *, cauchy: bool) -> Floats:
    return outcome.fit.response.stress(mode, measure, outcome.fit.values, cauchy=cauchy)[0]


def _styles() -> Iterator[str]:
    """Yield a different style for each line: ten colours, then the same ones dashed, and so on."""
    return (f"C{number}{dashes}" for dashes in itertools.cycle(("-", "--", ":")) for number in range(10))


def _unit(value: float) -> tuple[float, str]:
    """Return a unit of stress for values of this size, in Pa and by name."""
    unit = readable(value, "Pa").split()[1]
    return {"mPa": 1e-3, "Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9}[unit], unit
