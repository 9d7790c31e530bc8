"""A short run of the fuzzer, the same at every time; ``python tests/system/fuzz/fuzz.py`` goes on for longer.

It runs in a process of its own: plugins that its jobs load would stay known to the tests that follow.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FUZZER = Path(__file__).with_name("fuzz.py")


DAILY = {"jobs": 40, "meshes": 3, "scans": 15, "decks": 60}
"""mutants of each kind, in one process: its start takes as long as these"""


@pytest.mark.everyday("all")
@pytest.mark.parametrize(
    "counts",
    [DAILY, {"jobs": 300}, {"meshes": 24}, {"scans": 120}, {"decks": 500}],
    ids=lambda counts: "all" if len(counts) > 1 else next(iter(counts)),
)
def test_mutations_end_in_a_message_or_in_a_valid_file(counts: dict[str, int], tmp_path: Path) -> None:
    numbers = ["--only", *counts, "--count", *map(str, counts.values())]
    options = [*numbers, "--seed", "1", "--seconds", "800", "--keep", str(tmp_path)]
    done = subprocess.run([sys.executable, str(FUZZER), *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"0 wrong answers to {counts.get('jobs', 0)} jobs" in done.stdout
