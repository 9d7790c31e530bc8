"""Cases on a line through the space of numbers begin with values of one power series."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK
from helpers.sweeps import records_of, write_sweep

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.solver.methods.method import GUESS
from hpcinv.studies.sweep import queue, runner
from hpcinv.studies.sweep.sweep_interface import Table
from hpcinv.studies.sweep.sweep_plan import load_sweep

SHEARED: Mapping[str, Any] = BLOCK | {
    "analysis": "forward",
    "mesh": {"file": BLOCK["mesh"]["file"], "parameters": {"nx": 1, "ny": 1, "nz": 2}},
    "supports": [
        {"region": "z0", "fix": ["x", "y", "z"]},
        {"region": "z1", "displacement": ["s", "0", "-0.02 m"], "constants": {"s": "0.1 m"}},
    ],
    "quantities": [{"name": "middle", "of": "uz", "at": [0, 0.5, 0.5]}],
}
ROUND_TRIP: Mapping[str, Any] = {**BLOCK, "analysis": "round_trip", "certificate": "off"}
STIFFNESSES = [f"{mu:.4g} kPa" for mu in np.random.default_rng(0).permutation(np.linspace(5, 25, 14))]


@pytest.fixture(autouse=True)
def _expand_small_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "SET_UP", 0)


def solved(path: Path, comm: MPI.Intracomm, lines: list[str]) -> Table:
    return hpcinv.sweep(path, comm, ranks_per_case=comm.size, note=lines.append)


def check_alone(path: Path, comm: MPI.Intracomm, table: Table, name: str, numbers: list[int]) -> None:
    plan = load_sweep(path)
    for number in numbers:
        alone = run(plan.job(plan.cases[number]), comm).quantities[name]
        assert table[name][number] == pytest.approx(alone, rel=1e-9)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_a_modulus_takes_few_factorizations(run_directory: Path, comm: MPI.Intracomm) -> None:
    """In any order of its values, over a range of one to five; a second start goes on with the cases left."""
    path, lines = run_directory / "sweep.yaml", list[str]()
    for values in (STIFFNESSES[:3], STIFFNESSES):
        if comm.rank == 0:
            write_sweep(run_directory, [{"grid": {"material.mu": values}}])
        comm.barrier()
        table = solved(path, comm, lines)
    assert set(table["status"]) == {"converged"}
    factorizations = np.array(table["factorizations"])
    assert factorizations[3:].sum() <= 6
    assert (factorizations == 0).sum() >= 9
    check_alone(path, comm, table, "top", [9])
    if comm.rank == 0:
        assert sum("from a power series" in line for line in lines) >= 9


@pytest.mark.parallel([1, 2])
def test_lines_of_several_axes_are_followed(run_directory: Path, comm: MPI.Intracomm) -> None:
    """A prescribed displacement and a modulus; the axis with more values is the line."""
    shears = [f"{s:.4g} m" for s in np.linspace(-0.2, 0.2, 9)]
    axes = [{"grid": {"supports[1].constants.s": shears}}, {"grid": {"material.mu": ["8 kPa", "10 kPa"]}}]
    path, lines = run_directory / "sweep.yaml", list[str]()
    if comm.rank == 0:
        write_sweep(run_directory, axes, job=SHEARED)
    comm.barrier()
    table = solved(path, comm, lines)
    assert set(table["status"]) == {"converged"}
    check_alone(path, comm, table, "middle", [1, 6])
    if comm.rank == 0:
        titles = [line.partition(":")[0].split(", ") for line in lines]
        assert len({mu for *_, mu in titles[:9]}) == 1
        assert sum("from a power series" in line for line in lines) >= 14


@pytest.mark.release
def test_each_solve_of_a_round_trip_begins_with_its_neighbours(run_directory: Path, comm: MPI.Intracomm) -> None:
    path = write_sweep(run_directory, [{"grid": {"material.mu": STIFFNESSES[:2]}}], job=ROUND_TRIP)
    table = solved(path, comm, [])
    assert set(table["status"]) == {"converged"}
    records = [record for record in records_of(path).values() if record is not None]
    strategies = [[one["solves"][0]["strategy"] for one in record.statistics["solutions"]] for record in records]
    assert sorted(strategies) == [[GUESS, GUESS], ["load steps", "load steps"]]


def test_reason_without_a_series_is_given_once(
    tmp_path: Path, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queue, "LEAST_AHEAD", 1)
    monkeypatch.setattr(runner, "EXPANSION", 0)
    wall = {"shape": "plane", "point": [0, 0, 0.99], "normal": [0, 0, -1]}
    effects = [*BLOCK["effects"], {"effect": "contact", "region": "z1", "obstacle": wall, "penetration": "5 mm"}]
    job = {**SHEARED, "effects": effects, "supports": SHEARED["supports"][:1]}
    path, lines = (
        write_sweep(tmp_path, [{"grid": {"material.mu": ["9 kPa", "10 kPa", "11 kPa"]}}], job=job),
        list[str](),
    )
    assert set(solved(path, comm, lines)["status"]) == {"converged"}
    assert ["no power series: it has a switch" in line for line in lines] == [True, False, False]
