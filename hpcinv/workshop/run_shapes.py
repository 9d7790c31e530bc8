"""Shapes of a finished run: what it was given, and what it found."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from hpcinv.errors import OutputError
from hpcinv.files.names import is_file
from hpcinv.mesh.body import read_source
from hpcinv.mesh.readers import FILES
from hpcinv.mesh.source import MeshSource
from hpcinv.output.run_directory import RunDirectory

type Shape = Literal["undeformed", "deformed"]


def read_shape(run: Path, shape: Shape) -> MeshSource:
    """Read a shape of a run on this process, in m.

    Raises:
        OutputError: there is no run, it is not finished, or it has not kept this shape.
        MeshError: the given mesh cannot be read any more.
    """
    summary = _summary(run)
    found: Shape = "undeformed" if summary["solutions"][0]["direction"] == "inverse" else "deformed"
    if shape == found:
        return _found(run)
    job = RunDirectory(run).job(None)
    if job.accuracy:
        raise OutputError(
            f"{run}: the {shape} shape was given to this run, which made meshes of its own (accuracy)",
            f"Export the {found} shape.",
        )
    return read_source(job.mesh, job.resolve(job.mesh.file))


def _summary(run: Path) -> dict[str, Any]:
    if not run.is_dir():
        raise OutputError(f"{run}: no such directory", "Give the directory that 'run' printed at its beginning.")
    directory = RunDirectory(run)
    if (summary := directory.summary()) is None:
        begun = directory.is_begun and is_file(run / "job.yaml")
        raise OutputError(
            f"{run}: {'the run is not finished' if begun else 'is not the directory of a finished run'}",
            f"Finish it by 'resume {run}'." if begun else "Give the directory that 'run' printed at its beginning.",
        )
    if summary["status"] != "converged":
        raise OutputError(
            f"{run}: the run failed, and has no shape: {summary['status']}",
            "summary.json and run.log tell what to try.",
        )
    return summary


def _found(run: Path) -> MeshSource:
    for suffix, read in FILES.items():
        path = run / f"shape{suffix}"
        if path.exists():
            source = read(path)
            return source.in_metres(source.unit or 1.0) if suffix != ".bp" else source
    raise OutputError(f"{run}: has no file of the shape", "Run it again with output: {mesh: [msh]}.")
