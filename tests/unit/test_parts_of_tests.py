"""Parts of the long suite: each test is in one, they are about as long, and each commit has the next."""

from __future__ import annotations

import pytest
from helpers.parts import SECONDS, USUAL, ids_of_part, parsed

TESTS = [f"tests/a{file}.py::test_{number}" for file in range(30) for number in range(file % 7 + 1)]
LONG = next(iter(SECONDS))


def test_each_file_is_in_one_part_and_parts_are_as_long() -> None:
    parts = [ids_of_part(TESTS, number, 4) for number in range(1, 5)]
    assert sorted(test for part in parts for test in part) == sorted(TESTS)
    files = [{test.partition("::")[0] for test in part} for part in parts]
    assert sum(map(len, files)) == 30
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert ids_of_part(reversed(TESTS), 2, 4) == parts[1]


def test_tests_of_a_file_that_is_longer_than_a_part_are_divided() -> None:
    long = [f"{LONG}::test_{i}" for i in range(int(len(TESTS) * USUAL / SECONDS[LONG]) + 2)]
    parts = [ids_of_part([*TESTS, *long], number, 2) for number in (1, 2)]
    assert sorted(test for part in parts for test in part) == sorted([*TESTS, *long])
    counts = [sum(test in part for test in long) for part in parts]
    assert max(counts) - min(counts) <= 1


def test_each_commit_has_the_next_part() -> None:
    assert [parsed("auto/3", commits) for commits in (5, 6, 7)] == [(3, 3), (1, 3), (2, 3)]
    assert parsed("2/8", 5) == (2, 8)


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "auto", "auto/0", "-1/3", "1/3/2"])
def test_other_parts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=f"--part {text}: must be K/N or auto/N"):
        parsed(text, 1)
