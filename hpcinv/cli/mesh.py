"""``hpcinv mesh``: meshes of images and of surfaces, pictures of meshes, and partitioned meshes; on one process."""

import argparse
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.mesh_formats.partitioned import SUFFIX
from hpcinv.base.quantity.units import length_symbol
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import JOBS, check_one_process, length_unit, mesh_spec
from hpcinv.cli.options import positive
from hpcinv.cli.show import add_picture, show
from hpcinv.errors import JobError, OutputError
from hpcinv.job.job import load
from hpcinv.job.mesh_file import CADS, IMAGES, SURFACES
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.yaml_reader import read_text

_OUTPUT = "mesh to write or replace (.msh, .vtu)"


def add_mesh(commands: Any) -> None:
    mesh = add_command(
        commands,
        "mesh",
        "Mesh an image or a surface; draw a mesh; cut one into parts that many ranks read, and put it together again.",
        examples=(
            "hpcinv mesh from-image organ.nii.gz organ.msh --label organ=1 --size '5 mm'\n"
            "hpcinv mesh from-surface organ.stl organ.msh --size '5 mm' --unit mm\n"
            "hpcinv mesh partition organ.msh organ.bp --parts 64"
        ),
        page="how-to/images.md",
    )
    actions = mesh.add_subparsers(required=True, metavar="action")

    _add_scans(actions)
    picture = add_command(
        actions,
        "show",
        "Draw a mesh with its regions as a PNG, without a display; as 'hpcinv show'.",
        examples="hpcinv mesh show organ.msh",
        page="how-to/images.md",
    )
    add_picture(picture, "a mesh, a generator of one, or a job with its supports and loads")
    picture.set_defaults(command=show, colour=None)

    partition = add_command(
        actions,
        "partition",
        "Check a mesh and cut it into parts (METIS), once for many runs.",
        examples=(
            "hpcinv mesh partition body.msh body.bp --parts 64 --unit mm\n"
            "hpcinv mesh partition meshes/box.py block.bp --parts 4 --parameter nx=3"
        ),
        page="how-to/large-meshes.md",
    )
    partition.add_argument("input", type=Path, help="a mesh, a generator of one, or a job, whose mesh is taken")
    partition.add_argument("output", type=Path, help="partitioned mesh to write or replace (.bp)")
    partition.add_argument(
        "--parts", type=positive, required=True, help="number of parts, best a multiple of the ranks that will read it"
    )
    partition.add_argument(
        "--parameter", action="append", default=[], metavar="NAME=VALUE", help="a parameter of the generator"
    )
    partition.add_argument("--unit", help="length unit of the coordinates, as mesh.unit of a job")
    _add_degree(partition)
    add_option(partition)
    partition.set_defaults(command=_partition)

    gather = add_command(
        actions,
        "gather",
        "Write a partitioned mesh as one file, in the order of its tags.",
        examples="hpcinv mesh gather results/job/shape.bp shape.vtu",
        page="how-to/large-meshes.md",
    )
    gather.add_argument("input", type=Path, help="partitioned mesh (.bp)")
    gather.add_argument("output", type=Path, help=_OUTPUT)
    add_option(gather)
    gather.set_defaults(command=_gather)


