"""Unknowns and CPU time of shells and of solids at equal error: ``python benchmarks/shells_against_solids.py``.

The solid has the hexahedra of the shell's layer, of degree 2 with full integration. Meshes have 2, 4, 8, … cells along
a side until a quantity is within 1 % of its value on a finer shell. Times are of one warm process.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.job.sections import Shell
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.midsurface import thicken
from hpcinv.mesh.source import Floats

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from helpers.sheets import sheet  # noqa: E402

ERROR = 0.01
DIVISIONS = (2, 4, 8, 16, 32)
LAW = {"law": "neo-hookean", "young": 1e6, "poisson": 0.3}
CERTIFICATE = {"level": "off", "round_trip": "off", "stability": False, "estimate": False, "overlap": False}


@dataclasses.dataclass(frozen=True)
class Scene:
    """A shell on a map of the unit square, ``wide`` cells for each cell along the second axis."""

    place: Callable[[Floats, Floats], list[Floats]]
    thickness: float
    wide: int
    job: Mapping[str, Any]


def _bellows(s: Floats, t: Floats) -> list[Floats]:
    radius = 1 + 0.15 * np.cos(2 * np.pi * s)
    return [radius * np.cos(np.pi / 2 * t), radius * np.sin(np.pi / 2 * t), 0.5 * s]


SCENES = {
    "sagging sheet": Scene(
        lambda s, t: [s, 0.6 * t, 0 * s],
        0.01,
        2,
        {
            "analysis": "inverse",
            "effects": [
                {"effect": "gravity", "density": 1000, "acceleration": [0, 0, -0.05], "density_in": "reference"}
            ],
            "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
            "quantities": [{"name": "q", "of": "uz", "at": [1, 0.3, 0]}],
        },
    ),
    "pinched ring": Scene(
        lambda s, t: [np.sin(np.pi / 2 * s), 0.2 * t, np.cos(np.pi / 2 * s)],
        0.01,
        4,
        {
            "analysis": "forward",
            "effects": [{"effect": "traction", "region": "x0", "traction": [0, 0, -20], "area_in": "reference"}],
            "supports": [
                {"region": "x0", "fix": ["x"]},
                {"region": "x1", "fix": ["z"]},
                {"region": "y0", "fix": ["y"]},
            ],
            "quantities": [{"name": "q", "of": "uz", "at": [0, 0, 1]}],
        },
    ),
    "inflated bellows": Scene(
        _bellows,
        0.01,
        2,
        {
            "analysis": "inverse",
            "effects": [{"effect": "pressure", "region": "inner", "pressure": 40}],
            "supports": [
                {"region": "x0", "fix": ["x", "y", "z"]},
                {"region": "y0", "fix": ["y"]},
                {"region": "y1", "fix": ["x"]},
            ],
            "quantities": [{"name": "q", "of": "uz", "on": "x1", "reduce": "mean", "over": "current"}],
        },
    ),
}


def solved(scene: Scene, n: int, folder: Path, *, as_solid: bool) -> tuple[float, int, float]:
    """Return the quantity (m), the number of unknowns, and the CPU seconds of a run."""
    path = folder / f"{n}.msh"
    rows = max(n // scene.wide, 1)
    surface = sheet(path, n, rows, lambda s, t: np.column_stack(scene.place(s, t)))
    mesh: dict[str, Any] = {"file": str(path)}
    if as_solid:
        body = thicken(surface, Shell(thickness=scene.thickness))
        solid = dataclasses.replace(body, midsurface=None, shell=None, slenderness=1.0)
        save_msh(path, solid, solid.points)
    else:
        save_msh(path, surface, surface.points)
        mesh["shell"] = {"thickness": scene.thickness}
    started = time.process_time()
    job = {"mesh": mesh, "material": LAW, "certificate": CERTIFICATE, **scene.job}
    result = hpcinv.run(job, progress=False)
    seconds = time.process_time() - started
    return float(result.quantities["q"]), 3 * len(result.solutions[0].u), seconds


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--finest", type=int, default=32, help="cells along a side (default 32)")
    finest = parser.parse_args().finest
    print("| scene | body | cells along a side | value, mm | error, % | unknowns | CPU s |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for scene_name, scene in SCENES.items():
            reference = solved(scene, finest * 3 // 2, Path(name), as_solid=False)[0]
            for body in ("shell", "solid"):
                for n in (2, *(n for n in DIVISIONS if n <= finest)):  # the first one is compiled
                    try:
                        value, unknowns, seconds = solved(scene, n, Path(name), as_solid=body == "solid")
                    except HpcinvError as failure:
                        print(f"{scene_name}, {body}, {n}: {str(failure).splitlines()[0]}", file=sys.stderr)
                        continue
                    error = abs(value / reference - 1)
                    if error <= ERROR:
                        break
                print(
                    f"| {scene_name} | {body} | {n} | {1e3 * value:.4g} | {100 * error:.2g} | {unknowns:,}"
                    f" | {seconds:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
