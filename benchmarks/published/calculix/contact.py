"""Decks of CalculiX for two blocks in contact, surface to surface, on our meshes of hexahedra."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import parse
from hpcinv.mesh.body import read_source
from hpcinv.mesh.source import Floats, Ints, MeshSource

from . import deck

FACES = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))
"""Vertices of the faces S1 to S6 of C3D8."""


@dataclass(frozen=True)
class PressedBlocks:
    """Two blocks, ``lower`` and ``upper``; the upper one is moved onto the lower one.

    Attributes:
        moduli: Young's moduli by the names of volumes; all have one Poisson's ratio.
        down: displacement of ``z1`` along -z; ``z0`` is held.
        stiffness: pressure over overlap of CalculiX, whose contact has no multipliers.
    """

    source: MeshSource
    moduli: Mapping[str, float]
    poisson: float
    down: float
    stiffness: float

    def write(self, path: Path) -> None:
        """Write the deck: St Venant–Kirchhoff material, large displacements."""
        source, cells = self.source, deck.cells_of(self.source)
        lines = ["*NODE, NSET=ALL"]
        lines += [f"{n}, {x:.12e}, {y:.12e}, {z:.12e}" for n, (x, y, z) in enumerate(source.points, 1)]
        lines.append("*ELEMENT, TYPE=C3D8, ELSET=BODY")
        lines += [", ".join(str(entry) for entry in (number, *(cell + 1))) for number, cell in enumerate(cells, 1)]
        for name, modulus in self.moduli.items():
            [group] = [g for g in source.groups if g.name == name and g.dim == 3]
            lines += [f"*ELSET, ELSET={name.upper()}", *(f"{member + 1}," for member in group.members)]
            lines += [f"*MATERIAL, NAME={name.upper()}", "*ELASTIC", f"{modulus:.12e}, {self.poisson}"]
            lines.append(f"*SOLID SECTION, ELSET={name.upper()}, MATERIAL={name.upper()}")
        for name in ("bottom", "top"):
            lines += [f"*SURFACE, NAME={name.upper()}, TYPE=ELEMENT"]
            lines += [f"{cell + 1}, S{face + 1}" for cell, face in self._faces(cells, name)]
        lines += ["*SURFACE INTERACTION, NAME=PUSH", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"]
        lines += [f"{self.stiffness:.12e}", "*CONTACT PAIR, INTERACTION=PUSH, TYPE=SURFACE TO SURFACE", "BOTTOM, TOP"]
        lines += ["*NSET, NSET=UP", *(f"{n + 1}," for n in np.unique(deck.facets(source, "z1")))]
        lines += ["*NSET, NSET=HELD", *(f"{n + 1}," for n in np.unique(deck.facets(source, "z0")))]
        lines += ["*BOUNDARY", "HELD, 1, 3", "*STEP, NLGEOM, INC=1000", "*STATIC", "0.25, 1."]
        lines += ["*BOUNDARY", "UP, 1, 2", f"UP, 3, 3, {-self.down:.12e}", "*NODE PRINT, NSET=ALL", "U"]
        lines += ["*NODE PRINT, NSET=HELD, TOTALS=ONLY", "RF", "*END STEP", ""]
        path.write_text("\n".join(lines))

    def _faces(self, cells: Ints, name: str) -> list[tuple[int, int]]:
        """Return cell and number of the face of each facet of a surface."""
        places = {
            frozenset(cell[list(face)].tolist()): (number, k)
            for number, cell in enumerate(cells)
            for k, face in enumerate(FACES)
        }
        return [places[frozenset(facet.tolist())] for facet in deck.facets(self.source, name)]


MODULI = {"lower": 3.0, "upper": 1.0}  # Pa
POISSON, DOWN = 0.3, 0.02
STIFFNESS = 1e4
"""Pressure over overlap (Pa/m) of CalculiX, 3,000 times the larger modulus over 1 m. Raised, forces of
both differ less, by a share of 1.5/stiffness, and more of its iterations fail."""


def compared_blocks(parameters: Mapping[str, Any], directory: Path) -> tuple[float, float]:
    """Press two blocks (``meshes/two_blocks.py``) onto each other in both programs.

    Returns:
        Differences of the force along z, relative to ours, and of displacements, relative to our largest one.
    """
    material = {name: {"law": "st-venant-kirchhoff", "young": E, "poisson": POISSON} for name, E in MODULI.items()}
    data = {
        "analysis": "forward",
        "mesh": {
            "file": "../../../meshes/two_blocks.py",
            "parameters": {"hexahedra": True, "gap": 1e-9, **parameters},
        },
        "material": material,
        "discretisation": {"displacement": 1},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -DOWN]}],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}],
        "certificate": "off",
    }
    job = parse(data, Path(__file__))
    source = read_source(job.mesh, job.resolve(job.mesh.file))
    solution = hpcinv.run(job, MPI.COMM_SELF, progress=False).solutions[0]
    nodes = cKDTree(solution.current_nodes - solution.u).query(source.points)[1]
    ours, force = solution.u[nodes], solution.contacts[0].force[2]
    PressedBlocks(source, MODULI, POISSON, DOWN, STIFFNESS).write(directory / "blocks.inp")
    subprocess.run(["ccx", "blocks"], cwd=directory, check=True, stdout=subprocess.DEVNULL)
    theirs = deck.displacements(directory / "blocks.dat")
    their_force = total_force(directory / "blocks.dat")[2]
    return abs(their_force / force - 1), float(np.abs(theirs - ours).max() / np.abs(ours).max())


def total_force(path: Path) -> Floats:
    """Return the last total force (3,) of a ``.dat`` file."""
    rows = path.read_text().split("total force")[-1].splitlines()[1:]
    return np.array(next(row for row in rows if row.strip()).split(), dtype=np.float64)
