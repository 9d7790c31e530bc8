"""``hpcinv show``: draw a job before it runs, a mesh, or the result of a run as PNG."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import JOBS, check_one_process, mesh_spec
from hpcinv.errors import OutputError
from hpcinv.files.untrusted import add_option
from hpcinv.job.job import load
from hpcinv.pictures.colours import COLOURS, Colour

if TYPE_CHECKING:
    from hpcinv.pictures.drawing import Picture


def add_show(commands: Any) -> None:
    command = add_command(
        commands,
        "show",
        "Draw a job before it runs, a mesh, or the result of a run, as a PNG, without a display.",
        examples=(
            "hpcinv show jobs/thick-sphere.yaml\n"
            "hpcinv show body.msh --unit mm\n"
            "hpcinv show results/thick-sphere --colour von-mises"
        ),
        page="start/jobs.md",
    )
    add_picture(command, "job file, mesh or generator of one, or directory of a run")
    command.add_argument("--colour", choices=COLOURS, help="field on the bodies of a run; by default displacement")
    command.set_defaults(command=show)


def add_picture(command: argparse.ArgumentParser, given: str) -> None:
    """Add what a command is given to draw, and the options of the picture."""
    command.add_argument("input", type=Path, help=given)
    command.add_argument(
        "--output",
        type=Path,
        help="picture to write (default: in the working directory NAME.png of a job, NAME-mesh.png of a mesh,"
        " NAME-result.png of a run, NAME-result-COLOUR.png with --colour)",
    )
    command.add_argument("--unit", help="length unit of a mesh, as mesh.unit of a job")
    add_option(command)


def show(options: argparse.Namespace) -> int:
    """Draw what ``options.input`` is."""
    given: Path = options.input
    if not given.exists():
        raise OutputError(f"{given}: no such file or directory", "Give a job file, a mesh, or the directory of a run.")
    is_run = given.is_dir() and given.suffix != ".bp"
    colour = f"-{options.colour}" if is_run and options.colour else ""  # pictures of several colours are kept
    kind = f"-result{colour}" if is_run else "" if given.suffix in JOBS else "-mesh"
    path = options.output or Path(f"{given.resolve().stem}{kind}.png")  # a job, its mesh and its run have one name

    from hpcinv.pictures.drawing import check_png

    check_png(path)
    check_one_process("show")
    if options.colour and not is_run:
        raise OutputError(f"{given}: --colour is for results, and this is not the directory of a run")
    if options.unit and (is_run or given.suffix in JOBS):
        raise OutputError(f"{given}: --unit is for meshes; jobs and results state theirs")
    picture = _run_picture(given, options.colour or "displacement") if is_run else _body_picture(given, options.unit)
    picture.save(path)
    print(path)
    return 0


def _run_picture(directory: Path, colour: Colour) -> Picture:
    from hpcinv.output.run_directory import RunDirectory
    from hpcinv.pictures.boundary_surface import NAME, read_boundary
    from hpcinv.pictures.result_picture import draw_result

    summary = RunDirectory(directory).summary()
    if summary is None or not {"job", "certificate"} <= summary.keys():
        raise OutputError(
            f"{directory}: has no summary of a run", "Give the directory that 'run' printed at its beginning."
        )
    boundary = read_boundary(directory / NAME)
    try:
        return draw_result(summary, boundary, colour)
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise OutputError(
            f"{directory}: its summary does not have what a picture needs ({type(error).__name__}: {error})",
            "Was it written by another version of hpcinv? Run the job again.",
        ) from error


def _body_picture(path: Path, unit: str | None) -> Picture:
    job = load(path) if path.suffix in JOBS else None
    spec = job.mesh if job else mesh_spec(path, {"unit": unit})

    from hpcinv.mesh import build_body
    from hpcinv.parallel.runtime import MPI
    from hpcinv.pictures.gathering import boundary_of
    from hpcinv.pictures.job_picture import draw_job, draw_mesh

    def report(text: str) -> None:
        print(f"meshing {spec.file}: {text}", file=sys.stderr, flush=True)

    regions, resolve = (job.regions, job.resolve) if job else ({}, lambda _file: path)
    body = build_body(spec, regions, MPI.COMM_SELF, resolve=resolve, report=report)
    if job:
        parts = [part for solve in job.plan for part in (*solve.job.supports, *solve.job.effects)]
        for part in parts:
            if (name := getattr(part, "region", None)) is not None:
                body.facets(name)  # raises MeshError if the mesh lacks it
    boundary = boundary_of(body)
    assert boundary is not None  # there is one rank
    return draw_job(job, boundary) if job else draw_mesh(path.name, boundary)
