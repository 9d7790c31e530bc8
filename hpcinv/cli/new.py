"""``hpcinv new``: a commented job from a template, for an image, a surface, or an example's mesh that is generated."""

from __future__ import annotations

import argparse
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.atomic import output_errors, replace, write_output
from hpcinv.base.files.names import check_directory_of, escaped_line, yaml_text
from hpcinv.base.files.untrusted import add_option
from hpcinv.base.quantity.quantity import positive
from hpcinv.base.quantity.schema import NAME_OF_FILE
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh import label_of
from hpcinv.cli.mesh_input import CELL, CELLS, length, length_unit
from hpcinv.errors import JobError, OutputError
from hpcinv.job.job import parse
from hpcinv.job.mesh_file import IMAGES, SURFACES
from hpcinv.job.vocabulary import STRESS
from hpcinv.job.yaml_reader import read_text
from hpcinv.physics.materials import laws

if TYPE_CHECKING:  # validation loads no numpy
    import numpy as np

_HERE = Path(__file__).resolve().parent
_TEMPLATES = _HERE / "templates"
_GENERATORS = _HERE / "meshes" if (_HERE / "meshes").is_dir() else _HERE.parents[1] / "meshes"
"""The copy in an installed package, or the directory ``meshes`` of a clone."""
_MOST_CELLS = 30000
_PRESSURE = "9 mmHg"  # of a ventricle at the end of filling
_HELD = 0.25  # share of the body's length within which it is held
_GENERATED: Mapping[str, tuple[str, str]] = {
    "liver": ("ellipsoid.py", "parameters: {size: 12 mm}, geometry_degree: 2"),
    "breast": ("breast.py", "parameters: {size: 12 mm}, geometry_degree: 2"),
    "artery": (
        "thick_cylinder.py",
        "parameters: {inner: 1 mm, outer: 1.25 mm, length: 1 mm, radial: 3, around: 8, along: 3,\n"
        "    hexahedra: true}, geometry_degree: 2",
    ),
    "ventricle": ("ventricle.py", "parameters: {size: 8 mm}, geometry_degree: 2"),
    "part": ("pdms_beam.py", "parameters: {length: 80 mm, size: 4 mm}, geometry_degree: 2"),
    "shell": ("sheet.py", "parameters: {length: 50 mm, width: 30 mm, nx: 10, ny: 6}, shell: {thickness: 2 mm}"),
}
"""Generator and its parameters of the example of each kind of body."""
_NOT_SCANNED = {"shell": "a shell is a surface of quadrilaterals"}
"""why a kind of body cannot be made of an image or a closed surface"""
_SURFACES = {"artery": (("inlet", "outlet"), "inner", "outer"), "ventricle": (("base",), "endo", "epi")}
"""Ends, inner and outer surface of walls; a vessel may have more outlets."""
_WALLS = tuple(_SURFACES)
_LPS = " (in the frame of images y points to the back)"
_UNKNOWN = " (if y points to the back, as in the frame of images; else change it)"


@dataclass(frozen=True)
class _Source:
    """The section 'mesh' of a job, and what it needs.

    Attributes:
        box: box (m) around the body; ``None`` if its regions have names.
        frame: what is known of its position in space, for a comment.
        mesh_file: a file of the mesh that is written next to the job.
        write: writes that file.
        is_example: the body is an example.
        ends: names of the ends of a wall.
    """

    mesh: str
    box: tuple[np.ndarray, np.ndarray] | None = None
    frame: str = ""
    mesh_file: Path | None = None
    write: Callable[[Path], None] | None = None
    is_example: bool = False
    ends: tuple[str, ...] = ()


def add_new(commands: Any) -> None:
    new = add_command(
        commands,
        "new",
        "Write a commented job for a kind of body: from an image, a surface, or an example's mesh.",
        examples=(
            "hpcinv new liver --image scan.nii.gz --label liver=5 liver.yaml\n"
            "hpcinv new part --surface part.stl --unit mm part.yaml\n"
            "hpcinv new ventricle ventricle.yaml\n"
            "hpcinv new job --from part.inp --unit mm --stress-unit MPa part.yaml"
        ),
        page="how-to/new.md",
    )
    new.add_argument("kind", choices=[*sorted(_GENERATED), "job"], help="kind of body; job: as a file says")
    new.add_argument("output", type=Path, help="job file (.yaml) that is written")
    new.add_argument("--image", type=Path, help="image of labels (.nii, .nrrd, .mha, .mhd, .vti, also with .gz)")
    new.add_argument(
        "--label", action="append", default=[], metavar="NAME=NUMBER[,NUMBER…]", help="a region and its voxels"
    )
    new.add_argument("--surface", type=Path, help="closed surface of triangles (.stl, .ply, .obj, .vtp, .vtk)")
    new.add_argument("--from", dest="source", type=Path, help="input file of another program (.inp, .feb, .cdb)")
    new.add_argument("--unit", help="length unit of the image (by default mm), the surface or the input file")
    new.add_argument("--stress-unit", help="unit of stress of the input file")
    new.add_argument("--size", help="largest length of edges; by default for about 8000 cells")
    new.add_argument(
        "--ed-pressure", metavar="P", help="of a ventricle: pressure at the end of filling, such as '10 mmHg'"
    )
    new.add_argument(
        "--klotz", action="store_true", help="of a ventricle: find its stiffness by Klotz's pressure-volume curve"
    )
    add_option(new)
    new.add_argument("--force", action="store_true", help="replace files that exist")
    new.set_defaults(command=_new)


