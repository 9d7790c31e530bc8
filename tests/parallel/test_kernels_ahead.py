"""Kernels of a certificate, compiled by a second process while a run compiles the kernels of its solve."""

from __future__ import annotations

import os
from typing import Any

import pytest
from helpers.verification import box, job

from hpcinv import driver, kernels_ahead
from hpcinv.certificate import certify_all
from hpcinv.cli.rehearsal import rehearse_certificate
from hpcinv.parallel import jit
from hpcinv.parallel.runtime import MPI
from hpcinv.preparation import prepare

BLOCK: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": box((2, 1, 1)),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, -1, 0], "density": 1000}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    "discretisation": {"displacement": 1},
    "certificate": "standard",
}


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the kernels that this process loads from now on."""
    names, load = list[str](), jit._load

    def recorded(path: Any, objects: Any) -> Any:
        names.append(path.stem)
        return load(path, objects)

    monkeypatch.setattr(jit, "_load", recorded)
    return names


def test_second_process_compiles_what_the_certificate_needs(loaded: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """All kernels that the checks of a run load are loaded by its rehearsal, or by the solve before."""
    given, number_of_solve, prepared = job(**BLOCK), list[int](), list[Any]()

    def counted(*arguments: Any) -> Any:
        number_of_solve.append(len(loaded))
        return certify_all(*arguments)

    def kept(*arguments: Any) -> Any:
        prepared.append(prepare(*arguments))
        return prepared[0]

    monkeypatch.setattr(driver, "certify_all", counted)
    monkeypatch.setattr(driver, "prepare", kept)
    driver.run(given, MPI.COMM_SELF)
    solve, checks = loaded[: number_of_solve[0]], loaded[number_of_solve[0] :]
    source, forecast = prepared[0].body.source, prepared[0].equations[0].chooser.forecast
    loaded.clear()
    rehearse_certificate(given, source, forecast)
    assert len({*checks} - {*solve}) > 4
    assert {*checks} - {*solve} <= {*loaded}


@pytest.mark.parallel([1, 2])
def test_first_missing_kernel_starts_a_second_process(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """On rank 0, if there is an idle second processor; it succeeds with what the run has pickled for it."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(comm.size))
    monkeypatch.setattr(os, "getloadavg", lambda: (1.0, 1.0, 1.0))
    codes, find, missing = list[int](), jit._find, [True]

    def end(child: Any) -> None:
        codes.append(child.wait(120.0))

    def first_missing(name: str, *arguments: Any) -> Any:
        return None if name.startswith("libffcx") and missing and missing.pop() else find(name, *arguments)

    monkeypatch.setattr(kernels_ahead, "_end", end)
    monkeypatch.setattr(jit, "_find", first_missing)
    driver.run(job(**BLOCK | {"certificate": "quick"}), comm, compiles_ahead=True)
    assert codes == ([0] if comm.size == 2 and comm.rank == 0 else [])


def test_second_process_ends_with_the_run() -> None:
    child = kernels_ahead._start(b"")  # fails at it
    kernels_ahead._end(child)
    assert child.returncode != 0


def test_second_process_needs_an_idle_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLURM_CPUS_ON_NODE", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(2))
    for load, is_idle in ((0.4, True), (1.2, True), (2.0, False)):
        monkeypatch.setattr(os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        assert kernels_ahead._has_idle_processor(1) == is_idle


def test_second_process_keeps_to_the_allocation_of_slurm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(8))  # ranks that are not bound see all
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    for allocated, ranks, has_one in (
        ("1", 1, False),
        ("2", 1, True),
        ("2", 2, False),
        ("3", 2, True),
        ("2(x3)", 2, True),
        ("", 2, True),
    ):
        monkeypatch.setenv("SLURM_CPUS_ON_NODE", allocated)
        assert kernels_ahead._has_idle_processor(ranks) == has_one
