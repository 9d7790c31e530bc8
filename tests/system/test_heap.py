"""Freed memory stays with the process, and is there for whoever asks how much there is."""

from __future__ import annotations

import subprocess
import sys

import pytest
from helpers.command_line import environment

SCRIPT = """
import hpcinv.parallel.runtime
import numpy as np
from hpcinv.parallel.memory_use import resident
from hpcinv.parallel.available_memory import available
before = resident()
block = np.ones(25_000_000)
full = resident()
wall = np.ones(100)  # what comes after in the heap must not be what keeps it
del block
kept = resident()
available(hpcinv.parallel.runtime.MPI.COMM_WORLD)
print(full - before, kept - before, resident() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_kept_until_it_is_given_back() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment(), check=True, capture_output=True, text=True)
    full, kept, given_back = map(int, done.stdout.split())
    assert full > 190e6
    assert kept > 0.9 * full
    assert given_back < 0.1 * full
