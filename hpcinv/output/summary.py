"""Summary of a run: its content as plain data, which docs/reference/summary.md explains, and its files."""

import io
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import dolfinx
import numpy as np
from petsc4py import PETSc

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.json_data import json_data
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import WORK, Memory, Timings, peak
from hpcinv.base.quantity.written_units import written_units
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.model.constraint_report import by_section
from hpcinv.output.result import Result
from hpcinv.output.shape_error import shape_error
from hpcinv.results.solution import Solution
from hpcinv.version import __version__


def _omp_threads() -> int | None:
    """Return the threads of each process, the first of a list for nested levels; ``None`` if they are not a number."""
    first = os.environ.get("OMP_NUM_THREADS", "1").partition(",")[0].strip()
    return int(first) if first.isdecimal() else None


def statistics(
    result: Result,
    status: str,
    unknowns: int,
    unused_options: Sequence[str],
    timings: Timings,
    comm: MPI.Intracomm,
    *,
    advice: str = "",
) -> dict[str, Any]:
    """Return the summary of a run as JSON data, its numbers finite or ``None``, the same on every rank; collective.

    Args:
        status: "converged", or the reason why the run ended.
        advice: what to try if it did not reach the full load.
    """
    job, body = result.job, result.body
    content = {
        "status": status,
        "advice": advice or None,
        "job": job.model_dump(mode="json"),
        "fingerprint": on_root(comm, lambda: fingerprint(job)),  # other ranks may not see the mesh file
        "versions": versions(),
        "machine": {"ranks": comm.size, "omp_threads": _omp_threads()},
        "mesh": comm.bcast(_mesh(body)) | {"file": job.mesh.file, "unknowns": unknowns},
        "body": result.totals and result.totals.as_data(),
        "partition": asdict(body.partition) | {"imbalance": body.partition.imbalance},
        **({"states": _states(job)} if job.states else {}),
        "solutions": [_solution(solution, job.discretisation.displacement) for solution in result.solutions],
        "unused_petsc_options": list(unused_options),
        "quantities": dict(result.quantities),
        "units": written_units(job.data),
        "quantity_units": dict(getattr(result.quantities, "units", {})),
        "sensitivities": result.sensitivities and result.sensitivities.as_data(),
        "surface_errors": result.surface_spread and result.surface_spread.as_data(),
        "errors": dict(result.errors),
        "certificate": result.certificate.as_data() | {"estimate": result.estimate and result.estimate.as_data()},
        "accuracy": comm.bcast(result.accuracy and result.accuracy.as_data()),  # with the seconds of rank 0
        "timings": _timings(timings, comm),
        "peak_memory": _memory(timings.memory, comm),
    }
    error = shape_error(content) if status == "converged" else None
    content["shape_error"] = error and error.as_data()
    return json_data(content)  # type: ignore[no-any-return]  # a dict remains a dict


def versions() -> dict[str, str | None]:
    """Return the versions of hpcinv and its libraries; ``None`` if a library was installed without one."""
    return {
        "python": platform.python_version(),
        "hpcinv": __version__,
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "mpi": " ".join(MPI.Get_library_version().split("\n")[0].split()),
        **{name: _version_of(name) for name in ("gmsh", "adios2", "numpy")},
    }


