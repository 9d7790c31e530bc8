"""A short run of the fuzzer, the same at every time; ``python tests/fuzz/fuzz.py`` goes on for longer."""

from __future__ import annotations

import math
import random
from pathlib import Path

import pytest
from fuzz import CORPUS, KINDS, fault_of_job, jobs


def test_every_file_of_the_corpus_has_an_answer(tmp_path: Path) -> None:
    jobs(tmp_path)
    for path in sorted(CORPUS.glob("*.yaml")):
        assert fault_of_job(tmp_path / path.name) is None


@pytest.mark.parametrize(("kind", "count"), [("jobs", 300), ("meshes", 24)])
def test_mutations_end_in_a_message_or_in_a_valid_file(kind: str, count: int, tmp_path: Path) -> None:
    assert [fault for _, fault in KINDS[kind](tmp_path, random.Random(1), count, math.inf)] == []
