"""How DOLFINx compiles the kernels of forms and expressions, and what killed compilations leave in its cache.

FFCx takes the file ``NAME.c`` for the sign that somebody compiles a kernel, until ``NAME.c.cached`` says that it is
ready. A process that is killed in between would let all others wait for it in vain. So the first rank of each run holds
a lock in the cache in common with all other runs; who is alone in it removes what is not ready.
"""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import IO

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
from dolfinx.jit import get_options

from hpcinv.runtime import MPI

# -O1: most kernels run as fast as with -O2, within what noise lets see, and the largest compile much faster: the
# tangent of a three-term Ogden law in 4 instead of 57 s of processor time, for 18 % more in each assembly. -g0 halves
# the compile time against the interpreter's own -g; -ffast-math would break small-strain accuracy.
# Another run may be compiling the same kernel: it is waited for, a minute at most.
JIT_OPTIONS = {"cffi_extra_compile_args": ["-O1", "-g0"], "timeout": 60}
"""What DOLFINx is told for every form and expression."""


def _hold(cache: Path) -> IO[str] | None:
    """The lock in a cache, held as long as the file is open; ``None`` where the file system has no locks."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
        lock = (cache / "hpcinv.lock").open("a+")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            pass  # other runs are alive, and may be compiling
        else:
            _remove_unfinished(cache)
        fcntl.flock(lock, fcntl.LOCK_SH)
    except OSError:
        return None
    return lock


def _remove_unfinished(cache: Path) -> None:
    for source in cache.glob("libffcx_*.c"):
        if not source.with_suffix(".c.cached").exists():
            source.unlink(missing_ok=True)


_lock = _hold(Path(str(get_options()["cache_dir"]))) if MPI.COMM_WORLD.rank == 0 else None
