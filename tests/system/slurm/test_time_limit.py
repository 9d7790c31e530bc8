"""The time limit of a job under a real Slurm, which has passed while the tests of other files ran."""

from __future__ import annotations

import pytest
from helpers.batch import Batch
from helpers.slow_jobs import assert_finished

pytestmark = pytest.mark.slurm


def test_at_its_time_limit_a_job_saves_its_state_and_is_requeued_until_it_is_done(limited: tuple[Batch, str]) -> None:
    batch, job = limited
    batch.wait(job)
    (facts,) = batch.facts(job)
    assert facts["JobState"] == "COMPLETED", batch.outputs()
    assert int(facts["Restarts"]) >= 1
    assert "stopped by a signal" in batch.outputs()
    assert f"job {job}: has saved its state, and is requeued to go on" in batch.outputs()
    assert len(assert_finished(batch.place / "cube")) < 10_000
