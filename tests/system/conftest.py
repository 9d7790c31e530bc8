"""System tests: only the door writes the state of a model; and the begin of a study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from helpers.study_runs import Begin

from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.study.directory import STORE, StudyDirectory
from hpcinv.studies.study.study_plan import StudyPlan
from hpcinv.studies.study.study_run import StudySchedule


@pytest.fixture
def begin() -> Iterator[Begin]:
    """Begins a study in a directory, as a process does on one rank or more; the holders live as long as the test."""
    with ExitStack() as held:

        def schedule(plan: StudyPlan, directory: Path, ranks: int = 1) -> StudySchedule:
            store = StudyDirectory(directory / "out", plan.study.study).path / STORE
            return StudySchedule(plan, Ledger(store, held.enter_context(Holder(store))), 0.0, ranks)

        yield schedule


@pytest.fixture(autouse=True)
def only_the_door_writes() -> Iterator[None]:
    """Raise where something else writes mesh, unknowns, load factors or supports."""
    from helpers.door_guard import guarded

    with guarded():
        yield
