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
from pathlib import Path

from shell_scenes import SCENES, Scene

import hpcinv
from hpcinv.errors import HpcinvError
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.midsurface import thicken

ERROR = 0.01
DIVISIONS = (2, 4, 8, 16, 32)
NAMES = ("sagging sheet", "pinched ring", "inflated bellows", "vessel with fibres")
CERTIFICATE = {"level": "off", "round_trip": "off", "stability": False, "estimate": False, "overlap": False}


def solved(scene: Scene, n: int, folder: Path, *, as_solid: bool) -> tuple[float, int, float]:
    """Return the quantity (m), the number of unknowns, and the CPU seconds of a run."""
    path = folder / f"{n}.msh"
    surface = scene.save(path, n)
    job = scene.as_job(path) | {"certificate": CERTIFICATE}
    if as_solid:
        body = thicken(surface, Shell(**scene.shell))
        solid = dataclasses.replace(body, midsurface=None, shell=None, slenderness=1.0)
        save_msh(path, solid, solid.points)
        job["mesh"] = {"file": str(path)}
    started = time.process_time()
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
        for scene_name in NAMES:
            scene = SCENES[scene_name]
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
