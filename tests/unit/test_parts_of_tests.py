"""Parts of the long suite: each test is in one, they are about as long, and each commit has the next."""

from __future__ import annotations

import pytest
from helpers.parts import SECONDS, USUAL, files_of_part, parsed

TESTS = [f"tests/a{file}.py::test_{number}" for file in range(30) for number in range(file % 7 + 1)]
LONG = next(iter(SECONDS))


def test_each_file_is_in_one_part_and_parts_are_as_long() -> None:
    parts = [files_of_part(TESTS, number, 4) for number in range(1, 5)]
    assert sorted(file for part in parts for file in part) == sorted({test.partition("::")[0] for test in TESTS})
    counts = [sum(test.partition("::")[0] in part for test in TESTS) for part in parts]
    assert max(counts) - min(counts) <= 1
    assert files_of_part(reversed(TESTS), 2, 4) == parts[1]


def test_a_file_of_long_tests_has_a_part_of_its_own() -> None:
    long = int(len(TESTS) * USUAL / SECONDS[LONG]) + 1
    parts = [files_of_part([*TESTS, *[f"{LONG}::test_{i}" for i in range(long)]], number, 2) for number in (1, 2)]
    assert {LONG} in parts


def test_each_commit_has_the_next_part() -> None:
    assert [parsed("auto/3", commits) for commits in (5, 6, 7)] == [(3, 3), (1, 3), (2, 3)]
    assert parsed("2/8", 5) == (2, 8)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "auto", "auto/0", "-1/3", "1/3/2"])
def test_other_parts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=f"--part {text}: must be K/N or auto/N"):
        parsed(text, 1)
