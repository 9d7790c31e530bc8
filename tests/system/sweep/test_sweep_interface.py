"""Sweeps from Python."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from helpers.command_line import BLOCK
from helpers.sweeps import write_sweep
from helpers.without_compiler import without_compiler

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, OutputError
from hpcinv.studies.sweep.sweep_interface import Table

AXES = [{"grid": {"material.mu": ["10 kPa", "20 kPa"]}}]


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_a_sweep_gives_a_table_that_pandas_takes(run_directory: Path, comm: MPI.Intracomm) -> None:
    if comm.rank == 0:
        write_sweep(run_directory, AXES)
    comm.Barrier()
    table: Table = hpcinv.sweep(run_directory / "sweep.yaml", comm)
    frame = pd.DataFrame(table)
    assert list(frame["material.mu"]) == [1e4, 2e4]
    assert list(frame["status"]) == ["converged", "converged"]
    assert frame["top"].is_monotonic_increasing  # the stiffer block is pressed down less
    assert (frame["top"] < 0).all()
    assert table.units["top"] == "m"
    assert table.units["material.mu"] == "Pa"


@pytest.mark.release
def test_a_mapping_is_a_sweep_and_cases_are_solved_once(tmp_path: Path, comm: MPI.Intracomm) -> None:
    write_sweep(tmp_path, AXES)
    lines: list[str] = []
    source = {"job": "block.yaml", "store": "store", "axes": AXES}
    first = hpcinv.sweep(source, comm, directory=tmp_path, note=lines.append)
    assert len(lines) == 2
    assert hpcinv.sweep(tmp_path / "sweep.yaml", comm, note=lines.append) == first
    assert len(lines) == 2


def test_a_sweep_says_once_that_there_is_no_compiler(tmp_path: Path, comm: MPI.Intracomm) -> None:
    write_sweep(tmp_path, AXES)
    lines: list[str] = []
    with without_compiler():
        table = hpcinv.sweep(tmp_path / "sweep.yaml", comm, note=lines.append)
    assert set(table["status"]) == {"converged"}
    assert ["no C compiler 'cc': NumPy evaluates" in line for line in lines] == [True, False, False]


@pytest.mark.release
def test_a_case_that_fails_is_reported_in_the_table(tmp_path: Path, comm: MPI.Intracomm) -> None:
    write_sweep(tmp_path, [{"grid": {"material.mu": ["10 kPa", "1 Pa"]}}])
    table = hpcinv.sweep(tmp_path / "sweep.yaml", comm)
    assert table["status"][0] == "converged"
    assert table["status"][1] not in ("converged", "open")
    assert table["top"][1] is None


def test_faulty_sweeps_raise_an_error(tmp_path: Path, comm: MPI.Intracomm) -> None:
    with pytest.raises(JobError, match=r"\(mapping\): axes"):
        hpcinv.sweep({"job": "block.yaml", "axes": 3}, comm, directory=tmp_path)
    with pytest.raises(JobError, match="is not a sweep, since it has no 'axes'"):
        hpcinv.sweep(BLOCK, comm)
    write_sweep(tmp_path, AXES)
    with pytest.raises(OutputError, match="1 ranks cannot be divided into groups"):
        hpcinv.sweep(tmp_path / "sweep.yaml", comm, ranks_per_case=2)
