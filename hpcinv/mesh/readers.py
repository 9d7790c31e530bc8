"""A reader for each suffix; all run on one process and return a whole ``MeshSource``.

Files that gmsh reads while it runs a generator are noted: CAD models, meshes, and further scripts.
"""

import dataclasses
import re
import runpy
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from hpcinv.base.files.inputs import note_input, recorded_inputs
from hpcinv.base.mesh_formats import FORMATS, check_untrusted
from hpcinv.base.reading.door import admitted, trusted
from hpcinv.base.reading.mesh_format import MeshFormat, loaded
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import HpcinvError, MeshError, described
from hpcinv.job.mesh_generators import ParameterValue
from hpcinv.job.mesh_section import ArrayLabels
from hpcinv.mesh.cell_count import MeshingMonitor, monitored, require_at_most
from hpcinv.mesh.io.gmsh_model import extract, extract_surface, read_views, session
from hpcinv.mesh.io.isolated import check_msh
from hpcinv.mesh.io.length_unit import stored_unit
from hpcinv.mesh.io.vtu import source_of
from hpcinv.mesh.source import MeshSource
from hpcinv.on_demand import on_demand

_READERS = (("open",), ("merge",), ("model", "occ", "importShapes"), ("parser", "parse"))
"""gmsh's functions whose first argument is a file that they read"""
_NAMED = re.compile(r'\b(?:Merge|MergeWithBoundingBox|Include|ShapeFromFile)\b\s*\(?\s*"([^"\n]+)"')
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_SCRIPTS = (".geo", ".geo_unrolled", ".pro")


@contextmanager
def noted_files(gmsh: Any) -> Iterator[None]:
    """Context in which gmsh's functions note the files that they read (`hpcinv.base.files.inputs.note_input`)."""
    originals: list[tuple[Any, str, Callable[..., Any]]] = []
    try:
        for *path, name in _READERS:
            owner = gmsh
            for part in path:
                owner = getattr(owner, part)
            function = getattr(owner, name)
            originals.append((owner, name, function))
            setattr(owner, name, _noting(function))
        yield
    finally:
        for owner, name, function in originals:
            setattr(owner, name, function)


def _noting(function: Callable[..., Any]) -> Callable[..., Any]:
    def noting(*arguments: Any, **named: Any) -> Any:
        file = arguments[0] if arguments else named.get("fileName")
        if isinstance(file, str):
            note_script(Path(file).absolute())
        return function(*arguments, **named)

    return noting


def note_script(path: Path) -> None:
    """Note a file and, if it is a script of gmsh, the files that it names; names that it computes are not seen."""
    pending, known = [path], set[Path]()
    while pending:
        file = pending.pop()
        if file in known or not file.is_file():
            continue
        known.add(file)
        note_input(file)
        if suffix_of(file) in _SCRIPTS:
            text = _COMMENT.sub("", admitted(file).read_text(encoding="utf-8", errors="replace"))
            pending += [file.parent / name for name in _NAMED.findall(text)]


def build_python(
    path: Path,
    parameters: Mapping[str, ParameterValue],
    degree: int | None,
    monitor: MeshingMonitor,
    size_factor: float = 1.0,
    *,
    is_surface: bool = False,
) -> MeshSource:
    """Mesh a generator: a Python file whose ``build(gmsh, *, size: Size = 0.002, …)`` meshes the model, in metres.

    Relative paths in it start from its directory.

    Args:
        is_surface: whether it is the surface of a shell.
    """
    file = str(path.absolute())
    with session(path.stem, size_factor) as gmsh, recorded_inputs(path, reimported=True) as inputs, noted_files(gmsh):
        try:
            build = runpy.run_path(str(trusted(Path(file)))).get("build")
            if not callable(build):
                raise MeshError(
                    f"{path}: no function 'build'",
                    "Write: from hpcinv.base.quantity import Size; def build(gmsh, *, size: Size = 0.002): …",
                )
            with monitored(gmsh, path, monitor):
                build(gmsh, **parameters)
        except HpcinvError:
            raise
        except BaseException as exc:  # user code may raise anything, KeyboardInterrupt and GeneratorExit too
            lines = [f.lineno for f in traceback.extract_tb(exc.__traceback__) if f.filename == file]
            line = f", line {lines[-1]}" if lines else ""
            raise MeshError(f"{path}{line}: {described(exc)}", "Correct the generator or its parameters.") from exc
        if not gmsh.isInitialized():
            raise MeshError(f"{path}: build() finalised gmsh", "Leave gmsh running: its mesh is read after build().")
        source = _extracted_surface(gmsh, path, monitor) if is_surface else _extracted(gmsh, path, degree)
    return dataclasses.replace(source, inputs=inputs)


def build_geo(
    path: Path,
    parameters: Mapping[str, ParameterValue],
    degree: int | None,
    monitor: MeshingMonitor,
    size_factor: float = 1.0,
    *,
    is_surface: bool = False,
) -> MeshSource:
    """Mesh a gmsh script, in its own unit, whose ``DefineConstant`` values are the parameters."""
    file = trusted(path.absolute())
    with session(path.stem, size_factor) as gmsh, recorded_inputs(path) as inputs:
        note_script(file)
        for name, value in parameters.items():
            gmsh.parser.setNumber(name, [value])
        _merge(gmsh, file, path)  # not open, which would discard the numbers set above
        try:
            with monitored(gmsh, path, monitor):
                dim = 2 if is_surface else 3
                if not len(gmsh.model.mesh.getElementTypes(dim)):
                    gmsh.model.mesh.generate(dim)
        except HpcinvError:
            raise
        except Exception as exc:  # gmsh raises nothing narrower
            raise MeshError(f"{path}: gmsh could not mesh it: {exc}", "Check the geometry and the parameters.") from exc
        source = _extracted_surface(gmsh, path, monitor) if is_surface else _extracted(gmsh, path, degree)
    return dataclasses.replace(source, inputs=inputs)


