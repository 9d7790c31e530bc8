"""Bodies of CAD files (STEP, IGES, BREP) by gmsh's OpenCASCADE: solids that touch share their faces.

Solids are regions by their names in the file, and so are faces that have names. Other faces are ``face-1``,
``face-2``, … in the order of the file; the face between two solids is ``A|B``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.cad_files import given_name, solid_names
from hpcinv.base.reading.door import admitted
from hpcinv.errors import MeshError
from hpcinv.geometry.cad.mesh_warnings import report_small_features, report_thin_walls
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.cell_count import MeshingMonitor, monitored
from hpcinv.mesh.io.cad_surface import cad_surface
from hpcinv.mesh.io.gmsh_model import extract, session
from hpcinv.mesh.io.isolated import check_cad
from hpcinv.mesh.source import MeshSource

_HAIR = 1e-3  # gap of two solids, relative to the whole size, that is taken for a fault; more refuses separate parts
_SEWN = 1e-5  # gap of faces, relative to the whole size, that are sewn to a solid; more may join thin parts
_MOST_GLUE = 0.01  # of the whole size; more changes the shape of solids
_OVERLAP = 1e-9  # volume that solids share, relative to the whole, below which it is rounding
_GRADE = 4.0  # size over the smallest edge, unless the job states it; raised, roundings take more cells
_PER_TURN = 12  # edges in a full turn of a curved face; more follow curvature with smaller cells


@dataclass(frozen=True)
class _Solid:
    name: str
    tag: int
    colour: str = ""


@dataclass(frozen=True)
class _Faces:
    """Names and colours of faces in the file, by tag."""

    names: Mapping[int, str]
    colours: Mapping[int, str]


def cad_mesh(path: Path, spec: MeshSpec, report: Callable[[str], None], size_factor: float = 1.0) -> MeshSource:
    """Mesh the solids of a CAD file with edges up to ``spec.size``; in metres.

    Raises:
        MeshError: the file cannot be read, has no solid, or its solids overlap or miss each other by a hair.
    """
    check_cad(path)
    try:
        with session(path.stem, size_factor) as gmsh:
            source = _meshed(gmsh, path, spec, report)
    except MeshError:
        raise
    except Exception as error:  # gmsh raises nothing narrower
        advice = "Make mesh.size smaller, or repair the solid in the CAD program."
        raise MeshError(f"{path}: gmsh could not mesh it: {error}", advice) from error
    source = source.convert_to_metres(spec.metres)
    report_thin_walls(source, report)
    return source


def _meshed(gmsh: Any, path: Path, spec: MeshSpec, report: Callable[[str], None]) -> MeshSource:
    """Return the mesh of a CAD file in the unit of the file."""
    assert spec.size is not None
    unit = spec.metres
    names, faces = _imported(gmsh, path, report)  # STEP and IGES in mm, whatever their unit
    if spec.glue is not None:
        _check_glue(gmsh, path, spec.glue / unit)
        gmsh.option.setNumber("Geometry.ToleranceBoolean", spec.glue / unit)
    measures = _measures(gmsh)
    solids = _joined(gmsh, path, names, unit, glued=spec.glue is not None)
    faces = _renumbered(faces, measures, _measures(gmsh), _SEWN * _extent(gmsh))
    _add_groups(gmsh, solids, faces)
    size = spec.size / unit
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), size)  # gmsh's default is a tenth of the body
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    grade = spec.grade or _GRADE
    gmsh.option.setNumber("Mesh.MeshSizeMin", size / grade)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _PER_TURN)
    with monitored(gmsh, path, MeshingMonitor(spec.maximum_cells, report)):
        gmsh.model.mesh.generate(3)
    report_small_features(gmsh, size, grade, unit, report)
    if spec.geometry_degree == 2:
        gmsh.model.mesh.setOrder(2)
    source = extract(gmsh, path)
    return replace(source, surface=cad_surface(gmsh, source.kind, source.degree))


def _imported(gmsh: Any, path: Path, report: Callable[[str], None]) -> tuple[list[_Solid], _Faces]:
    """Return the solids of a file, and names and colours of its faces."""
    occ = gmsh.model.occ
    occ.importShapes(str(admitted(path)))
    occ.synchronize()
    if not gmsh.model.getEntities(3):
        if gmsh.model.getEntities(2):
            occ.healShapes(tolerance=_SEWN * _extent(gmsh))
            occ.synchronize()
        if not gmsh.model.getEntities(3):
            raise MeshError(f"{path}: has no solid", "Export a closed solid body, not surfaces or sketches.")
        report("its surfaces were sewn to a solid")
    tags = [tag for _, tag in gmsh.model.getEntities(3)]
    solids = [_Solid(name, tag, _colour(gmsh, 3, tag)) for name, tag in zip(solid_names(gmsh), tags, strict=True)]
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    names, colours = ({tag: of(gmsh, 2, tag) for tag in faces} for of in (given_name, _colour))
    return solids, _Faces(names, colours)


def _colour(gmsh: Any, dim: int, tag: int) -> str:
    """Return the name of the region of a colour, such as ``colour-ff0000``; empty without a colour in the file."""
    *channels, opacity = gmsh.model.getColor(dim, tag)
    return f"colour-{bytes(channels).hex()}" if opacity else ""


def _joined(gmsh: Any, path: Path, solids: list[_Solid], unit: float, *, glued: bool) -> list[_Solid]:
    """Return the solids with shared faces where they touch."""
    if len(solids) == 1:
        return solids
    occ = gmsh.model.occ
    if not glued:
        _check_gaps(gmsh, path, solids, unit)
    _, pieces = occ.fragment([(3, solid.tag) for solid in solids], [])
    occ.synchronize()
    owners: dict[int, list[str]] = {}
    for solid, children in zip(solids, pieces, strict=True):
        for dim, tag in children:
            if dim == 3:
                owners.setdefault(tag, []).append(solid.name)
    _check_overlaps(gmsh, path, owners, unit)
    colours = {solid.name: solid.colour for solid in solids}
    return [_Solid(names[0], tag, colours[names[0]]) for tag, names in owners.items()]


def _check_overlaps(gmsh: Any, path: Path, owners: Mapping[int, Sequence[str]], unit: float) -> None:
    """Raise an error if a piece belongs to two solids; ``owners`` are the names of each piece's."""
    occ = gmsh.model.occ
    whole = sum(occ.getMass(3, tag) for tag in owners)
    for tag, names in owners.items():
        if len(names) > 1 and occ.getMass(3, tag) > _OVERLAP * whole:
            place = ", ".join(f"{x * unit:.4g}" for x in occ.getCenterOfMass(3, tag))
            text = f"solids '{names[0]}' and '{names[1]}' overlap near ({place}) m"
            raise MeshError(f"{path}: {text}", "Subtract one from the other in the CAD program.")


