"""C code of hpcinv, compiled once for all jobs and kept in the cache.

It needs none of Python's headers, so that a C compiler alone is enough. Where there is none, NumPy does the same work.
"""

import ctypes
import hashlib
import os
import shlex
import shutil
import sysconfig
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.cache_files import NotWritten, check_room, locked, private_directory, publish
from hpcinv.base.parallel.children import run_child
from hpcinv.base.parallel.ranks import MPI, wait_for_all

_LINES_OF_A_PROCESSOR = 50  # at most, in /proc/cpuinfo, which is long on machines with many


class NoLibrary(Exception):
    """C code cannot be compiled, or not be loaded; the message is the reason."""


class _NotCompiled(Exception):
    """The C compiler fails, or cannot be started."""


class _LeftToRoot(Exception):
    """C code is not there, and rank 0 compiles it."""


def c_compiler() -> list[str]:
    """Command of the C compiler: CC, else the compiler of the Python in use, else cc."""
    if asked := os.environ.get("CC"):
        return shlex.split(asked)
    own = shlex.split(sysconfig.get_config_var("CC") or "cc")
    return own if shutil.which(own[0]) else ["cc"]


def _has_avx() -> bool:
    """Return whether the processor has AVX. Results are the same bit by bit: AVX has no fused products.

    x86 processors have had it since 2011.
    """
    with suppress(OSError), Path("/proc/cpuinfo").open() as file:
        return any(line.startswith("flags") and "avx" in line.split() for line in islice(file, _LINES_OF_A_PROCESSOR))
    return False


_FLAGS = ["-std=c17", "-fPIC", "-shared", "-g0", *(["-mavx"] if _has_avx() else [])]


def _flags_of_environment() -> tuple[list[str], list[str]]:
    """Flags of CPPFLAGS and CFLAGS, and of LDFLAGS, which prevail over the flags of hpcinv."""
    preprocessor, compiler, linker = (
        shlex.split(os.environ.get(variable, "")) for variable in ("CPPFLAGS", "CFLAGS", "LDFLAGS")
    )
    return [*preprocessor, *compiler], linker


def compile_library(
    comm: MPI.Intracomm, code: str, optimisation: Sequence[str] = ("-O3",), *, is_separate: bool = False
) -> ctypes.CDLL:
    """Return the functions of C code, compiled unless that was done before; collective.

    It is kept in the cache if that can be written.

    Args:
        is_separate: whether its variables are others than before in this process.

    Raises:
        NoLibrary: on all ranks.
    """
    flags = [*_FLAGS, *optimisation]
    digest = hashlib.sha1(f"{code}{flags}{_flags_of_environment()}".encode()).hexdigest()
    name = f"hpcinv_{digest}.so"

    def load(*, is_compiled_here: bool) -> ctypes.CDLL:
        path = code_cache.find(name)
        if path is not None and not is_separate:
            return ctypes.CDLL(str(path))
        with private_directory() as private:
            if path is None:
                code_cache.note_missing(name)
                if not is_compiled_here:
                    raise _LeftToRoot
                path = _made(code, name, flags, private)
            if is_separate:
                path = shutil.copyfile(path, private / "copy.so")
            return ctypes.CDLL(str(path))

    return _loaded_on_all(comm, load)


def _loaded_on_all(comm: MPI.Intracomm, load: Callable[..., ctypes.CDLL]) -> ctypes.CDLL:
    """Compile on rank 0 what ``load`` does not find, load it on all ranks, and let processors of waiting ranks free."""

    def attempt(*, is_compiled_here: bool) -> tuple[ctypes.CDLL | None, str]:
        try:
            return load(is_compiled_here=is_compiled_here), ""
        except _LeftToRoot:
            return None, ""
        except (_NotCompiled, NotWritten, OSError) as error:
            return None, str(error) or type(error).__name__

    library, fault = attempt(is_compiled_here=comm.rank == 0)
    wait_for_all(comm)
    if root_fault := comm.bcast(fault):
        raise NoLibrary(_reason(root_fault))
    if library is None and not fault:
        library, fault = attempt(is_compiled_here=True)
    if faults := [f"rank {rank}: {rank_fault}" for rank, rank_fault in enumerate(comm.allgather(fault)) if rank_fault]:
        raise NoLibrary(_reason(faults[0]))
    return cast(ctypes.CDLL, library)


def _made(code: str, name: str, flags: Sequence[str], private: Path) -> Path:
    """Compile C code; return the file in the cache, or the one in the private directory if it cannot be kept."""
    with locked(code_cache.directory(), name):
        if (path := code_cache.find(name)) is not None:  # another process was faster
            return path
        try:
            made = _compiled(code, name, flags, private)
        except (_NotCompiled, OSError):
            check_room(private)
            raise
        with suppress(NotWritten):
            publish(code_cache.directory() / name, made.read_bytes())
        return code_cache.find(name) or made


def _compiled(code: str, name: str, flags: Sequence[str], directory: Path) -> Path:
    """Compile C code to a shared object in a directory.

    Raises:
        _NotCompiled: with the first lines that the compiler writes.
        OSError: the code cannot be written.
    """
    target = directory / name
    source = target.with_suffix(".c")
    source.write_text(code)
    further, linker = _flags_of_environment()
    command = [*c_compiler(), *flags, *further, str(source), "-o", str(target), *linker, "-lm"]
    failure = f"the C compiler '{command[0]}' could not compile the code of hpcinv"
    try:
        done = run_child(command, keeps_output=False)
    except OSError as error:
        raise _NotCompiled(f"{failure}: {error.strerror}") from error
    if done.returncode:
        said = " ".join(done.stderr.decode(errors="replace").split("\n", 3)[:3]).strip()
        raise _NotCompiled(f"{failure}: exit code {done.returncode}. {said}".rstrip())
    return target


def _reason(fault: str) -> str:
    """Return in a few words why C code was not compiled."""
    compiler = c_compiler()[0]
    return f"no C compiler '{compiler}'" if shutil.which(compiler) is None else fault.rstrip(".")


def array_type(dtype: npt.DTypeLike) -> Any:
    """Return the type of arguments of a C function that are arrays, contiguous and with entries of a type."""
    return np.ctypeslib.ndpointer(dtype, flags="C_CONTIGUOUS")