def _add_scans(actions: Any) -> None:
    image = add_command(
        actions,
        "from-image",
        "Mesh a segmented image, with a region for each label, to look at before a run.",
        examples="hpcinv mesh from-image organ.nii.gz organ.msh --label organ=1 --size '5 mm'",
        page="how-to/images.md",
    )
    image.add_argument("input", type=Path, help="image of labels (.nii, .nrrd, .mha, .mhd, .vti, also with .gz; .dcm)")
    _add_meshing(image, is_image=True)
    image.add_argument(
        "--label",
        action="append",
        default=[],
        metavar="NAME=NUMBER[,NUMBER…]",
        help="a region and its voxels; without it the labels of the image are listed",
    )
    image.add_argument("--unit", help="length unit of the image, as mesh.unit of a job; by default mm")
    image.add_argument(
        "--neighbour",
        action="append",
        default=[],
        metavar="NAME=NUMBER[,NUMBER…]",
        help="voxels that are not meshed, as mesh.neighbours of a job",
    )
    image.add_argument("--orientation", help="frame of the mesh, as mesh.orientation of a job; by default LPS")
    image.set_defaults(command=_image_mesh)

    surface = add_command(
        actions,
        "from-surface",
        "Mesh the body in a closed surface, to look at before a run.",
        examples="hpcinv mesh from-surface organ.stl organ.msh --size '5 mm' --unit mm",
        page="start/your-own-mesh.md",
    )
    surface.add_argument("input", type=Path, help="surface of triangles (.stl, .ply, .obj, .vtp, .vtk)")
    _add_meshing(surface)
    surface.add_argument("--unit", required=True, help="length unit of the surface, as mesh.unit of a job")
    surface.set_defaults(command=lambda options: _meshed(options, SURFACES, "surface", {}))

    cad = add_command(
        actions,
        "from-cad",
        "Mesh the solids of a CAD file and list their regions, to look at before a run.",
        examples="hpcinv mesh from-cad part.step part.msh --size '4 mm'",
        page="how-to/cad.md",
    )
    cad.add_argument("input", type=Path, help="CAD file (.step, .stp, .iges, .igs, .brep)")
    _add_meshing(cad)
    cad.add_argument("--unit", help="length unit of a BREP file, as mesh.unit of a job")
    cad.add_argument(
        "--glue", help="distance up to which solids that miss each other are joined, as mesh.glue of a job"
    )
    cad.set_defaults(command=lambda options: _meshed(options, CADS, "CAD file", {"glue": options.glue}))


def _add_meshing(action: argparse.ArgumentParser, *, is_image: bool = False) -> None:
    action.add_argument("output", type=Path, nargs="?" if is_image else None, help=_OUTPUT)
    action.add_argument("--size", required=not is_image, help="largest length of edges, such as '5 mm'")
    action.add_argument(
        "--grade", type=float, help="ratio of --size and the smallest size of cells, as mesh.grade of a job"
    )
    _add_degree(action)
    add_option(action)


def _add_degree(action: argparse.ArgumentParser) -> None:
    action.add_argument("--geometry-degree", type=int, choices=(1, 2), help="as mesh.geometry_degree of a job")


def _image_mesh(options: argparse.Namespace) -> int:
    options.label = [text for text in options.label if text]
    needed = {"the mesh to write": options.output, "--size": options.size, "--label": options.label}
    if missing := [name for name, value in needed.items() if not value]:
        raise JobError(_what_to_give(options, missing))
    parsed: Callable[[str], tuple[str, Sequence[int | str]]] = label_of
    if suffix_of(options.input) == ".dcm":
        parsed = _segments_of
    given: dict[str, Any] = {"labels": {}, "neighbours": {}, "orientation": options.orientation}
    for texts, regions in ((options.label, given["labels"]), (options.neighbour, given["neighbours"])):
        for name, numbers in map(parsed, texts):  # a region may be given in several options
            regions[name] = [*regions.get(name, []), *numbers]
    return _meshed(options, IMAGES, "image", given)


def _what_to_give(options: argparse.Namespace, missing: list[str]) -> str:
    """Message on arguments that are not there, with the labels of the image among which to choose."""
    _check_ending(options.input, IMAGES, "image")
    check_one_process("mesh")
    from hpcinv.geometry.imaging.label_image import labels_in

    labels = labels_in(options.input, length_unit(options.unit or "mm"))
    first = labels.partition(" ")[0]
    label = f"--label body={first if first.isdigit() else 1}"
    return (
        f"{options.input}: {' and '.join(missing)} must be given; the labels in the image are {labels}\n"
        f"  Such as: hpcinv mesh from-image {shlex.quote(str(options.input))} body.msh {label} --size '5 mm'"
    )


def _check_ending(path: Path, endings: tuple[str, ...], kind: str) -> None:
    if suffix_of(path) not in endings:
        raise OutputError(f"{path}: is not in a format of {kind}s; the endings are {', '.join(endings)}")


