"""``hpcinv show``: draw a job before it runs, a mesh, or the result of a run as PNG; or a page of a job or mesh."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.names import check_directory_of
from hpcinv.base.files.untrusted import add_option
from hpcinv.base.reading.door import admitted
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import JOBS, check_one_process, image_spec, length, mesh_spec
from hpcinv.cli.options import port
from hpcinv.errors import OutputError
from hpcinv.job.job import Job, load
from hpcinv.job.mesh_file import IMAGES
from hpcinv.job.support import Support
from hpcinv.output.surfaces.picture import COLOURS, Colour

if TYPE_CHECKING:
    from hpcinv.mesh import Body
    from hpcinv.output.surfaces.picture import Picture


def add_show(commands: Any) -> None:
    command = add_command(
        commands,
        "show",
        "Draw a job before it runs, a mesh, or the result of a run, as a PNG, or a job or mesh as a page to click.",
        examples=(
            "hpcinv show jobs/thick-sphere.yaml\n"
            "hpcinv show --html jobs/thick-sphere.yaml\n"
            "hpcinv show --edit jobs/thick-sphere.yaml\n"
            "hpcinv show body.msh --unit mm\n"
            "hpcinv show results/thick-sphere --colour von-mises"
        ),
        page="how-to/show.md",
    )
    add_picture(command, "job file, mesh or generator of one, or directory of a run")
    command.add_argument("--colour", choices=COLOURS, help="field on the bodies of a run; by default displacement")
    command.add_argument(
        "--section",
        type=_plane,
        metavar="AXIS[=PLACE]",
        help="of a run: cut the bodies, such as x (in the middle of each) or 'z=3 mm'",
    )
    command.add_argument(
        "--html", action="store_true", help="of a job or mesh: a page to turn, cut, measure and click (NAME.html)"
    )
    command.add_argument(
        "--edit", action="store_true", help="of a job: serve that page to this machine, and write what is added into it"
    )
    command.add_argument("--port", type=port, help="port of --edit (default: any free one)")
    command.set_defaults(command=show)


def add_picture(command: argparse.ArgumentParser, given: str) -> None:
    """Add what a command is given to draw, and the options of the picture."""
    command.add_argument("input", type=Path, help=given)
    command.add_argument(
        "--output",
        type=Path,
        help="picture to write (default: in the working directory NAME.png of a job, NAME-mesh.png of a mesh,"
        " NAME-result.png of a run, NAME-result-COLOUR.png with --colour, and -section-AXIS with --section)",
    )
    command.add_argument("--unit", help="length unit of a mesh, as mesh.unit of a job")
    add_option(command)


def show(options: argparse.Namespace) -> int:
    """Draw what ``options.input`` is."""
    given: Path = options.input
    if not given.exists():
        raise OutputError(f"{given}: no such file or directory", "Give a job file, a mesh, or the directory of a run.")
    is_run = given.is_dir() and given.suffix != ".bp"
    chosen = vars(options)  # commands that show their results have some of the options
    _check_options(given, chosen, is_run=is_run)
    if chosen.get("edit"):
        return _edit(given, options.port or 0)
    colour, section, is_page = options.colour, chosen.get("section"), chosen.get("html", False)
    kind = "" if given.suffix in JOBS else "-mesh"
    if is_run:  # pictures of several colours are kept
        kind = "-result" + (f"-{colour}" if colour else "") + (f"-section-{section[0]}" if section else "")
    # A job, its mesh and its run have one name.
    path = options.output or Path(f"{given.resolve().stem}{kind}.{'html' if is_page else 'png'}")
    if is_page:
        from hpcinv.pages.reports.page import write_page

        _check_page(given, path, is_run=is_run)
        check_one_process("show")
        write_page(path, _page(given, options.unit))
    else:
        from hpcinv.pages.pictures.drawing import check_png

        check_png(path)
        check_one_process("show")
        if is_run:
            picture = _run_picture(given, colour or "displacement", section)
        else:
            picture = _body_picture(given, options.unit)
        picture.save(path)
    print(path)
    return 0


def _check_options(given: Path, chosen: Mapping[str, Any], *, is_run: bool) -> None:
    """Raise an error if options do not fit each other, or what is given."""
    if chosen.get("edit"):
        for name in ("html", "output", "unit", "colour", "section"):
            if chosen.get(name):
                raise OutputError(f"{given}: --edit cannot be combined with --{name}")
        return
    if chosen.get("port") is not None:
        raise OutputError(f"{given}: --port is for --edit")
    for name, is_valid, purpose in (
        ("colour", is_run, "results, and this is not the directory of a run"),
        ("section", is_run, "results, and this is not the directory of a run"),
        ("unit", not is_run and given.suffix not in JOBS, "meshes; jobs and results state theirs"),
    ):
        if chosen.get(name) and not is_valid:
            raise OutputError(f"{given}: --{name} is for {purpose}")


def _plane(text: str) -> tuple[str, float | None]:
    """Return the axis and the place (m) of a section."""
    axis, _, place = (part.strip() for part in text.partition("="))
    if axis not in ("x", "y", "z"):
        raise argparse.ArgumentTypeError(f"'{text}' must be x, y or z, or a place on it such as 'z=3 mm'")
    try:
        return axis, length("--section", place, positive=False) if place else None
    except OutputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _run_picture(directory: Path, colour: Colour, section: tuple[str, float | None] | None) -> Picture:
    from hpcinv.output.run_directory import RunDirectory
    from hpcinv.output.surfaces.boundary_surface import NAME, read_boundary
    from hpcinv.output.surfaces.interior import NAME as INTERIOR
    from hpcinv.output.surfaces.interior import read_interior
    from hpcinv.pages.pictures.body_section import Cut
    from hpcinv.pages.pictures.result_picture import draw_result

    summary = RunDirectory(directory).summary()
    if summary is None or not {"job", "certificate"} <= summary.keys():
        raise OutputError(
            f"{directory}: has no summary of a run", "Give the directory that 'run' printed at its beginning."
        )
    boundary = read_boundary(directory / NAME)
    cut = None
    if section is not None:
        interior = read_interior(directory / INTERIOR)
        if interior is None or len(interior.results) != len(boundary.results):
            raise OutputError(f"{directory}: has no {INTERIOR} for a section", "Run the job again.")
        cut = Cut(interior, *section)
    try:
        return draw_result(summary, boundary, colour, cut)
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise OutputError(
            f"{directory}: its summary does not have what a picture needs ({type(error).__name__}: {error})",
            "Was it written by another version of hpcinv? Run the job again.",
        ) from error


def _check_page(given: Path, path: Path, *, is_run: bool) -> None:
    if is_run:
        raise OutputError(f"{given}: --html is for jobs and meshes", f"Of a run: hpcinv report {given}")
    if path.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{path}: --html writes HTML files", f"Name it {path.with_suffix('.html').name}.")
    check_directory_of(path)


def _body_picture(path: Path, unit: str | None) -> Picture:
    job, body = _job_and_body(path, unit)

    from hpcinv.output.surfaces.gathering import boundary_of
    from hpcinv.pages.pictures.job_picture import draw_job, draw_mesh

    boundary = boundary_of(body)
    assert boundary is not None  # there is one rank
    return draw_job(job, boundary) if job else draw_mesh(path.name, boundary)


def _edit(path: Path, port: int) -> int:
    """Serve the page of a job until the process is asked to stop."""
    if path.suffix not in JOBS:
        raise OutputError(f"{path}: --edit is for jobs, into which it writes", f"To look: hpcinv show --html {path}")
    check_one_process("show")

    from hpcinv.base.parallel.signals import StopRequest
    from hpcinv.studies.serving.http_server import new_token
    from hpcinv.studies.serving.job_editor import SAVE, JobEditor

    stop = StopRequest()
    editor = JobEditor(path, _page(path, None, SAVE), port, new_token())
    stop.install()
    print(f"{path} is edited at {editor.address}\nstop with Ctrl-C", flush=True)
    try:
        while not stop():
            time.sleep(0.1)
    finally:
        editor.close()
    return 0


def _page(path: Path, unit: str | None, save: str = "") -> bytes:
    job, body = _job_and_body(path, unit)

    from hpcinv.pages.reports.job_page import job_page, length_unit_of

    text = admitted(path).read_text("utf-8") if job else ""
    symbol = unit or length_unit_of(job, body)
    return job_page(path.stem, body, job, text, symbol, save)


def _job_and_body(path: Path, unit: str | None) -> tuple[Job | None, Body]:
    """The job, unless a mesh is given, and its body with all regions that it names."""
    job = load(path) if path.suffix in JOBS else None
    spec = job.mesh if job else image_spec(path, unit) if path.suffix in IMAGES else mesh_spec(path, {"unit": unit})

    from hpcinv.base.parallel.runtime import MPI
    from hpcinv.mesh import build_body

    def report(text: str) -> None:
        print(f"meshing {spec.file}: {text}", file=sys.stderr, flush=True)

    regions, resolve = (job.regions, job.resolve) if job else ({}, lambda _file: path)
    body = build_body(spec, regions, MPI.COMM_SELF, resolve=resolve, report=report)
    if job:
        parts = [part for solve in job.plan for part in (*solve.job.supports, *solve.job.effects)]
        for part in parts:
            if (name := getattr(part, "region", None)) is not None:
                # Raises MeshError if the mesh lacks it.
                body.held_entities(name) if isinstance(part, Support) else body.facets(name)
    return job, body
