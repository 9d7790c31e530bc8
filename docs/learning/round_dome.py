"""The loaded shape of a dome whose rest shape is round, by PyTorch with the nodes as inputs.

A dome of gel on a smooth floor bears its weight and a pressure inside. A half sphere as the loaded shape has a rest
shape that is not round. Here the given, loaded nodes move along their radii until each layer of nodes is a sphere at
rest:

    python docs/learning/round_dome.py         prints radii before and after
    python docs/learning/round_dome.py FILE    draws the shapes, too
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.studies.learning.differentiable_job import DifferentiableJob

NODES = "mesh.nodes"
MESH = Path(__file__).parents[2] / "meshes" / "thick_sphere.py"


class Problem:
    """The dome: an octant of a hollow sphere of 40 mm and 50 mm, since two planes of symmetry cut it.

    Attributes:
        job: the rest shape (n, 3) as a function of the loaded nodes (n, 3), in m.
        start: nodes of the half sphere.
        layers: number of the sphere of each node, (n,).
    """

    def __init__(self, radial: int = 2, along: int = 6) -> None:
        self.data: dict[str, Any] = {
            "analysis": "inverse",
            "mesh": {
                "file": str(MESH),
                "parameters": {
                    "inner": "40 mm",
                    "outer": "50 mm",
                    "radial": radial,
                    "along": along,
                    "hexahedra": True,
                },
            },
            "material": {"law": "neo-hookean", "mu": "3 kPa", "poisson": 0.45},
            "effects": [
                {"effect": "gravity", "acceleration": [0, 0, "-9.81 m/s^2"], "density": "1000 kg/m^3"},
                {"effect": "pressure", "region": "inner", "pressure": "300 Pa"},
            ],
            "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            "solver": {"tolerance": 1e-11},
        }
        self.job = DifferentiableJob(self.data, [NODES])
        (self.start,) = self.job.start
        radii = np.linalg.norm(self.start, axis=1)
        self.layers = np.rint((radii - 0.04) / 0.01 * radial).astype(int)

    def nodes(self, stretches: Any) -> Any:
        """Return the nodes at (1 + stretch) times their radius."""
        return self.start * (1 + stretches[:, None])

    def roundness(self, stretches: Any) -> tuple[float, Any]:
        """Return the sum of squared differences (mm²) of radii at rest from their layers' means, and its gradient."""
        (shape,) = self.job.evaluate([self.nodes(stretches)])
        radii = 1e3 * np.linalg.norm(shape, axis=1)
        differences = radii - self.means(radii)[self.layers]
        weights = 2e3 * (differences / radii * 1e3)[:, None] * shape
        (gradient,) = self.job.gradient([self.nodes(stretches)], [weights])
        return float((differences**2).sum()), (gradient * self.start).sum(axis=1)

    def means(self, radii: Any) -> Any:
        """Return the mean of values at the nodes of each layer."""
        return np.bincount(self.layers, radii) / np.bincount(self.layers)

    def radii_at_rest(self, stretches: Any) -> Any:
        """Return the radii (mm) of the nodes at rest."""
        return 1e3 * np.linalg.norm(self.job.evaluate([self.nodes(stretches)])[0], axis=1)


def found_stretches(problem: Problem, iterations: int = 100) -> Any:
    """Return the stretches of the radii with which the layers are round at rest."""
    import torch

    from hpcinv.torch import function

    solve = function(problem.job)
    start, layers = torch.as_tensor(problem.start), torch.as_tensor(problem.layers)
    counts = torch.bincount(layers)
    stretches = torch.zeros(len(start), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS(
        [stretches], max_iter=iterations, history_size=50, line_search_fn="strong_wolfe", tolerance_change=0.0
    )

    def objective() -> Any:
        optimiser.zero_grad()
        radii = 1e3 * torch.linalg.norm(solve(start * (1 + stretches[:, None]))[0], dim=1)
        means = torch.zeros(len(counts), dtype=torch.float64).index_add(0, layers, radii) / counts
        value = ((radii - means[layers]) ** 2).sum()
        value.backward()
        return value

    optimiser.step(objective)
    return stretches.detach().numpy()


def loaded_again(problem: Problem, stretches: Any) -> Any:
    """Return the nodes (n, 3) of round layers at rest of the found radii, loaded by a run forward.

    On their spheres they are where the rest shape has them.
    """
    (shape,) = problem.job.evaluate([problem.nodes(stretches)])
    radii = np.linalg.norm(shape, axis=1)
    round_shape = shape * (problem.means(radii)[problem.layers] / radii)[:, None]
    with DifferentiableJob(problem.data | {"analysis": "forward"}, [NODES]) as forward:
        (loaded,) = forward.evaluate([round_shape])
    return loaded


def main(picture: str = "") -> None:
    problem = Problem()
    stretches = np.zeros(len(problem.start))
    found = found_stretches(problem)
    for title, moved in (("half sphere", stretches), ("found shape", found)):
        radii = problem.radii_at_rest(moved)
        outer = radii[problem.layers == problem.layers.max()]
        deviation = np.abs(radii - problem.means(radii)[problem.layers]).max()
        print(f"{title}: outer radius at rest {outer.min():.4f} to {outer.max():.4f} mm, off by {deviation:.2g} mm")
    distance = np.linalg.norm(loaded_again(problem, found) - problem.nodes(found), axis=1).max()
    print(f"loaded by a run forward, round layers are within {1e6 * distance:.2g} µm of the found shape")
    if picture:
        draw(problem, found, picture)


def draw(problem: Problem, found: Any, picture: str) -> None:
    """Draw inner and outer surface in the plane y = 0, before and after."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), sharey=True, layout="constrained")
    cut = np.abs(problem.start[:, 1]) < 1e-9
    for axis, title, moved in (
        (axes[0], "half sphere as the loaded shape", np.zeros(len(found))),
        (axes[1], "found loaded shape", found),
    ):
        loaded = problem.nodes(moved)
        (rest,) = problem.job.evaluate([loaded])
        for layer in (0, problem.layers.max()):
            rows = np.flatnonzero(cut & (problem.layers == layer))
            rows = rows[np.argsort(np.arctan2(problem.start[rows, 2], problem.start[rows, 0]))]
            radius = problem.means(1e3 * np.linalg.norm(rest, axis=1))[layer]
            angles = np.linspace(0, np.pi / 2, 100)
            axis.plot(radius * np.cos(angles), radius * np.sin(angles), color="0.7", lw=5, label="circle" * (not layer))
            for nodes, colour, name in ((loaded, "tab:orange", "loaded"), (rest, "tab:blue", "at rest")):
                axis.plot(*(1e3 * nodes[rows][:, [0, 2]].T), ".-", color=colour, label=name * (not layer))
        axis.set_aspect("equal")
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("x (mm)")
        axis.legend(fontsize=8)
    axes[0].set_ylabel("z (mm)")
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(*sys.argv[1:])
