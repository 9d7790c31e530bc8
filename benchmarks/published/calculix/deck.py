"""Decks of CalculiX from our meshes and jobs, and the displacements that it prints."""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.physics.effects.traction import Traction
from hpcinv.physics.materials.isochoric_neo_hookean import IsochoricNeoHookean
from hpcinv.physics.materials.mooney_rivlin import MooneyRivlin

RESIDUAL = 1e-9
"""Largest residual of CalculiX, relative to the mean nodal force. Larger: fewer digits that both share."""

CORNERS = {"tetrahedron": (0, 1, 2, 3), "hexahedron": (0, 1, 3, 2, 4, 5, 7, 6)}  # vertices in the order of CalculiX
EDGES = {
    "tetrahedron": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hexahedron": (*pairwise((0, 1, 2, 3, 0)), *pairwise((4, 5, 6, 7, 4)), *((i, i + 4) for i in range(4))),
}
ELEMENTS = {
    ("tetrahedron", 1): "C3D4",
    ("tetrahedron", 2): "C3D10",
    ("hexahedron", 1): "C3D8",
    ("hexahedron", 2): "C3D20",
}
SHARES = {3: (1 / 3, 0.0), 4: (1 / 4, 0.0), 6: (0.0, 1 / 3), 8: (-1 / 12, 1 / 3)}
"""Share of a corner and of a middle node in a uniform force on a flat facet with so many nodes (parallelograms)."""


def element(source: MeshSource) -> str:
    """Return the element of CalculiX with the nodes of our cells; of 27-node cells it has the first 20."""
    return ELEMENTS[source.kind, source.degree]


def write(path: Path, source: MeshSource, job: Job) -> Ints:
    """Write the deck of a job: one rubber, fixed surfaces, dead tractions; return the rows of nodes that it has."""
    cells = cells_of(source)
    nodes = np.unique(cells)
    lines = [
        "*NODE, NSET=ALL",
        *(f"{n + 1}, {x:.12e}, {y:.12e}, {z:.12e}" for n, (x, y, z) in zip(nodes, source.points[nodes], strict=True)),
    ]
    lines.append(f"*ELEMENT, TYPE={element(source)}, ELSET=BODY")
    for number, cell in enumerate(cells, 1):
        entries = [str(entry) for entry in (number, *(cell + 1))]
        lines += [
            ", ".join(entries[:15]) + ("," if len(entries) > 15 else ""),
            *filter(None, [", ".join(entries[15:])]),
        ]
    lines += ["*MATERIAL, NAME=RUBBER", *_material(job), "*SOLID SECTION, ELSET=BODY, MATERIAL=RUBBER", "*BOUNDARY"]
    for support in job.supports:
        for axis in support.fix or ():
            number = "xyz".index(axis) + 1
            lines += [f"{n + 1}, {number}, {number}" for n in np.intersect1d(facets(source, support.region), nodes)]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", "0.25, 1.", "*CONTROLS, PARAMETERS=FIELD"]
    lines += [f"{RESIDUAL}, {RESIDUAL}, 0.01, , 0.02, {RESIDUAL}", "*CLOAD"]
    for n, force in zip(nodes, _forces(source, job)[nodes], strict=True):
        lines += [f"{n + 1}, {axis}, {f:.12e}" for axis, f in enumerate(force, 1) if f]
    path.write_text("\n".join([*lines, "*NODE PRINT, NSET=ALL", "U", "*END STEP", ""]))
    return nodes


def displacements(path: Path) -> Floats:
    """Return the last displacements (n, 3) of a ``.dat`` file, in the order of node numbers."""
    rows = path.read_text().split("displacements")[-1].splitlines()[1:]
    return np.array([[float(x) for x in row.split()[1:]] for row in rows if len(row.split()) == 4])


def cells_of(source: MeshSource) -> Ints:
    """Return the nodes of each cell in the order of CalculiX."""
    corners = source.cells[:, list(CORNERS[source.kind])]
    if source.kind == "tetrahedron":
        a, b, c, d = (source.points[corners[:, i]] for i in range(4))
        left_handed = np.einsum("ni,ni->n", np.cross(b - a, c - a), d - a) < 0
        corners[left_handed] = corners[left_handed][:, [1, 0, 2, 3]]
    if source.degree == 1:
        return corners
    middles = _middles(source, source.cells)
    return np.hstack(
        [corners, [[middles[frozenset((cell[i], cell[j]))] for i, j in EDGES[source.kind]] for cell in corners]]
    )


def _middles(source: MeshSource, cells: Ints) -> dict[frozenset[int], int]:
    """Return the node in the middle of each two vertices of a straight cell, which for an edge is its own."""
    count = len(CORNERS[source.kind])
    middles = {}
    for cell in cells:
        others = source.points[cell[count:]]
        for i, j in combinations(cell[:count], 2):
            distances = np.linalg.norm(others - (source.points[i] + source.points[j]) / 2, axis=1)
            middles[frozenset((i, j))] = cell[count:][distances.argmin()]
    return middles


def _material(job: Job) -> list[str]:
    law = job.material
    if isinstance(law, IsochoricNeoHookean):
        return ["*HYPERELASTIC, NEO HOOKE", f"{law.mu / 2:.12e}, {2 / law.kappa:.12e}"]
    if isinstance(law, MooneyRivlin):
        return ["*HYPERELASTIC, MOONEY-RIVLIN", f"{law.c1:.12e}, {law.c2:.12e}, {1 / law.d1:.12e}"]
    raise ValueError(f"CalculiX has no law like {law}")


def facets(source: MeshSource, region: str) -> Ints:
    """Return the nodes of each facet of a region."""
    [group] = [group for group in source.groups if group.name == region and group.dim == 2]
    return source.facets[group.members]


def _forces(source: MeshSource, job: Job) -> Floats:
    """Return the nodal forces (n, 3) of dead tractions."""
    forces = np.zeros_like(source.points)
    corners = 3 if source.kind == "tetrahedron" else 4
    for effect in job.effects:
        if not isinstance(effect, Traction):
            raise ValueError(f"the deck has no load of the kind {type(effect).__name__}")
        traction = np.array([float(t) for t in effect.traction])
        for facet in facets(source, effect.region):
            first, second, third = source.points[facet[:3]]
            area = np.linalg.norm(np.cross(second - first, third - first)) * (0.5 if corners == 3 else 1.0)
            middles = facet[corners : 2 * corners] if source.degree == 2 else facet[:0]
            corner_share, middle_share = SHARES[corners + len(middles)]
            forces[facet[:corners]] += corner_share * area * traction
            forces[middles] += middle_share * area * traction
    return forces
