"""Mesh files with data arrays that no writer of ``hpcinv`` made: linear functions of position on nodes and cells."""

from __future__ import annotations

import runpy
from pathlib import Path

import dolfinx
import gmsh
import numpy as np
import pyvista

from helpers.mesh_cases import spec
from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import MeshSource, read_source
from hpcinv.mesh.cells import FACET_KIND, coordinate_element, vtk_order
from hpcinv.mesh.io.vtu import VTK_TYPES

GRADIENT = np.random.default_rng(1).normal(size=(9, 3))
OFFSET = np.arange(9.0)


def linear(points: np.ndarray, components: int) -> np.ndarray:
    """A linear function of position with so many components, at points (…, 3)."""
    return points @ GRADIENT[:components].T + OFFSET[:components]


# Name: on nodes or on cells, and components.
ARRAYS = {
    "stiffness": ("cells", 1),
    "fibre": ("cells", 3),
    "growth": ("cells", 9),
    "density": ("nodes", 1),
    "sheet": ("nodes", 3),
    "stretch": ("nodes", 9),
}


def values(nodes: np.ndarray, centres: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the arrays at nodes, and in cells that have the mean of their vertices at ``centres``."""
    return {name: linear(nodes if place == "nodes" else centres, k) for name, (place, k) in ARRAYS.items()}


def block(meshes: Path, hexahedra: bool, degree: int) -> MeshSource:
    path = meshes / "box.py"
    parameters = {"lx": 2, "nx": 3, "ny": 2, "nz": 2, "hexahedra": hexahedra}
    return read_source(spec(path, parameters=parameters, geometry_degree=degree), path)


def write_vtu(path: Path, mesh: MeshSource) -> Path:
    """Nodes and cells in a random order, surface cells among them with values of their own, and a node of no cell."""
    random = np.random.default_rng(2)
    count = len(mesh.points) + 1
    new_rows = random.permutation(count)  # row of each node, the last being of no cell
    points = np.empty((count, 3))
    points[new_rows] = [*mesh.points, (9, 9, 9)]
    kinds = (mesh.kind, FACET_KIND[mesh.kind])
    cells = []
    for kind, nodes in zip(kinds, (mesh.cells, mesh.facets), strict=True):
        vtk_type = pyvista.CellType(VTK_TYPES[kind][mesh.degree - 1])
        rows = new_rows[nodes[:, np.argsort(vtk_order(kind, mesh.degree))]]
        cells += [(vtk_type, row) for row in rows.tolist()]
    shuffled = [cells[i] for i in random.permutation(len(cells))]
    connectivity = np.concatenate([[len(row), *row] for _, row in shuffled])
    grid = pyvista.UnstructuredGrid(connectivity, [t for t, _ in shuffled], points)
    solid = np.array([t == pyvista.CellType(VTK_TYPES[mesh.kind][mesh.degree - 1]) for t, _ in shuffled])
    corners = 8 if mesh.kind == "hexahedron" else 4
    centres = np.array([points[row[:corners]].mean(axis=0) for _, row in shuffled])  # VTK has vertices first too
    for name, array in values(points, centres).items():
        if ARRAYS[name][0] == "nodes":
            array[new_rows[-1]] = np.nan
            grid.point_data[name] = array
        else:
            array[~solid] = np.nan
            grid.cell_data[name] = array
    grid.save(path)
    return path


def write_xdmf(path: Path, mesh: MeshSource) -> Path:
    """As DOLFINx writes it: its own order of nodes and cells, functions of time in addition to the mesh."""
    made = dolfinx.mesh.create_mesh(
        MPI.COMM_SELF, mesh.cells, coordinate_element(mesh.kind, mesh.degree), np.asarray(mesh.points)
    )
    with dolfinx.io.XDMFFile(MPI.COMM_SELF, str(path), "w") as file:
        file.write_mesh(made)
        for name, (place, components) in ARRAYS.items():
            shape = {1: (), 3: (3,), 9: (3, 3)}[components]
            family = ("Lagrange", mesh.degree, shape) if place == "nodes" else ("DG", 0, shape)
            function = dolfinx.fem.Function(dolfinx.fem.functionspace(made, family), name=name)
            file.write_function(function, 0.0)
            function.interpolate(lambda x, k=components: linear(x.T, k).T)
            file.write_function(function, 1.0)
    return path


def write_msh(path: Path, meshes: Path, hexahedra: bool, degree: int, version: float) -> Path:
    """As gmsh writes it, with sections of data as its manual describes them, on surface elements too."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        runpy.run_path(str(meshes / "box.py"))["build"](gmsh, lx=2, nx=3, ny=2, nz=2, hexahedra=hexahedra)
        gmsh.model.mesh.setOrder(degree)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(path))
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        points = dict(zip(tags.tolist(), coordinates.reshape(-1, 3), strict=True))
        centres = {}
        for dim in (3, 2):
            (kind,), (elements,), (nodes,) = gmsh.model.mesh.getElements(dim)
            *_, size, _, vertices = gmsh.model.mesh.getElementProperties(kind)
            for tag, row in zip(elements.tolist(), nodes.reshape(-1, size)[:, :vertices].tolist(), strict=True):
                # Surface elements have values that no cell has.
                centres[tag] = np.mean([points[n] for n in row], axis=0) + (1000 if dim == 2 else 0)
    finally:
        gmsh.finalize()
    with path.open("a") as file:
        for name, (place, components) in ARRAYS.items():
            where = points if place == "nodes" else centres
            section = "NodeData" if place == "nodes" else "ElementData"
            file.write(f'${section}\n1\n"{name}"\n1\n0.0\n3\n0\n{components}\n{len(where)}\n')
            for tag in reversed(where):
                file.write(f"{tag} {' '.join(f'{v:.17g}' for v in linear(where[tag], components))}\n")
            file.write(f"$End{section}\n")
    return path


def write(path: Path, meshes: Path, hexahedra: bool, degree: int) -> Path:
    """A block in the format that the suffix of ``path`` says; ``.msh`` of the version in its name."""
    if path.suffix == ".msh":
        return write_msh(path, meshes, hexahedra, degree, float(path.stem))
    mesh = block(meshes, hexahedra, degree)
    return write_vtu(path, mesh) if path.suffix == ".vtu" else write_xdmf(path, mesh)