def _new(options: argparse.Namespace) -> int:
    kind, output = options.kind, options.output
    _check(options)
    if kind == "job":
        return _new_from_file(options)
    source = _source(options)
    values = {
        "command": escaped_line(" ".join(["hpcinv new", kind, *_typed(options), shlex.quote(str(output))])),
        "file": escaped_line(shlex.quote(str(output))),
        "name": output.stem,
        "klotz": options.klotz,
        "pressure": options.ed_pressure or _PRESSURE,
        "pressure_source": "" if options.ed_pressure else ": typical order of magnitude",
    }
    text = _job(kind, source, values)
    paths = [output] if source.mesh_file is None else [output, source.mesh_file]
    if (existing := [path for path in paths if path.exists()]) and not options.force:
        raise OutputError(f"{existing[0]}: exists", "Choose another name, or replace it by --force.")
    with _removed_after_errors(None if existing else source.mesh_file):
        if source.mesh_file is not None and source.write is not None:
            with output_errors(source.mesh_file):
                source.write(source.mesh_file)
        parse(read_text(text, str(output)), output)  # before it is written, but next to its mesh
        write_output(output, text.encode())
    return _say_next(output, f"a job for {_article(kind)}", "identify" if options.klotz else "run")


def _new_from_file(options: argparse.Namespace) -> int:
    from hpcinv.cli.new_from import job_from

    output, text = options.output, job_from(options)
    if output.exists() and not options.force:
        raise OutputError(f"{output}: exists", "Choose another name, or replace it by --force.")
    write_output(output, text.encode())
    try:
        parse(read_text(text, str(output)), output)
    except JobError as error:  # such as a body that only forces hold
        print("\n".join(["The file does not say all that a job needs:", *error.problems]))
    return _say_next(output, f"the job of {options.source}")


def _source(options: argparse.Namespace) -> _Source:
    if options.image is not None:
        return _wall_source(options) if options.kind in _WALLS else _image_source(options)
    return _example(options) if options.surface is None else _surface_source(options)


