"""Shapes of a finished run: what it was given, and what it found."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from hpcinv.base.files.names import is_file
from hpcinv.base.mesh_formats import FORMATS
from hpcinv.errors import JobError, OutputError
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.shell_section import Shell
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.mesh.body import read_source
from hpcinv.mesh.midsurface import thicken
from hpcinv.mesh.readers import FILES, read_surface
from hpcinv.mesh.source import MeshSource
from hpcinv.output.run_directory import RunDirectory

UNDEFORMED, DEFORMED = "undeformed", "deformed"


_WITH_ALL_NODES = (".msh", ".vtu", ".bp")
"""suffixes of formats that hold any mesh, with all digits"""


def read_shape(run: Path, shape: str) -> MeshSource:
    """Read a shape of a run on this process, in m.

    Args:
        shape: the name of a state, in a run with states, or `UNDEFORMED` or `DEFORMED`.

    Raises:
        OutputError: there is no run, it is not finished, or it has not kept this shape.
        MeshError: the given mesh cannot be read any more.
    """
    summary = _summary(run)
    if states := summary.get("states"):
        (given,), (rest,) = ([name for name, state in states.items() if state[kind]] for kind in ("given", "rest"))
        name = rest if shape == UNDEFORMED and shape not in states else shape
        if name not in states:
            raise OutputError(
                f"{run}: has no state '{shape}'; its states are {', '.join(states)}",
                "Give one of them, or 'undeformed' for the rest shape.",
            )
        return _given(run, name) if name == given else _found(run, f"shape-{name}")
    if shape not in (UNDEFORMED, DEFORMED):
        raise OutputError(
            f"{run}: has no state '{shape}': the job of this run has no states",
            f"Give '{UNDEFORMED}' or '{DEFORMED}'.",
        )
    computed = UNDEFORMED if summary["solutions"][0]["direction"] == "inverse" else DEFORMED
    return _found(run, "shape") if shape == computed else _given(run, shape)


def left_out(run: Path, source: MeshSource) -> float:
    """Return the largest distance (m) of a shape that was read from the body that the run computed."""
    files: dict[str, float] = _summary(run).get("shape_files", {})
    return files.get(source.path.name, 0.0) if source.path.parent == run else 0.0


def read_cad(run: Path) -> tuple[Path, MeshSpec, MeshSource]:
    """Return the CAD file of a run's job, its section, and its mesh in m.

    Raises:
        OutputError: the job has none.
    """
    job = RunDirectory(run).job(None)
    if not job.mesh.is_cad:
        raise OutputError(f"{run}: its job has no CAD file (mesh.cad), whose faces could be refitted")
    path = job.resolve(job.mesh.file)
    return path, job.mesh, read_source(job.mesh, path)


def _given(run: Path, shape: str) -> MeshSource:
    """Read the mesh of the run's job."""
    job = RunDirectory(run).job(None)
    if job.accuracy:
        raise OutputError(
            f"{run}: the shape '{shape}' was given to this run, which made meshes of its own (accuracy)",
            "Export a shape that it found.",
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
    if summary["status"] != "converged" and not _is_solved(directory, summary):
        raise OutputError(
            f"{run}: the run failed, and has no shape: {summary['status']}",
            "summary.json and run.log say what to try.",
        )
    return summary


def _is_solved(directory: RunDirectory, summary: Mapping[str, Any]) -> bool:
    """Return whether all solves of a run that has not reached its end have reached the full load."""
    loads = [solution["load"] for solution in summary["solutions"]]
    with suppress(OutputError, JobError):
        return len(loads) == len(directory.job(None).directions) and all(load == 1.0 for load in loads)
    return False


def unchecked(run: Path) -> str:
    """Return why the certificate of a run is not complete; empty if it is."""
    status = str(_summary(run)["status"])
    return (
        "" if status == "converged" else f"the certificate is not complete ({status}): 'hpcinv resume {run}' makes it"
    )


def _found(run: Path, name: str) -> MeshSource:
    given = (read_yaml(run / "job.yaml").get("mesh") or {}).get("shell")
    kept = [path for suffix in (".msh", ".vtu") if is_file(path := run / f"{name}{suffix}")]
    if given and kept:
        source = read_surface(kept[0])
        shell = Shell.model_validate({**given, "thickness": None, "director": "data"})
        return thicken(source.convert_to_metres(source.unit or 1.0), shell)
    for suffix in sorted(FILES, key=lambda suffix: suffix not in _WITH_ALL_NODES):
        path = run / f"{name}{suffix}"
        if path.exists():
            read = FILES[suffix]
            source = read(path)
            return source.convert_to_metres(source.unit or 1.0) if not FORMATS[suffix].is_partitioned else source
    raise OutputError(
        f"{run}: has no file of the shape ({name}.msh, .vtu or .bp)", "Run it again with output: {mesh: [msh]}."
    )
