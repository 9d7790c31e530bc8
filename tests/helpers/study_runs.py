"""What tests of studies execute and read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.study.study_run import StudySchedule, StudyTask

# What is next, and what is made of it, with made-up records


def statistics(
    value: float, total: float = 1.0, compile_: float = 0.0, unknowns: int = 10, **more: Any
) -> dict[str, Any]:
    phases = {"programs": compile_, "newton": 0.1, "tangent": 0.2, "certificate": 0.05}
    return {
        "quantities": {"length": value},
        "mesh": {"unknowns": unknowns, "cells": unknowns},
        "solutions": [{"factorizations": 2, "newton_iterations": 3}],
        "timings": {"total": total, "phases": {k: {"min": 0.0, "max": v} for k, v in phases.items()}},
        "peak_memory": {"ranks": [100, 200], "phases": {}},
        **more,
    }


def good(value: float, compiled: bool = False, **more: Any) -> CaseRecord:
    return CaseRecord("converged", "", statistics(value, **more), 1.0, 1, compiled=compiled)


BAD = CaseRecord("stopped at load factor 0.5 of 1", "Try again.", {}, 1.0, 1)

type Begin = Callable[..., StudySchedule]


def drain(schedule: StudySchedule, records: Iterator[CaseRecord]) -> list[StudyTask]:
    tasks = []
    while isinstance(task := schedule.next(), StudyTask):
        tasks.append(task)
        assert schedule.executions.ledger.commit(task.claim, next(records))
    return tasks


def reused(schedule: StudySchedule) -> int:
    return schedule.executions.count()[0]


# From the command line

CLOSED_FORM = 1.0802798795986
NZ = (1, 2, 4)
