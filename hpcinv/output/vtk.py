"""Fields of a solution as files for ParaView."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import basix.ufl
from dolfinx import fem
from dolfinx.io import VTKFile

from hpcinv.errors import HpcinvError, OutputError
from hpcinv.mesh import Body
from hpcinv.mesh.moved import placed
from hpcinv.parallel.runtime import agree, on_root
from hpcinv.results.solution import Solution


def write_fields(directory: Path, body: Body, solution: Solution, more: Sequence[fem.Function] = ()) -> None:
    """Write ``fields.pvd`` and its data files into ``directory``, which appears whole or not at all; collective.

    On the solution's mesh in metres: ``displacement`` (m) and ``pressure`` (Pa, of the mixed form) at the nodes of
    Lagrange cells of the higher of the displacement's and the geometry's degree; in each cell the means ``J``,
    ``cauchy_stress`` and, with prestrain, ``prestrain_stress`` (Pa, row by row), and ``region:NAME``, 1 in the cells of
    that region. A directory of that name is replaced.

    Args:
        more: further fields of the displacement's degree at the nodes, by their names.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    comm = body.mesh.comm
    partial = directory.with_name(f".{directory.name}.partial")
    failed = OutputError(f"{directory}: the fields cannot be written", "Is the directory writable, and space left?")

    def prepare() -> None:
        try:
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
        except OSError as exc:
            raise OutputError(f"{directory}: cannot be made: {exc.strerror or exc}", failed.advice) from exc

    on_root(comm, prepare)
    functions = [*_at_nodes(solution, more), *_in_cells(body, solution)]
    error: HpcinvError | None = None
    try:
        with placed(body.mesh, solution.mesh_nodes):
            _write(partial / "fields.pvd", functions)
    except RuntimeError:
        error = failed
    agree(comm, error)  # also a barrier after writing

    def publish() -> None:
        # DOLFINx does not report a full disk.
        if not all(_is_whole(file) for file in partial.iterdir()):
            raise failed
        try:
            if directory.exists():
                shutil.rmtree(directory)
            partial.rename(directory)
        except OSError as exc:
            raise OutputError(f"{directory}: cannot be replaced: {exc.strerror or exc}", failed.advice) from exc

    on_root(comm, publish)


def _write(path: Path, functions: list[fem.Function]) -> None:
    # A separate function, since a VTKFile writes once more when it is deleted.
    with VTKFile(functions[0].function_space.mesh.comm, path, "w") as file:
        file.write_function(functions)


def _at_nodes(solution: Solution, more: Sequence[fem.Function]) -> list[fem.Function]:
    """Return displacement, pressure and more in one nodal element, which the file needs and in which they are exact."""
    mesh = solution.displacement.function_space.mesh
    cell, geometry = mesh.basix_cell(), mesh.ufl_domain().ufl_coordinate_element().embedded_superdegree
    degree = max(solution.displacement.function_space.ufl_element().degree, geometry)
    fields = {"displacement": solution.displacement} | {function.name: function for function in more}
    if solution.pressure is not None:
        fields["pressure"] = solution.pressure
    found = []
    for name, function in fields.items():
        shape: Any = {"shape": function.ufl_shape} if function.ufl_shape else {}
        element = basix.ufl.element("Lagrange", cell, degree, basix.LagrangeVariant.equispaced, **shape)
        nodal = fem.Function(fem.functionspace(mesh, element), name=name)
        nodal.interpolate(function)
        found.append(nodal)
    return found


def _in_cells(body: Body, solution: Solution) -> list[fem.Function]:
    found = []
    means = {name: getattr(solution, name) for name in ("J", "cauchy_stress", "prestrain_stress")}
    for name, function in means.items():
        if function is None:
            continue
        named = function.copy()
        named.name = name
        found.append(named)
    space = fem.functionspace(body.mesh, ("DG", 0))
    for region in body.regions.values():
        if region.cell_count:
            mark = fem.Function(space, name=f"region:{region.name}")
            mark.x.array[space.dofmap.list[region.cells, 0]] = 1.0
            mark.x.scatter_forward()
            found.append(mark)
    return found


def _is_whole(file: Path) -> bool:
    """Return whether an XML file has its end."""
    with file.open("rb") as stream:
        size = file.stat().st_size
        stream.seek(max(0, size - 100))
        return stream.read().rstrip().endswith(b"</VTKFile>")
