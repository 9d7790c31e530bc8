"""Sphinx directive ``stress-plot NAME``: the stress of a material law with the values of its example.

Laws without fibres are drawn in uniaxial, equibiaxial and planar tension with stress-free lateral directions. Laws
with fibres are drawn as incompressible, in uniaxial tension along the first family and normal to all families; families
after the first lie along the second axis. The lateral stretch minimises the energy, so that its stress vanishes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from docutils import nodes
from scipy.optimize import minimize_scalar
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.functions import numpy_functions
from hpcinv.physics.materials import MaterialLaw, laws
from hpcinv.studies.fitting.homogeneous import MODES, Response, _constants

matplotlib.use("Agg")
DIRECTORY = "_plots"


def curves(law: MaterialLaw, stretches: np.ndarray) -> dict[str, np.ndarray]:
    """Return the nominal stress (n,) in Pa at stretches (n,), by the name of the test."""
    if law.families:
        return {
            "uniaxial, along the first fibres": _along(law, stretches, 0),
            "uniaxial, normal to all fibres": _along(law, stretches, 2),
        }
    response = Response(law, [])
    return {
        name: response.stress(MODES[name], stretches, np.empty(0))[0] for name in ("uniaxial", "equibiaxial", "planar")
    }


def _along(law: MaterialLaw, stretches: np.ndarray, axis: int) -> np.ndarray:
    """Return the nominal stress in tension along an axis of an incompressible law whose fibres lie along axes."""
    energy = Expression(law.own_formula)
    constants, functions = _constants(law), numpy_functions()
    axes = {name: min(i, 1) for i, name in enumerate(law._families_by_formula_name())}

    def psi(stretch: float, lateral: float) -> float:
        square = np.insert([lateral**2, 1 / (stretch * lateral) ** 2], axis, stretch**2)
        I1 = square.sum()
        I2 = (I1**2 - (square**2).sum()) / 2
        values: dict[str, Any] = {**constants, "J": 1.0, "I1": I1, "I2": I2, "I1_bar": I1, "I2_bar": I2}
        for name, i in axes.items():
            values |= {f"I4_{name}": square[i], f"I5_{name}": square[i] ** 2}
            values |= {f"I8_{name}_{other}": 0.0 for other in axes if other != name}
        return float(energy.apply({name: values[name] for name in energy.names}, functions))

    def relaxed(stretch: float) -> float:
        found = minimize_scalar(lambda x: psi(stretch, x), bounds=(0.3, 2.0), method="bounded", options={"xatol": 1e-9})
        return float(found.fun)

    step = 1e-4
    return np.array([(relaxed(x + step) - relaxed(x - step)) / (2 * step) for x in stretches])


def draw(name: str, path: Path) -> None:
    """Write the plot of a law as SVG."""
    from matplotlib.figure import Figure

    kind = laws()[name]
    law = kind.model_validate(kind.example)
    stretches = np.linspace(1.0, 1.15 if law.families else 1.8, 61)
    figure = Figure(figsize=(5, 3.2), layout="constrained")
    axes = figure.subplots()
    for label, stress in curves(law, stretches).items():
        axes.plot(stretches, stress / 1e3, label=label)
    axes.set(xlabel="stretch", ylabel="nominal stress in kPa", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, metadata={"Date": None})


class StressPlot(SphinxDirective):
    """The plot of one law."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        directory = Path(self.env.srcdir) / DIRECTORY
        directory.mkdir(exist_ok=True)
        draw(name, directory / f"{name}.svg")
        return [nodes.image(uri=f"/{DIRECTORY}/{name}.svg", alt=f"Nominal stress of {name} over stretch")]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("stress-plot", StressPlot)
    return {"parallel_read_safe": True}