def _measures(gmsh: Any) -> dict[int, tuple[float, ...]]:
    """Return centre and square root of the area of each face."""
    occ = gmsh.model.occ
    return {tag: (*occ.getCenterOfMass(2, tag), occ.getMass(2, tag) ** 0.5) for _, tag in gmsh.model.getEntities(2)}


def _renumbered(
    faces: _Faces, before: Mapping[int, Sequence[float]], after: Mapping[int, Sequence[float]], near: float
) -> _Faces:
    """Return names and colours of the faces that are as before: where solids share faces, all of theirs are new."""
    names, colours = dict[int, str](), dict[int, str]()
    marked = {tag: before[tag] for tag in before if faces.names.get(tag) or faces.colours.get(tag)}
    for tag, measure in after.items():
        for old, known in marked.items():
            if max(abs(a - b) for a, b in zip(measure, known, strict=True)) < near:
                names[tag], colours[tag] = faces.names.get(old, ""), faces.colours.get(old, "")
    return _Faces(names, colours)


def _check_glue(gmsh: Any, path: Path, glue: float) -> None:
    if glue > _MOST_GLUE * _extent(gmsh):
        text = f"mesh.glue is more than {_MOST_GLUE:.0%} of the size of the body, whose shape would change"
        raise MeshError(f"{path}: {text}", "Move the solids together in the CAD program.")


def _extent(gmsh: Any) -> float:
    """Return the largest extent of the model."""
    box = gmsh.model.getBoundingBox(-1, -1)
    return float(max(box[i + 3] - box[i] for i in range(3)))


def _check_gaps(gmsh: Any, path: Path, solids: list[_Solid], unit: float) -> None:
    boxes = {solid: gmsh.model.getBoundingBox(3, solid.tag) for solid in solids}
    hair = _HAIR * _extent(gmsh)
    for first, second in combinations(solids, 2):
        apart = [max(boxes[first][i] - boxes[second][i + 3], boxes[second][i] - boxes[first][i + 3]) for i in range(3)]
        if max(apart) > hair:
            continue
        distance, *points = gmsh.model.occ.getDistance(3, first.tag, 3, second.tag)
        if _SEWN * hair < distance < hair:
            place = ", ".join(f"{x * unit:.4g}" for x in points[:3])
            gap = readable(distance * unit, "m")
            text = f"solids '{first.name}' and '{second.name}' miss each other by {gap} near ({place}) m"
            raise MeshError(f"{path}: {text}", f"Join them in the CAD program, or glue them: mesh: {{glue: {gap}}}.")


def _add_groups(gmsh: Any, solids: list[_Solid], given: _Faces) -> None:
    """Make physical groups of solids, faces with names, other faces, faces between solids, and colours.

    A face has the colour of its solid unless the file gives it one; faces that gluing cuts have none.
    """
    volumes: dict[str, list[int]] = {}
    owners: dict[int, list[str]] = {}
    for solid in solids:
        volumes.setdefault(solid.name, []).append(solid.tag)
        for _, face in gmsh.model.getBoundary([(3, solid.tag)], oriented=False):
            owners.setdefault(face, []).append(solid.name)
    faces: dict[str, list[int]] = {}
    for number, face in enumerate(sorted(owners), 1):
        between = sorted(set(owners[face]))
        name = "|".join(between) if len(between) > 1 else given.names.get(face, "")
        faces.setdefault(name or f"face-{number}", []).append(face)
        colour = given.colours.get(face, "")
        if colour and colour not in {solid.colour for solid in solids if solid.name in between}:
            faces.setdefault(colour, []).append(face)
    if len(solids) > 1:
        for solid in solids:
            if solid.colour:
                volumes.setdefault(solid.colour, []).append(solid.tag)
    for dim, groups in ((3, volumes), (2, faces)):
        for name, tags in groups.items():
            gmsh.model.addPhysicalGroup(dim, tags, name=name)
