"""Batches of tests under one mpiexec: what fails is named, and nothing that passed is run twice."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread

import pytest
from helpers.batches import Batch, _alone, _among_others


class Pretended(Batch):
    """A batch of which some tests fail on the last rank, while rank 0 has gone on by ``ahead`` tests."""

    def __init__(self, failing: set[str], ahead: int = 0) -> None:
        super().__init__("batch", 2, list("abcdef"), Path())
        self.failing, self.ahead = failing, ahead
        self.runs: list[str] = []

    def _run(self, tests: list[str], prefix: Path) -> int:
        self.runs.append("".join(tests))
        good = next((n for n, test in enumerate(tests) if test in self.failing), len(tests))
        for rank, ended in enumerate((good + self.ahead, good)):
            Path(f"{prefix}.{rank}").write_text("".join(f"{test}\n" for test in tests[:ended]))
        return int(good < len(tests))


@pytest.mark.parametrize("ahead", [0, 2])
@pytest.mark.parametrize(
    ("failing", "runs"),
    [("", ["abcdef"]), ("c", ["abcdef", "def"]), ("af", ["abcdef", "bcdef"]), ("cd", ["abcdef", "def", "ef"])],
)
def test_after_a_failure_only_what_came_after_it_is_run(
    failing: str, runs: list[str], ahead: int, tmp_path: Path
) -> None:
    batch = Pretended(set(failing), ahead)
    assert [test for test in "abcdef" if not batch.has_passed(test, tmp_path)] == list(failing)
    assert batch.runs == runs


def test_a_batch_that_fails_as_it_ends_names_its_last_test(tmp_path: Path) -> None:
    batch = Pretended(set())
    batch._run = lambda tests, prefix: Pretended._run(batch, tests, prefix) or 1  # type: ignore[method-assign]
    assert [test for test in "abcdef" if not batch.has_passed(test, tmp_path)] == ["f"]


def test_a_batch_with_all_processors_waits_for_others_and_they_for_it(tmp_path: Path) -> None:
    begins, end, later = Event(), Event(), Event()

    def batch() -> None:
        with _alone(tmp_path):
            begins.set()
            end.wait(5)

    def other() -> None:
        with _among_others(tmp_path):
            later.set()

    threads = [Thread(target=batch), Thread(target=other)]
    with _among_others(tmp_path), _among_others(tmp_path):
        threads[0].start()
        assert not begins.wait(0.05)
    assert begins.wait(5)
    threads[1].start()
    assert not later.wait(0.05)
    end.set()
    assert later.wait(5)
    for thread in threads:
        thread.join()