def read_msh(path: Path) -> MeshSource:
    """Read MSH 2.2 or 4.1, ASCII or binary; the sections $NodeData and $ElementData become data arrays."""
    with _opened_msh(path) as gmsh:
        return _with_data(gmsh, extract(gmsh, path))


def read_surface(path: Path, labels: ArrayLabels | None = None) -> MeshSource:
    """Read the surface of a shell from a file, as quadrilaterals of degree 2.

    Args:
        labels: array of a file of VTK that has further regions.
    """
    if suffix_of(path) != ".msh":
        return _quadrilaterals(on_demand("surface of a shell")(path, labels))
    with _opened_msh(path) as gmsh:
        return _quadrilaterals([_with_data(gmsh, part) for part in extract_surface(gmsh, path)])


def _quadrilaterals(surfaces: Sequence[MeshSource]) -> MeshSource:
    """Return surfaces of triangles and quadrilaterals as one of quadrilaterals of degree 2."""
    quadrilaterals: MeshSource = on_demand("quadrilaterals of surfaces")(surfaces)
    return quadrilaterals


@contextmanager
def _opened_msh(path: Path) -> Iterator[Any]:
    """Context with the mesh of an MSH file in gmsh."""
    if fault := FORMATS[".msh"].fault(path):
        raise MeshError(f"{path}: {fault}", "Export the mesh again (gmsh: gmsh.write, or -save).")
    with session(path.stem) as gmsh, tempfile.TemporaryDirectory(prefix="hpcinv-mesh-") as empty:
        # gmsh executes a file NAME.msh.opt next to NAME.msh: read it through a link in an empty directory.
        link = Path(empty) / "mesh.msh"
        link.symlink_to(path.absolute())
        check_msh(link, path)
        _merge(gmsh, link, path)
        if count := gmsh.model.getNumberOfPartitions():
            _check_partitions(gmsh, path, count)
            gmsh.model.mesh.unpartition()
        yield gmsh


def _check_partitions(gmsh: Any, path: Path, count: int) -> None:
    """Refuse a file with some partitions of a mesh, as gmsh writes one for each."""
    entities = (pair for pair in gmsh.model.getEntities() if len(gmsh.model.mesh.getElementTypes(*pair)))
    present = {int(part) for pair in entities for part in gmsh.model.getPartitions(*pair)}
    if missing := set(range(1, count + 1)) - present:
        raise MeshError(
            f"{path}: lacks {len(missing)} of {count} partitions of its mesh",
            "Write all partitions to one file (gmsh: Mesh.PartitionSplitMeshFiles = 0).",
        )


def _with_data(gmsh: Any, source: MeshSource) -> MeshSource:
    return dataclasses.replace(source, data=read_views(gmsh, source), unit=stored_unit(gmsh))


def _merge(gmsh: Any, path: Path, called: Path | None = None) -> None:
    """Read a file into gmsh's current model; errors name ``called`` instead of ``path``, if given."""
    called = called or path
    try:
        gmsh.merge(str(admitted(path)))
    except Exception as exc:  # gmsh raises nothing narrower
        # After a syntax error gmsh's parser keeps the rest of the line for the next file: let it read another one.
        with tempfile.NamedTemporaryFile("w", suffix=".geo") as scrap, suppress(Exception):
            scrap.write("scrap = 0;\n")
            scrap.flush()
            gmsh.merge(scrap.name)
        reason = str(exc).replace(str(path), str(called))
        raise MeshError(
            f"{called}: gmsh cannot read it: {reason}", "Is the file complete, and of the format of its suffix?"
        ) from exc


def _extracted(gmsh: Any, path: Path, degree: int | None) -> MeshSource:
    """The generated mesh, with the additional nodes of a higher degree on the CAD surfaces."""
    if degree is not None and len(gmsh.model.mesh.getElementTypes(3)):
        gmsh.model.mesh.setOrder(degree)
    source = extract(gmsh, path)
    return dataclasses.replace(source, surface=on_demand("nodes on a CAD surface")(gmsh, source.kind, source.degree))


def _extracted_surface(gmsh: Any, path: Path, monitor: MeshingMonitor) -> MeshSource:
    """The generated surface of a shell, in cells of degree 2 with their nodes on the CAD surfaces."""
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
    gmsh.model.mesh.setOrder(2)
    source = _quadrilaterals(extract_surface(gmsh, path))
    require_at_most(path, len(source.cells), monitor.limit)
    return source


GENERATORS: dict[str, Callable[..., MeshSource]] = {".py": build_python, ".geo": build_geo}


def _read(mesh_format: MeshFormat, path: Path) -> MeshSource:
    check_untrusted(path)
    source: MeshSource
    if mesh_format.elements:
        failure = f"cannot be read as {mesh_format.elements}"
        source = on_demand("mesh of elements and sets")(path, mesh_format.action, failure)
    elif mesh_format.reader:
        source = loaded(mesh_format.reader)(path)
    else:
        source = source_of(path, mesh_format.arrays(path))
    return source


FILES: dict[str, Callable[[Path], MeshSource]] = {suffix: partial(_read, kind) for suffix, kind in FORMATS.items()}
