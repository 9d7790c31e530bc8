"""Meshes of balls in images and surfaces: cells, edges, quality and time of ``hpcinv mesh from-image``.

``python3 -m uv run python benchmarks/image_meshes.py``. The images are made here: a ball of radius 50 mm in voxels of
1 mm, and a hollow one with a wall of 4 mm.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyvista
import SimpleITK

RADIUS, WALL = 50.0, 4.0  # mm


def write_images(directory: Path) -> None:
    axis = np.arange(120) - 59.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    distance = np.sqrt(x**2 + y**2 + z**2)
    hollow = (distance < RADIUS) & (distance > RADIUS - WALL)
    for name, mask in (("ball", distance < RADIUS), ("hollow", hollow)):
        SimpleITK.WriteImage(SimpleITK.GetImageFromArray(mask.astype(np.uint8)), str(directory / f"{name}.nii.gz"))
    pyvista.Sphere(radius=RADIUS, theta_resolution=200, phi_resolution=200).save(directory / "ball.stl")


def row(directory: Path, *options: str) -> str:
    """A row of the table, from what the command prints."""
    kind = "from-surface" if options[0].endswith(".stl") else "from-image"
    command = [sys.executable, "-m", "hpcinv", "mesh", kind, options[0], "body.msh", *options[1:]]
    begin = time.monotonic()
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True)
    seconds, said = time.monotonic() - begin, done.stdout + done.stderr
    matches = [
        re.search(pattern, said)
        for pattern in (
            r"(\d+) cells and",
            r"edges from (.*?) \(without",
            r"Jacobian of cells: (\S+) at worst, (\S+) at the first",
            r", ([+-]\d+\.\d+%) in the mesh",
        )
    ]
    cells, edges, quality, volume = (match.groups() if match else ("?",) for match in matches)
    told = f"{int(cells[0]):,} | {edges[0]} | {', '.join(quality)} | {volume[0]} | {seconds:.0f} s"
    return f"| `{' '.join(options)}` | {told} |"


def main() -> None:
    label = ("--label", "body=1")
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        write_images(directory)
        print("| options | cells | edges | scaled Jacobian: worst, first percentile | volume | time |")
        print("|---|---|---|---|---|---|")
        for size in ("4 mm", "2.7 mm"):
            print(row(directory, "ball.nii.gz", *label, "--size", size), flush=True)
        print(row(directory, "ball.stl", "--unit", "mm", "--size", "2.7 mm"), flush=True)
        for grade in (("--grade", "1"), (), ("--grade", "4")):
            print(row(directory, "hollow.nii.gz", *label, "--size", "8 mm", *grade), flush=True)


if __name__ == "__main__":
    main()