def _say_next(output: Path, what: str, last: str = "run") -> int:
    print(f"{output}: {what}; read what it says, and change it. Then:")
    for line in ("validate", "show", last):
        print(f"  python -m hpcinv {line} {escaped_line(shlex.quote(str(output)))}")
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raise an error if options do not fit each other."""
    _check_output(options.output)
    _check_input_file(options)
    _check_filling(options)
    _check_scan(options)


def _check_output(output: Path) -> None:
    if suffix_of(output) not in (".yaml", ".yml"):
        raise OutputError(f"{output}: is not a name of a job", "Name it *.yaml.")
    if not re.fullmatch(NAME_OF_FILE, output.stem):
        raise OutputError(
            f"{output}: cannot be the name of a job", "Use letters, digits, _, - and dots, a letter first."
        )
    check_directory_of(output)


def _check_input_file(options: argparse.Namespace) -> None:
    if (options.kind == "job") != (options.source is not None):
        raise JobError("--from: goes with 'hpcinv new job', which needs it: such as --from part.inp")
    if options.stress_unit and options.source is None:
        raise JobError("--stress-unit: is for an input file, and there is no --from")
    if options.source is not None and (options.image or options.surface or options.size):
        raise JobError("--from: a job has one mesh, and the input file gives it")


def _check_filling(options: argparse.Namespace) -> None:
    """Raise an error if the options of a ventricle are not valid."""
    for name in ("ed_pressure", "klotz"):
        if getattr(options, name) and options.kind != "ventricle":
            raise JobError(f"--{name.replace('_', '-')}: is for a ventricle, and this is {_article(options.kind)}")
    if options.ed_pressure is not None:
        try:
            positive(options.ed_pressure, STRESS, "the pressure")
        except ValueError as error:
            raise JobError(f"--ed-pressure: {error}") from None


@contextmanager
def _removed_after_errors(file: Path | None) -> Iterator[None]:
    try:
        yield
    except Exception:
        if file is not None:
            file.unlink(missing_ok=True)
        raise


def _check_without_scan(options: argparse.Namespace) -> None:
    if not options.source and (options.unit or options.size):
        raise JobError(f"--{'unit' if options.unit else 'size'}: is for an --image or a --surface, and there is none")


def _check_surface(options: argparse.Namespace) -> None:
    if options.kind in _WALLS:
        raise JobError(
            f"--surface: does not distinguish cavity and outside of {_article(options.kind)};"
            " give an --image, or a mesh with named surfaces"
        )
    if options.unit is None:
        raise JobError("--unit: is needed with --surface, since its formats have no unit: such as --unit mm")


def _check_scan(options: argparse.Namespace) -> None:
    """Raise an error if the options of an image or a surface are not valid for the kind of body."""
    has_image, has_surface = options.image is not None, options.surface is not None
    if has_image and has_surface:
        raise JobError("--surface: a job has one mesh, and --image gives it, too")
    if (has_image or has_surface) and (reason := _NOT_SCANNED.get(options.kind)):
        name = "image" if has_image else "surface"
        raise JobError(f"--{name}: {reason}; put such a mesh into the example")
    if options.label and not has_image:
        raise JobError("--label: is for an image, and there is no --image")
    if has_surface:
        _check_surface(options)
    elif not has_image:
        _check_without_scan(options)
    for name, endings in (("image", IMAGES), ("surface", SURFACES)):
        _check_file(f"--{name}", getattr(options, name), endings, f"{name}s")


def _check_file(option: str, path: Path | None, endings: Sequence[str], what: str) -> None:
    if path is not None and suffix_of(path) not in endings:
        raise JobError(f"{option} {path}: is not in a format of {what}; the endings are {', '.join(endings)}")
    if path is not None and not path.is_file():
        raise JobError(f"{option} {path}: no such file")


def _example(options: argparse.Namespace) -> _Source:
    generator, parameters = _GENERATED[options.kind]
    path = options.output.with_name(f"{options.output.stem}_mesh.py")
    section = _section([f"file: {path.name}, unit: mm", parameters])
    content = (_GENERATORS / generator).read_bytes()
    return _Source(section, mesh_file=path, write=lambda file: replace(file, content), is_example=True)


def _labels(options: argparse.Namespace, example: str) -> dict[str, list[int]]:
    """The labels that are asked for; ``JobError`` with the image's labels if there are none."""
    from hpcinv.geometry.imaging.label_image import labels_in

    if not options.label:
        known = labels_in(options.image, length_unit(options.unit or "mm"))
        raise JobError(f"--label: is needed with --image, such as --label {example}; in {options.image} are {known}")
    return dict(label_of(text) for text in options.label)


def _wall_source(options: argparse.Namespace) -> _Source:
    """The wall around a cavity, meshed now: only with the cavity is it known which of its surfaces is which."""
    from hpcinv.geometry.imaging.hollow_wall import (
        CAVITY,
        WALL,
        hollow_wall_mesh,
        opening_count,
        opening_error,
        wall_size,
    )
    from hpcinv.mesh.checks import check
    from hpcinv.mesh.mesh_files import save

    path, unit, example = options.image, length_unit(options.unit or "mm"), f"{WALL}=1 --label {CAVITY}=2"
    labels = _labels(options, example)
    if labels.keys() != {WALL, CAVITY}:
        raise JobError(f"--label: {_article(options.kind)} has two regions in an image: --label {example}")
    ends, inner, outer = _SURFACES[options.kind]
    count, is_vessel = opening_count(path, labels, unit), len(ends) > 1
    if count != len(ends) and not (is_vessel and count > len(ends)):  # before it is meshed, which takes minutes
        needed = f"{len(ends)} or more are needed" if is_vessel else f"1 is needed ({ends[0]})"
        raise opening_error(path, count, needed)
    if count > len(ends):
        ends = (ends[0], *(f"{ends[1]} {number}" for number in range(1, count)))
    size = options.size or _size_in_wall(*wall_size(path, labels, unit))
    metres = length("--size", size)
    meshed = hollow_wall_mesh(
        path, labels, metres, unit, ends, inner, outer, lambda text: print(f"{path}: {text}", flush=True)
    )
    check(meshed)
    mesh_file = options.output.with_name(f"{options.output.stem}_mesh.msh")
    error = f"{{sd: {0.12e3 * meshed.voxel:.2g} mm, correlation: {max(meshed.voxel, metres / 2) * 1e3:.2g} mm}}"
    entries = [f"file: {mesh_file.name}", "geometry_degree: 2", f"surface_error: {error}"]
    write = partial(save, source=meshed, points=meshed.points)
    return _Source(_section(entries), mesh_file=mesh_file, write=write, ends=tuple(ends))


