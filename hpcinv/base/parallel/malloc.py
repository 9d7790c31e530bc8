"""Settings of malloc in glibc: freed memory is kept for the next factorization, and released on request.

By default glibc returns every large block to the system and gets the next one page by page, each cleared again, on all
ranks of a node at the same time: a fifth of the time of a factorization (docs/performance/linear-solvers.md).
"""

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # malloc.h
_LARGEST_INT = 2**31 - 1
_OF_THE_SITE = ("GLIBC_TUNABLES", "MALLOC_MMAP_MAX_", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")


def keep_freed_memory() -> None:
    """Do not use mmap for large blocks and do not trim the heap; environment variables of malloc have priority."""
    mallopt = _glibc_function("mallopt")
    if mallopt is not None and not any(name in os.environ for name in _OF_THE_SITE):
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, _LARGEST_INT)


def release_freed_memory() -> None:
    """Return freed memory to the system."""
    malloc_trim = _glibc_function("malloc_trim")
    if malloc_trim is not None:
        malloc_trim(0)


@cache
def _glibc_function(function: str) -> Callable[..., int] | None:
    """A function of glibc; ``None`` for other C libraries."""
    address: Callable[..., int] | None = None
    if sys.platform == "linux":
        address = getattr(ctypes.CDLL(None), function, None)
    return address
