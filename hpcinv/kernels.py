"""How DOLFINx compiles the kernels of forms and expressions, where they are kept, and what killed compilations leave.

A kernel's file is named by the hash of its form, FFCx's version and options, the compiler's flags, and the Python that
loads it, so that a directory of kernels can be shared by any jobs, users and machines. HPCINV_KERNELS names one; left
out, it is DOLFINx's own, ``~/.cache/fenics``. Where it can only be read, what is missing in it goes to DOLFINx's own.

FFCx takes the file ``NAME.c`` for the sign that somebody compiles a kernel, until ``NAME.c.cached`` says that it is
ready. A process that is killed in between would let all others wait for it in vain. So the first rank of each run holds
a lock in the directory in common with all other runs; who is alone in it removes what is not ready.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
from collections.abc import Sequence
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import IO, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import ffcx.codegeneration.jit as ffcx_jit
from dolfinx.jit import get_options

from hpcinv.errors import OutputError
from hpcinv.runtime import MPI


def _directories() -> tuple[Path, tuple[Path, ...]]:
    """Where kernels are compiled to, and all places where they are looked for."""
    own, asked = Path(str(get_options()["cache_dir"])), os.environ.get("HPCINV_KERNELS")
    if not asked:
        return own, (own,)
    shared = Path(asked).expanduser().absolute()
    try:
        shared.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"HPCINV_KERNELS={asked}: {error.strerror}", "Name a directory of kernels.") from None
    return (shared, (shared,)) if os.access(shared, os.W_OK) else (own, (shared, own))


def _environment() -> list[str]:
    """A flag without effect but that on the names of kernels, where the user's environment has flags of its own."""
    own = [os.environ[name] for name in ("CPPFLAGS", "CFLAGS", "LDFLAGS") if os.environ.get(name)]
    return [f"-DHPCINV_FLAGS_{hashlib.sha1(' '.join(own).encode()).hexdigest()}"] if own else []


DIRECTORY, _PLACES = _directories()
# -O1: most kernels run as fast as with -O2, within what noise lets see, and the largest compile much faster: the
# tangent of a three-term Ogden law in 4 instead of 57 s of processor time, for 18 % more in each assembly. -g0 halves
# the compile time against the interpreter's own -g; -ffast-math would break small-strain accuracy.
FLAGS = ["-O1", "-g0"]
# Another run may be compiling the same kernel: it is waited for, a minute at most.
JIT_OPTIONS = {"cffi_extra_compile_args": [*FLAGS, *_environment()], "cache_dir": DIRECTORY, "timeout": 60}
"""What DOLFINx is told for every form and expression."""


_wait_or_begin = ffcx_jit.get_cached_module


def _get_cached_module(name: str, objects: Sequence[str], directory: Path, timeout: int) -> tuple[Any, Any]:
    """FFCx's function, which looks into one directory, and lists it, however many files there are."""
    for place in _PLACES if Path(directory) == DIRECTORY else ():
        if not (place / f"{name}.c.cached").exists():
            continue
        for suffix in EXTENSION_SUFFIXES:
            if (file := place / f"{name}{suffix}").exists():
                spec = importlib.util.spec_from_file_location(name, file)
                assert spec is not None
                assert spec.loader is not None
                module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
                return [getattr(module.lib, of) for of in objects], module
    found: tuple[Any, Any] = _wait_or_begin(name, objects, directory, timeout)
    return found


ffcx_jit.get_cached_module = _get_cached_module


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
    # One call to the file system, and no path of thousands of kernels.
    names = set(os.listdir(cache))  # noqa: PTH208
    for name in names:
        if name.startswith("libffcx_") and name.endswith(".c") and f"{name}.cached" not in names:
            (cache / name).unlink(missing_ok=True)


_lock = _hold(DIRECTORY) if MPI.COMM_WORLD.rank == 0 else None
