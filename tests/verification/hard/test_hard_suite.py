"""That the suite is whole: every hard job says what makes it hard and how it ends, and has a test."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.hard_case import JOBS

TESTS = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))


@pytest.mark.parametrize("path", sorted(JOBS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_hard_job_says_what_it_is_and_has_a_test(path: Path) -> None:
    text = path.read_text()
    for heading in ("# Hard  ", "# Outcome  ", f"# Command    python -m hpcinv run jobs/hard/{path.name}\n"):
        assert heading in text
    assert f'"{path.stem}"' in TESTS
