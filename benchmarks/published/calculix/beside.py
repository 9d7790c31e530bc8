"""CalculiX and hpcinv on equal meshes: ``python -m benchmarks.published.calculix.beside``.

Each body is loaded by both. Then our inverse analysis takes the body that CalculiX has loaded, and must give the mesh
back. Its file has 7 digits, the bound of both differences. C3D4, C3D8 and C3D10 are our linear and quadratic cells with
the same quadrature; of C3D20 only the limit of refinement agrees with our 27-node cells.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.mesh.body import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.readers import read_msh
from hpcinv.mesh.source import Floats, MeshSource

from . import deck

FOLDER = Path(__file__).parent
RUBBER = {"material": {"law": "isochoric-neo-hookean", "mu": "1 MPa", "kappa": "4 MPa"}}
TETRAHEDRA = {"mesh.parameters.hexahedra": False}
CASES: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("block", {}),
    ("block", {"material": {"law": "mooney-rivlin", "c1": "0.3 MPa", "c2": "0.2 MPa", "d1": "2 MPa"}}),
    ("block", TETRAHEDRA),
    ("block", {**TETRAHEDRA, "discretisation.displacement": 2}),
    ("beam", {}),
    ("../cook/cook", {**RUBBER, "mesh.parameters.n": 8, "discretisation.displacement": 1}),
    ("../cook/cook", {**RUBBER, **TETRAHEDRA, "mesh.parameters.n": 8}),
    ("../cook/cook", {**RUBBER, "mesh.parameters.n": 4}),
    ("../cook/cook", {**RUBBER, "mesh.parameters.n": 8}),
    ("../cook/cook", {**RUBBER, "mesh.parameters.n": 16}),
)


@dataclass(frozen=True)
class CalculixComparison:
    """One body, loaded by both.

    Attributes:
        ours, theirs: displacement (m) of the quantity's point.
        back: largest distance (m) of our unloaded shape of their loaded body from the mesh; ``None`` for C3D20, which
            has other shape functions.
        seconds: of our run and of theirs.
    """

    title: str
    ours: Floats
    theirs: Floats
    back: float | None
    seconds: tuple[float, float]

    @property
    def difference(self) -> float:
        """Largest difference relative to the displacement."""
        return float(abs(self.ours - self.theirs).max() / np.linalg.norm(self.ours))

    @property
    def row(self) -> str:
        """Row of the printed table."""
        ours, theirs = (", ".join(f"{x:.7g}" for x in value) for value in (self.ours, self.theirs))
        back = "-" if self.back is None else f"{self.back:.1e}"
        times = " | ".join(f"{s:.1f}" for s in self.seconds)
        return f"| {self.title} | {ours} | {theirs} | {self.difference:.1e} | {back} | {times} |"


def compared(name: str, changes: Mapping[str, Any], directory: Path) -> CalculixComparison:
    """Load one body with CalculiX and with us, and unload its result."""
    path = (FOLDER / f"{name}.yaml").resolve()
    data = assigned(read_yaml(path), {**changes, "certificate": {"level": "quick"}})
    data["quantities"][0]["of"] = "displacement"
    job = parse(assigned(data, {"mesh.geometry_degree": data["discretisation"]["displacement"]}), path)
    source = read_source(job.mesh, job.resolve(job.mesh.file))
    nodes = deck.write(directory / "body.inp", source, job)
    begin = time.perf_counter()
    subprocess.run(["ccx", "body"], cwd=directory, check=True, stdout=subprocess.DEVNULL)
    end = time.perf_counter()
    loaded = source.points.copy()
    loaded[nodes] += deck.displacements(directory / "body.dat")
    [quantity] = job.quantities
    node = np.linalg.norm(source.points - np.array(quantity.at), axis=1).argmin()
    ours, seconds = _solved(job, directory / "forward")
    element = deck.element(source)
    back = None if element == "C3D20" else _unloaded(data, path, source, loaded, directory)
    title = f"{job.job} {data['material']['law']} {element}, {len(source.cells)} cells"
    return CalculixComparison(title, ours, loaded[node] - source.points[node], back, (seconds, end - begin))


def _solved(job: Job, directory: Path) -> tuple[Floats, float]:
    result = hpcinv.run(job, MPI.COMM_SELF, directory=directory, progress=False)
    return np.atleast_1d(result.quantities[job.quantities[0].name]), result.statistics["timings"]["total"]


def _unloaded(data: Mapping[str, Any], path: Path, source: MeshSource, loaded: Floats, directory: Path) -> float:
    """Return the largest distance of the unloaded shape from the mesh that was loaded."""
    save(directory / "loaded.msh", source, loaded)
    inverse = {"analysis": "inverse", "mesh": {"file": str(directory / "loaded.msh")}, "output.mesh": ["msh"]}
    job = parse(assigned(data, {**inverse, "quantities": []}), path)
    hpcinv.run(job, MPI.COMM_SELF, directory=directory / "inverse", progress=False)
    shape = read_msh(directory / "inverse" / "shape.msh")
    return float(abs(shape.points - source.points).max())


def main() -> None:
    if shutil.which("ccx") is None:
        sys.exit("CalculiX is not installed (ccx; in Debian the package calculix-ccx): nothing to compare")
    print("| body | ours (m) | CalculiX (m) | difference | unloaded shape (m) | s, ours | s, CalculiX |")
    print("|---|---|---|---|---|---|---|")
    for name, changes in CASES:
        with tempfile.TemporaryDirectory() as directory:
            print(compared(name, changes, Path(directory)).row, flush=True)


if __name__ == "__main__":
    main()