@cache  # the search takes 5 ms; a sweep would make thousands
def _version_of(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:  # a local build
        return None


def _mesh(body: Body) -> dict[str, Any]:
    return {
        "cells": body.mesh.topology.index_map(3).size_global,
        "nodes": body.source_geometry.index_map().size_global,
        "kind": body.source.kind,
        "geometry_degree": body.source.degree,
        "inputs": dict(body.source.inputs),
    }


def _states(job: Job) -> dict[str, Any]:
    """Return by name of each state what it is, and the number of its solution, ``None`` for the rest shape."""
    solved = {solve.job.state: number for number, solve in enumerate(job.plan)}
    given = next(state.name for state in job.states if state.given)
    names = list(dict.fromkeys([*(state.name for state in job.states), job.rest]))
    return {name: {"given": name == given, "rest": name == job.rest, "solution": solved.get(name)} for name in names}


def _solution(solution: Solution, displacement: int) -> dict[str, Any]:
    pressure = None if solution.pressure is None else solution.pressure.function_space.ufl_element().degree
    return {
        **({"state": solution.state} if solution.state else {}),
        "direction": solution.direction,
        "formulation": "displacement" if pressure is None else "mixed",
        "degrees": {"displacement": displacement, "pressure": pressure},
        "load": solution.load,
        "factorizations": solution.factorizations,
        **({"coarse": solution.coarse.as_data()} if solution.coarse else {}),
        "iterations": sum(s.position_residual is not None for s in solution.solves),
        "newton_iterations": sum(len(s.iterations) for s in solution.solves),
        "linear": solution.linear
        and asdict(solution.linear) | {"iterations": sum(s.linear_iterations for s in solution.solves)},
        "largest_displacement": solution.largest_displacement,
        "J": {"min": solution.J_range[0], "max": solution.J_range[1]},
        "strain_energy": solution.strain_energy,
        "contacts": [contact.as_data() for contact in solution.contacts],
        **by_section(solution.constraints),
        "solves": [asdict(s) | {"outcome": s.outcome.name} for s in solution.solves],
    }


def _timings(timings: Timings, comm: MPI.Intracomm) -> dict[str, Any]:
    """Return seconds by phase over the ranks, and the share of the wall time that is not `WORK`."""
    total, mine = timings.total, dict(timings.seconds)
    mine["other"] = total - sum(mine.values())
    work = sum(counted.get(phase, 0.0) for phase in WORK for counted in (mine, timings.inner_seconds))
    every = comm.allgather(mine)
    phases = {phase: [seconds.get(phase, 0.0) for seconds in every] for phase in sorted(set().union(*every))}
    return {
        "total": comm.allreduce(total, op=MPI.MAX),
        "phases": {phase: {"min": min(seconds), "max": max(seconds)} for phase, seconds in phases.items()},
        "overhead": comm.allreduce(1 - work / total, op=MPI.MAX),
    }


def _memory(memory: Memory, comm: MPI.Intracomm) -> dict[str, Any]:
    """Return the largest resident size in bytes of each rank, and of each phase over the ranks."""
    phases = comm.allgather(memory.phases)
    return {
        # Linux counts a process's memory in two ways that differ by some pages: a phase may exceed the peak.
        "ranks": comm.allgather(max([peak(), *memory.phases.values()])),
        "phases": {
            phase: {"max": max(sizes.get(phase, 0) for sizes in phases)} for phase in sorted(set().union(*phases))
        },
    }


def write_summary(
    directory: Path, statistics: Mapping[str, Any], comm: MPI.Intracomm, *, formats: Sequence[str] = ("json", "h5")
) -> None:
    """Write a summary on rank 0, as a file in each format, which appears whole or not at all; collective.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """

    on_root(comm, lambda: write_on_this_rank(directory, statistics, formats))


def write_on_this_rank(directory: Path, statistics: Mapping[str, Any], formats: Sequence[str]) -> None:
    """Write a summary as `write_summary`; not collective."""
    for form in formats:
        write_output(directory / f"summary.{form}", CONTENTS[form](statistics), "Is the directory there, and space?")


def _as_json(statistics: Mapping[str, Any]) -> bytes:
    return (json.dumps(statistics, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _as_hdf5(statistics: Mapping[str, Any]) -> bytes:
    import h5py  # on rank 0 alone

    # In memory, since on a full disk h5py raises no OSError and leaves a file that cannot be closed.
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        _fill(file, statistics)
    return content.getvalue()


CONTENTS: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = {"json": _as_json, "h5": _as_hdf5}


def _fill(group: Any, content: Mapping[str, Any]) -> None:
    """Write a mapping to an HDF5 group.

    Mappings become groups, single values attributes (``None`` an empty one), lists of numbers datasets. Lists of
    mappings become a table where these have the same numbers, else groups 0, 1, …; any other list is JSON text.
    """
    import h5py

    for key, value in content.items():
        name = key.replace("/", "|")  # HDF5 reads it as a path
        if isinstance(value, Mapping):
            _fill(group.create_group(name), value)
        elif value is None:
            group.attrs[name] = h5py.Empty("f8")
        elif not isinstance(value, list):
            group.attrs[name] = value
        elif value and all(isinstance(v, Mapping) for v in value):
            table = _table(value)
            if table is None:
                _fill(group.create_group(name), {str(i): v for i, v in enumerate(value)})
            else:
                group[name] = table
        elif all(_is_number(v) for v in value):
            group[name] = np.array(value)
        else:
            group.attrs[name] = json.dumps(value, ensure_ascii=False)


def _table(rows: Sequence[Mapping[str, Any]]) -> np.ndarray | None:
    """Return rows with the same numbers and flags as a structured array; ``None`` if that is not possible."""
    names = rows[0].keys()
    if any(row.keys() != names for row in rows):
        return None
    columns = [_column([row[name] for row in rows]) for name in names]
    whole = [column for column in columns if column is not None]
    if len(whole) < len(columns):
        return None
    table = np.empty(len(rows), dtype=[(name, column.dtype) for name, column in zip(names, whole, strict=True)])
    for name, column in zip(names, whole, strict=True):
        table[name] = column
    return table


def _column(values: Sequence[Any]) -> np.ndarray | None:
    """Return flags, or numbers with NaN for ``None``; ``None`` if some value is neither."""
    if all(isinstance(value, bool) for value in values):
        return np.array(values)
    if all(value is None or _is_number(value) for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype="f8")
    return None


def _is_number(value: object) -> bool:
    return isinstance(value, bool | int | float)
