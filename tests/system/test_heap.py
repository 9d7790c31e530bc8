"""Freed memory stays with the process, in pages of the usual size, and is there for whoever asks how much there is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import environment

SCRIPT = """
import hpcinv.base.parallel.runtime
import numpy as np
from hpcinv.base.parallel.timings import resident
from hpcinv.base.parallel.left_for_run import available
before = resident()
block = np.ones(25_000_000)
full = resident()
wall = np.ones(100)  # what comes after in the heap must not be what keeps it
del block
kept = resident()
available(hpcinv.base.parallel.runtime.MPI.COMM_WORLD)
print(full - before, kept - before, resident() - before)
"""


@pytest.mark.release
@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_kept_until_it_is_given_back() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment(), check=True, capture_output=True, text=True)
    full, kept, given_back = map(int, done.stdout.split())
    assert full > 190e6
    assert kept > 0.9 * full
    assert given_back < 0.1 * full


PAGES = """
import hpcinv.base.parallel.runtime
import numpy as np
block = np.ones(4_000_000)
at, inside, found = block.ctypes.data + block.nbytes // 2, False, None
for line in open("/proc/self/smaps"):
    first = line.split()[0]
    if "-" in first and not first.endswith(":"):
        low, high = (int(of, 16) for of in first.split("-"))
        inside = low <= at < high
    elif inside and first == "VmFlags:":
        found = "hg" in line.split()
print(found)
"""


@pytest.mark.everyday("None")
@pytest.mark.skipif(not Path("/sys/kernel/mm/transparent_hugepage").exists(), reason="a kernel without huge pages")
@pytest.mark.parametrize("asked", [None, "0", "1"])
def test_numpy_asks_for_huge_pages_only_if_the_user_says_so(asked: str | None) -> None:
    """On virtual machines the first touch of each takes milliseconds, in the factorization that gets this memory."""
    settings = environment() | ({} if asked is None else {"NUMPY_MADVISE_HUGEPAGE": asked})
    done = subprocess.run([sys.executable, "-c", PAGES], env=settings, check=True, capture_output=True, text=True)
    assert done.stdout.strip() == str(asked == "1")
