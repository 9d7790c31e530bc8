"""Moduli of 200 cells from one observed rest shape, by PyTorch.

A block of gel with a stiffer inclusion is loaded by its weight and a pressure. The loaded shape is given, the nodes of
the rest shape are observed, and a modulus is sought for each cell:

    python docs/learning/moduli.py          prints the errors of the moduli, with and without noise
    python docs/learning/moduli.py FILE     draws them, too
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyvista

from hpcinv.studies.learning.differentiable_job import DifferentiableJob

MODULI = "material.mu"
SIZE = np.array([0.1, 0.05, 0.04])  # m
NOISE = 2e-5
"""standard deviation of the observed coordinates, m"""


class Problem:
    """The block with some cells along each axis.

    Attributes:
        job: the rest shape (n, 3) as a function of the moduli (kPa) of the cells.
        truth: moduli of the cells, kPa.
        neighbours: pairs of cells with a common face, (pairs, 2).
        observed: nodes of the rest shape with these moduli, (n, 3) in m.
    """

    def __init__(self, directory: Path, counts: tuple[int, int, int] = (10, 5, 4)) -> None:
        axes = [np.linspace(0, length, count + 1) for length, count in zip(SIZE, counts, strict=True)]
        grid = pyvista.StructuredGrid(*np.meshgrid(*axes, indexing="ij")).cast_to_unstructured_grid()
        middles = grid.cell_centers().points
        self.truth = np.where(np.linalg.norm(middles - [0.065, 0.025, 0.02], axis=1) < 0.018, 15.0, 5.0)
        grid.cell_data["mu"] = self.truth
        grid.save(directory / "block.vtu")
        steps = np.linalg.norm((middles[:, None] - middles[None]) / (SIZE / counts), axis=2)
        self.neighbours = np.argwhere(np.triu(np.abs(steps - 1) < 1e-6))
        self.middles = middles
        job = {
            "analysis": "inverse",
            "mesh": {"file": str(directory / "block.vtu")},
            "regions": {"held": "x < 1e-6 m", "end": "x > 0.099999 m"},
            "material": {"law": "neo-hookean", "mu": {"data": "mu", "unit": "kPa"}, "lam": "20 kPa"},
            "effects": [
                {"effect": "gravity", "acceleration": [0, 0, "-9.81 m/s^2"], "density": "1000 kg/m^3"},
                {"effect": "pressure", "region": "end", "pressure": "500 Pa"},
            ],
            "supports": [{"region": "held", "fix": ["x", "y", "z"]}],
            "discretisation": {"displacement": 1, "formulation": "displacement"},
        }
        self.job = DifferentiableJob(job, [MODULI])
        (self.observed,) = self.job.evaluate([self.truth])

    def misfit(self, moduli: Any, observed: Any) -> tuple[float, Any]:
        """Return ``Σ |X - observed|² / (2 sd²)``, and its gradient by the moduli."""
        (found,) = self.job.evaluate([moduli])
        (gradient,) = self.job.gradient([moduli], [(found - observed) / NOISE**2])
        return float(((found - observed) ** 2).sum()) / (2 * NOISE**2), gradient

    def slopes(self) -> Any:
        """Return the derivatives of the coordinates by logarithms of the moduli, (3 n, cells)."""
        directions = np.diag(self.truth)
        return np.column_stack([self.job.along([self.truth], [d])[0].ravel() for d in directions])


def found_moduli(problem: Problem, observed: Any, smoothness: float, iterations: int = 300) -> Any:
    """Return the moduli that minimise the misfit and ``smoothness · Σ |log mu_i - log mu_j|`` of neighbours.

    The second term is rounded below a difference of 0.05, so that it has a gradient.
    """
    import torch

    from hpcinv.torch import function

    solve: Callable[..., Any] = function(problem.job)
    first, second = torch.as_tensor(problem.neighbours.T)
    wanted = torch.as_tensor(observed)
    logarithms = torch.full((len(problem.truth),), float(np.log(7.0)), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([logarithms], max_iter=iterations, history_size=50, line_search_fn="strong_wolfe")

    def objective() -> Any:
        optimiser.zero_grad()
        misfit = ((solve(torch.exp(logarithms))[0] - wanted) ** 2).sum() / (2 * NOISE**2)
        steps = logarithms[first] - logarithms[second]
        value = misfit + smoothness * (torch.sqrt(steps**2 + 0.05**2) - 0.05).sum()
        value.backward()
        return value

    optimiser.step(objective)
    return torch.exp(logarithms).detach().numpy()


def main(picture: str = "") -> None:
    with tempfile.TemporaryDirectory() as directory:
        problem = Problem(Path(directory))
        noisy = problem.observed + np.random.default_rng(1).normal(scale=NOISE, size=problem.observed.shape)
        slopes = problem.slopes() / NOISE
        deviations = 100 * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
        median, most, largest = np.quantile(deviations, (0.5, 0.9, 1.0))
        print(f"deviations by the noise: median {median:.2g} %, 90 % below {most:.2g} %, largest {largest:.2g} %")
        cases = {"true": problem.truth}
        for title, observed, smoothness in (
            ("without noise", problem.observed, 0.0),
            ("noise of 20 µm, nothing assumed", noisy, 0.0),
            ("noise of 20 µm, few edges assumed", noisy, 2.0),
        ):
            cases[title] = found_moduli(problem, observed, smoothness)
            error = np.abs(np.log(cases[title] / problem.truth))
            inclusion = problem.truth > 10
            median, most, largest = 100 * np.quantile(error, (0.5, 0.9, 1.0))
            print(
                f"{title}: median error {median:.2g} %, 90 % below {most:.2g} %, largest {largest:.3g} %;"
                f" inclusion {np.median(cases[title][inclusion]):.3g} kPa (true 15)"
            )
        if picture:
            draw(problem, cases, picture)


def draw(problem: Problem, cases: dict[str, Any], picture: str) -> None:
    """Draw the moduli in the layer of cells through the inclusion."""
    import matplotlib.pyplot as plt

    heights = problem.middles[:, 2]
    height = heights[np.abs(heights - 0.019).argmin()]
    layer = np.abs(heights - height) < 1e-9
    figure, axes = plt.subplots(1, len(cases), figsize=(13, 2.3), sharey=True, layout="constrained")
    for axis, (title, moduli) in zip(axes, cases.items(), strict=True):
        x, y = (1e3 * problem.middles[layer, i] for i in range(2))
        columns, rows = len(np.unique(x.round(6))), len(np.unique(y.round(6)))
        values = moduli[layer][np.lexsort((x, y))].reshape(rows, columns)
        drawn = axis.imshow(values, origin="lower", extent=(0, 100, 0, 50), vmin=3, vmax=17, cmap="viridis")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("x (mm)")
    axes[0].set_ylabel("y (mm)")
    figure.colorbar(drawn, ax=axes, label="mu (kPa)")
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