def _meshed(options: argparse.Namespace, endings: tuple[str, ...], kind: str, given: dict[str, Any]) -> int:
    """Mesh an image or a surface, and write the mesh."""
    _check_ending(options.input, endings, kind)
    given |= {name: getattr(options, name) for name in ("size", "unit", "geometry_degree", "grade")}
    spec = mesh_spec(options.input, given)
    check_one_process("mesh")
    from hpcinv.mesh.body import read_source
    from hpcinv.mesh.checks import check
    from hpcinv.mesh.mesh_files import SAVERS, save

    if suffix_of(options.output) not in SAVERS:
        raise OutputError(f"{options.output}: cannot be written; the endings are {', '.join(SAVERS)}")
    source = read_source(spec, options.input, lambda text: print(f"{options.input}: {text}", flush=True))
    check(source)
    save(options.output, replace(source, unit=1.0), source.points)
    print(f"{options.output}: {len(source.cells)} cells and {len(source.points)} nodes, in m")
    print("regions:")
    for group in source.groups:
        print(f"  {group.name}: {len(group.members)} {'cells' if group.dim == 3 else 'facets'}")
    return 0


def label_of(text: str) -> tuple[str, list[int]]:
    """Return name and numbers of ``tumour=6,7``; raises ``JobError`` if it is written otherwise."""
    name, equals, numbers = text.partition("=")
    try:
        return name, [int(number) for number in numbers.split(",")] if equals else []
    except ValueError:
        raise JobError(f"--label {text}: is written NAME=NUMBER, or NAME=NUMBER,NUMBER") from None


def _segments_of(text: str) -> tuple[str, list[int | str]]:
    """Return name and segments, by number or name, of ``tumour=2,Mass``."""
    name, _, segments = text.partition("=")
    return name, [int(segment) if segment.isdigit() else segment for segment in segments.split(",") if segment]


def _partition(options: argparse.Namespace) -> int:
    if suffix_of(options.output) != SUFFIX:
        raise OutputError(f"{options.output}: a partitioned mesh ends in {SUFFIX}", f"Name it *{SUFFIX}.")
    spec, path = _asked_for(options)
    check_one_process("mesh")
    from hpcinv.base.parallel.runtime import MPI
    from hpcinv.mesh.body import read_source
    from hpcinv.mesh.checks import check
    from hpcinv.mesh.distributed.partition import partitioned
    from hpcinv.mesh.distributed.partitioned import write_partitioned

    began = time.perf_counter()
    source = read_source(spec, path, lambda text: print(f"meshing {path}: {text}", flush=True))
    check(source)
    source, cut = partitioned(source, options.parts)
    write_partitioned(options.output, MPI.COMM_SELF, source)
    print(
        f"{options.output}: {len(source.cells)} cells and {len(source.points)} nodes, number of parts {options.parts},"
        f" facets between them {cut}, {time.perf_counter() - began:.1f} s"
    )
    return 0


def _gather(options: argparse.Namespace) -> int:
    if suffix_of(options.input) != SUFFIX:
        raise OutputError(f"{options.input}: is not a partitioned mesh ({SUFFIX})")
    check_one_process("mesh")
    from hpcinv.mesh.mesh_files import SAVERS, save
    from hpcinv.mesh.readers import FILES

    if suffix_of(options.output) not in SAVERS:
        raise OutputError(f"{options.output}: cannot be written; the endings are {', '.join(SAVERS)}")
    source = FILES[SUFFIX](options.input)
    save(options.output, source, source.points)
    unit = length_symbol(source.unit or 1.0)
    print(f"{options.output}: {len(source.cells)} cells and {len(source.points)} nodes, in {unit}")
    return 0


def _asked_for(options: argparse.Namespace) -> tuple[MeshSpec, Path]:
    """Return the mesh section of a job, or one from the options, and the file that it names."""
    given = {
        "parameters": dict(_parameter(text) for text in options.parameter),
        "unit": options.unit,
        "geometry_degree": options.geometry_degree,
    }
    if suffix_of(options.input) in JOBS:
        if any(given.values()):
            raise JobError(f"{options.input}: says itself which parameters, unit and degree its mesh has")
        job = load(options.input)
        return job.mesh, job.resolve(job.mesh.file)
    return mesh_spec(options.input, given), options.input


def _parameter(text: str) -> tuple[str, Any]:
    """Parse ``nx=8`` as in a job file."""
    name, equals, value = text.partition("=")
    if not equals:
        raise JobError(f"--parameter {text}: is written NAME=VALUE")
    return name, read_text(value, f"--parameter {name}")