def _size_in_wall(thickness: float, volume: float) -> str:
    """Two cells through a wall, if they are not too many."""
    return f"{max(thickness / 1.5, (volume / (CELL * _MOST_CELLS)) ** (1 / 3)) * 1e3:.2g} mm"


def _article(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _image_source(options: argparse.Namespace) -> _Source:
    import numpy as np

    from hpcinv.geometry.imaging.label_image import read_labels

    path, unit = options.image, length_unit(options.unit or "mm")
    labels = _labels(options, f"{options.kind}=1")
    image = read_labels(path, labels, unit)
    places = np.argwhere(image.voxels > 0)
    positions = image.positions(places * image.spacing)
    half = np.abs(image.axes) @ image.spacing / 2
    size = _size(options, sum(image.volume(label) for label in range(1, len(labels) + 1)))
    named = ", ".join(
        f"{yaml_text(name)}: {numbers if len(numbers) > 1 else numbers[0]}" for name, numbers in labels.items()
    )
    entries = [f"image: {_relative(path, options)}", f"labels: {{{named}}}", f"size: {size}", "geometry_degree: 2"]
    entries += [f"unit: {options.unit}"] if options.unit else []
    box = positions.min(axis=0) - half, positions.max(axis=0) + half
    return _Source(_section(entries), box, _LPS)


def _surface_source(options: argparse.Namespace) -> _Source:
    import numpy as np

    from hpcinv.geometry.imaging.closed_surface import read_closed

    path, unit = options.surface, length_unit(options.unit)
    surface = read_closed(path)
    bounds = np.array(surface.bounds).reshape(3, 2).T * unit
    size = _size(options, abs(float(surface.volume)) * unit**3)
    entries = [f"surface: {_relative(path, options)}", f"unit: {options.unit}", f"size: {size}", "geometry_degree: 2"]
    return _Source(_section(entries), (bounds[0], bounds[1]), _UNKNOWN)


def _job(kind: str, source: _Source, values: Mapping[str, Any]) -> str:
    """Return the content of a job: the template of its kind, filled."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    templates = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    tissue = {
        name: values_of_tissue
        for name, law in laws().items()
        if (values_of_tissue := law.starting_values.get("tissue"))
    }
    ends: dict[str, dict[str, str]] = {}
    longest = ""
    if source.box is not None:
        low, size = source.box[0] * 1e3, (source.box[1] - source.box[0]) * 1e3  # mm
        longest = "xyz"[int(size.argmax())]
        for i, axis in enumerate("xyz"):
            low_bound, high_bound = low[i] + _HELD * size[i], low[i] + (1 - _HELD) * size[i]
            ends[axis] = {"low": f"{axis} < {low_bound:.4g} mm", "high": f"{axis} > {high_bound:.4g} mm"}
    return templates.get_template(f"{kind}.yaml").render(
        mesh=source.mesh,
        frame=source.frame,
        example=source.is_example,
        tissue=tissue,
        ends=ends,
        openings=source.ends,
        longest=longest,
        **values,
    )


def _section(entries: list[str]) -> str:
    return (
        "# For figures that count, take smaller cells until the certificate passes.\nmesh: {" + ", ".join(entries) + "}"
    )


def _size(options: argparse.Namespace, volume: float) -> str:
    """The size of cells, as it stands in a job."""
    if options.size is not None:
        length("--size", options.size)
        return " ".join(str(options.size).split())
    return f"{(volume / (CELL * CELLS)) ** (1 / 3) * 1e3:.2g} mm"


def _relative(path: Path, options: argparse.Namespace) -> str:
    """A path as it stands in the job, which is relative to the job's directory."""
    return yaml_text(os.path.relpath(path.resolve(), options.output.resolve().parent))


def _typed(options: argparse.Namespace) -> list[str]:
    """The options as they were typed."""
    names = ("image", "surface", "unit", "size", "ed_pressure")
    given = [
        (f"--{name.replace('_', '-')}", str(value)) for name in names if (value := getattr(options, name)) is not None
    ]
    given += [("--label", text) for text in options.label]
    return [*(f"{name} {shlex.quote(value)}" for name, value in given), *(["--klotz"] if options.klotz else [])]
