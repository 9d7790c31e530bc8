"""The summary: the same in JSON and HDF5, documented, finite, and whole or not there."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.solutions import made_up
from helpers.verification import HERE

from hpcinv.base.parallel.malloc import release_freed_memory
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings, peak, resident
from hpcinv.errors import OutputError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.output.summary import statistics, write_summary
from hpcinv.trust.certificate import Certificate, Estimate, skipped, upper_bound_line
from hpcinv.trust.certificate.equilibrium_residual import EQUILIBRIUM
from hpcinv.trust.certificate.overlap import OVERLAP
from hpcinv.trust.discretisation.estimate import LayerError

ROOT = Path(__file__).parents[2]
NOT_OF_EVERY_JOB = {
    "errors.expected_shape",
    "mesh.inputs",
    "states",
    "solutions[].state",
    "solutions[].constraints",
    "solutions[].cavities",
    "solutions[].remote_loads",
    "solutions[].coarse",
    "unwritten",
    "shape_files",
    "quantity_units",  # of named quantities; those above are none of the job's
}


def job(**other: Any) -> Job:
    data = {
        "mesh": {"file": "../meshes/box.py", "parameters": {"nx": 2, "ny": 2, "nz": 2}},
        "material": {"law": "mooney-rivlin", "c1": "0.1 MPa", "c2": "0.15 MPa", "d1": "800 MPa"},
        "supports": [
            {"region": "boundary", "displacement": ["-k*y", 0, None], "constants": {"k": 0.3}},
            {"region": "z0", "fix": ["z"]},
        ],
        "solver": {"petsc": {"snes_view": None, "mat_mumps_icntl_14": 60}},
    }
    return parse(data | other, HERE)


def result(comm: MPI.Intracomm) -> Result:
    made = job()
    body = build_body(made.mesh, made.regions, comm, resolve=made.resolve)
    zero = np.zeros_like
    there = made_up(body, "inverse", zero, pressure=lambda x: x[:, 0], J_range=(np.float64(0.9), np.inf))
    solutions = there, made_up(body, "forward", zero)
    quantities = {"tip": [1.0, -2.0, np.nan], "volume": np.float64(2.5)}
    closure = {"max": 1e-12, "rms": 1e-13, "relative": 1e-12}
    certificate = Certificate(
        (upper_bound_line(EQUILIBRIUM, np.float64(1e-9), 1e-8, 1e-6), skipped(OVERLAP, "switched off"))
    )
    layer = {"volume": LayerError(np.float64(0.02), "by the tractions on its faces")}
    estimate = Estimate({"volume": 0.1}, {"volume": 2.6}, 1e-4, zero(body.mesh.geometry.x[:, 0]), 300, layer=layer)
    return Result(made, body, solutions, certificate, quantities, {"round_trip": closure}, estimate)


def read(group: h5py.Group) -> dict[str, Any]:
    """The content of a group as the summary has it."""
    values: dict[str, Any] = {}
    for name, value in group.attrs.items():
        values[name] = None if isinstance(value, h5py.Empty) else value.item() if hasattr(value, "item") else value
    for name, value in group.items():
        if isinstance(value, h5py.Group):
            content = read(value)
            values[name] = list(content.values()) if "0" in content else content
        elif value.dtype.names:
            values[name] = [dict(zip(value.dtype.names, row.tolist(), strict=True)) for row in value[()]]
        else:
            values[name] = value[()].tolist()
    return values


def same(a: Any, b: Any) -> bool:
    """Whether what HDF5 gave is what JSON has: NaN in a table stands for null, and text for a mixed list."""
    if isinstance(b, Mapping):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in b)
    if isinstance(b, list) and isinstance(a, str):
        return bool(json.loads(a) == b)
    if isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return (b is None and a != a) or (a == b and (isinstance(a, str) == isinstance(b, str)))


def keys(content: Any, path: str = "") -> Iterator[str]:
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from keys(value, f"{path}.{key}" if path else key)
    elif isinstance(content, list) and content and isinstance(content[0], Mapping):
        yield from keys(content[0], f"{path}[]")
    else:
        yield path


@pytest.mark.parallel([1, 2])
def test_a_summary_is_finite_the_same_in_both_files_and_documented(comm: MPI.Intracomm, run_directory: Path) -> None:
    timings = Timings()
    with timings("tangent"):
        time.sleep(0.05 * (1 + comm.rank))
    if comm.rank == 0:
        with timings("only on rank 0"):
            time.sleep(0.02)
    content = statistics(result(comm), "converged", 1234, ["snes_view"], timings, comm)
    assert comm.allgather(content) == [content] * comm.size
    write_summary(run_directory, content, comm)
    write_summary(run_directory, content, comm)  # a resumed run writes it again
    if comm.rank > 0:
        return
    assert sorted(p.name for p in run_directory.iterdir()) == ["summary.h5", "summary.json"]
    text = (run_directory / "summary.json").read_text()
    assert json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in JSON")) == content
    with h5py.File(run_directory / "summary.h5") as file:
        assert same(read(file), content)
        table = file["solutions/0/solves/1/iterations"]
        assert table.dtype["correction"].kind == "f"
        assert table["new_tangent"].tolist() == [True, False]

    assert content["job"]["solver"]["petsc"] == {"snes_view": None, "mat_mumps_icntl_14": 60}
    assert content["fingerprint"] == json.loads(json.dumps(fingerprint(job())))
    assert content["mesh"]["cells"] == sum(content["partition"]["cells"]) == 48
    assert content["mesh"]["nodes"] == 27
    inverse, forward = content["solutions"]
    assert (inverse["direction"], inverse["formulation"], inverse["degrees"]["pressure"]) == ("inverse", "mixed", 1)
    assert (forward["direction"], forward["formulation"], forward["degrees"]["pressure"]) == (
        "forward",
        "displacement",
        None,
    )
    assert inverse["J"] == {"min": 0.9, "max": None}
    assert (inverse["load"], inverse["factorizations"], inverse["newton_iterations"]) == (1.0, 4, 5)
    assert [s["outcome"] for s in inverse["solves"]] == ["INVERTED", "CONVERGED", "ROUND_OFF"]
    assert content["quantities"] == {"tip": [1.0, -2.0, None], "volume": 2.5}
    assert all(content["versions"].values())

    phases, total = content["timings"]["phases"], content["timings"]["total"]
    assert phases["tangent"]["min"] >= 0.05
    assert phases["tangent"]["max"] >= 0.05 * comm.size
    assert (phases["only on rank 0"]["min"] == 0) == (comm.size > 1)
    assert sum(p["min"] for p in phases.values()) <= total <= sum(p["max"] for p in phases.values()) * (1 + 1e-12)
    assert 1 - phases["tangent"]["max"] / total - 1e-9 <= content["timings"]["overhead"] < 1
    assert len(content["peak_memory"]["ranks"]) == comm.size
    assert all(3e7 < m < 1e11 for m in content["peak_memory"]["ranks"])
    sizes = content["peak_memory"]["phases"]
    assert sizes.keys() == {"tangent", "other"} | {"only on rank 0"}
    assert all(3e7 < size["max"] <= max(content["peak_memory"]["ranks"]) for size in sizes.values())

    # Every key has its row, and every row its key.
    text = (ROOT / "docs" / "reference" / "summary.md").read_text()
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    documented = {key for row in rows for key in re.findall(r"`([^`]+)`", row)} - NOT_OF_EVERY_JOB
    there = {*keys(content)}
    assert [k for k in there if not any(k == d or k.startswith(f"{d}.") for d in documented)] == []
    assert [d for d in documented if not any(k == d or k.startswith(f"{d}.") for k in there)] == []
    outcomes = set(re.findall(r"`([A-Z_]+)`", text))
    assert outcomes == {outcome.name for outcome in Outcome}


@pytest.mark.release
def test_the_memory_of_a_phase_is_what_it_holds_or_the_peak_that_it_makes() -> None:
    release_freed_memory()
    timings, block = Timings(), 200_000_000
    with timings("before"):
        beyond = peak() - resident() + 2 * block
    with timings("outer"):
        held = np.ones(block // 8)
        with timings("inner"):
            del held
            release_freed_memory()
        with timings("peak"):  # of the process, but gone when the phase ends
            assert np.ones(beyond // 8).sum() > 0
    sizes = timings.memory.phases
    assert sizes["outer"] >= sizes["before"] + 0.95 * block
    assert sizes["inner"] <= sizes["outer"] - 0.95 * block
    assert sizes["peak"] >= sizes["before"] + 0.95 * beyond
    timings.move("peak", "of PETSc", 0.1)
    assert sizes["of PETSc"] == sizes["peak"] == peak()


@pytest.mark.parallel([2])
def test_a_summary_that_cannot_be_written_is_an_error_on_all_ranks(comm: MPI.Intracomm, run_directory: Path) -> None:
    with pytest.raises(OutputError, match=r"summary.json: cannot be written"):
        write_summary(run_directory / "none", {"status": "converged"}, comm)
    in_the_way = run_directory / "summary.h5" / "full"
    if comm.rank == 0:
        in_the_way.mkdir(parents=True)
    comm.Barrier()
    with pytest.raises(OutputError, match=r"summary.h5: cannot be written"):
        write_summary(run_directory, {"status": "converged"}, comm)
    assert sorted(p.name for p in run_directory.iterdir()) == ["summary.h5", "summary.json"]
