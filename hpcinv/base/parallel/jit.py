"""The cache of programs (`hpcinv.physics.points`) and kernels, and compilation of kernels that programs do not have.

The file name of a kernel is a hash of its form, of version and options of FFCx, of compiler flags, and of the Python
version, so that a directory of kernels can be shared by any jobs, users and machines. HPCINV_KERNELS names the
directory; the default is DOLFINx's, ``~/.cache/fenics``. If HPCINV_KERNELS is read-only, missing kernels are
compiled to the default directory.

This module replaces three functions of FFCx, once: for the search, the compilation, and the loading of a kernel;
DOLFINx's function that calls them on all ranks; and Basix's cell of an element, which it makes anew each time. FFCx's
own compile in place, and mark a kernel under compilation by the file ``NAME.c`` without ``NAME.c.cached``: if the
process is killed, all others wait for this kernel until they time out. The functions here (with
`hpcinv.base.parallel.kernel_files`) have no such state. Kernels are code: files that another user could have written
are not loaded.

They are replaced in the releases `KNOWN` only. Others keep their own functions, and one line on stderr says so: kernels
then compile as DOLFINx does it, a shared directory that is read-only is not used, and forms are derived in each run.
"""

import ctypes
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from contextvars import ContextVar
from functools import cache
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import basix.ufl
import cffi
import dolfinx.jit
import ffcx.codegeneration.jit as ffcx_jit
import ffcx.compiler
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.jit import get_options

from hpcinv.base.parallel.kernel_compiler import NotCompiled, compile_kernel
from hpcinv.base.parallel.kernel_files import (
    NotWritten,
    check_room,
    is_sealed,
    locked,
    make_directory,
    private_directory,
    publish,
    unsealed,
)
from hpcinv.base.parallel.ownership import foreign_writer, foreign_writer_above
from hpcinv.base.parallel.ranks import wait_for_all
from hpcinv.base.parallel.runtime import MPI, c_compiler
from hpcinv.errors import OutputError

KNOWN = "0.11"
"""Releases of DOLFINx and FFCx whose functions are replaced; of another one, compare those functions with its own."""
_TRUST = "HPCINV_TRUST_KERNELS"
_LINES_OF_A_PROCESSOR = 50  # at most, in /proc/cpuinfo, which is long on machines with many


def _trusts() -> bool:
    """Return whether kernels are loaded even if other users could have written them."""
    value = os.environ.get(_TRUST, "")
    if value not in ("", "0", "1"):
        raise OutputError(f"{_TRUST}={value}: must be 1, to load kernels that other users could have written, or unset")
    return value == "1"


def _directories() -> tuple[Path, tuple[Path, ...]]:
    """Directory to which kernels are compiled, and all directories in which they are searched."""
    own, asked = Path(str(_options_of_dolfinx()["cache_dir"])), os.environ.get("HPCINV_KERNELS")
    if not asked:
        refuse_foreign("the cache of kernels", own)
        return own, (own,)
    shared = Path(asked).expanduser().absolute()
    try:
        make_directory(shared)
    except OSError as error:
        raise OutputError(f"HPCINV_KERNELS={asked}: {error.strerror}", "Name a directory of kernels.") from None
    refuse_foreign("HPCINV_KERNELS", shared)
    if os.access(shared, os.W_OK):
        return shared, (shared,)
    refuse_foreign("the cache of kernels", own)
    return own, (shared, own)


def _options_of_dolfinx() -> dict[str, Any]:
    """Options that DOLFINx reads from files; ``OutputError`` if it fails at them."""
    try:
        options: dict[str, Any] = get_options()
    except (OSError, ValueError) as error:
        file = getattr(error, "filename", None) or "dolfinx_jit_options.json"
        raise OutputError(
            f"{file}: DOLFINx cannot read its options: {getattr(error, 'strerror', None) or error}",
            "Correct or remove the file dolfinx_jit_options.json, and XDG_CONFIG_HOME if that is set.",
        ) from None
    return options


def refuse_foreign(what: str, directory: Path) -> None:
    """Raise ``OutputError`` for a directory into which another user could have written kernels, unless trusted."""
    if _TRUSTS or not directory.is_dir():
        return
    places = [(directory, reason)] if (reason := foreign_writer(directory.stat())) else []
    if parent_fault := foreign_writer_above(directory):
        places.append(parent_fault)
    if places:
        where, why = places[0]
        raise OutputError(
            f"{what} {directory}: {f'{where} above it' if where != directory else 'it'} {why}, "
            "and its files are executed",
            f"Type 'chmod go-w {where}', name another HPCINV_KERNELS, or trust these users: {_TRUST}=1.",
        )


def _environment() -> list[str]:
    """Flag that only changes the names of kernels, if the environment has compiler flags."""
    own = [os.environ[name] for name in ("CPPFLAGS", "CFLAGS", "LDFLAGS") if os.environ.get(name)]
    return [f"-DHPCINV_FLAGS_{hashlib.sha1(' '.join(own).encode()).hexdigest()}"] if own else []


def _has_avx() -> bool:
    """Return whether the processor has AVX: long kernels take half the time with it.

    x86 processors have had it since 2011.
    """
    with suppress(OSError), Path("/proc/cpuinfo").open() as file:
        return any(line.startswith("flags") and "avx" in line.split() for line in islice(file, _LINES_OF_A_PROCESSOR))
    return False


_TRUSTS = _trusts()
DIRECTORY, _PLACES = _directories()
# -O1: most kernels run as fast as with -O2, within noise, and the largest compile much faster: the tangent of a
# three-term Ogden law in 4 instead of 57 s of processor time, with 18 % more time in each assembly. -g0 halves the
# compile time compared with the default -g of the interpreter; -ffast-math would break small-strain accuracy.
# -mavx has no fused products, so that results are the same bit by bit.
FLAGS = ["-O1", "-g0", *(["-mavx"] if _has_avx() else [])]
JIT_OPTIONS = {"cffi_extra_compile_args": [*FLAGS, *_environment()], "cache_dir": DIRECTORY}
"""Options of DOLFINx for every form and expression."""

NOT_FOUND: list[str] = []
"""names of the kernels that this process did not find in the cache, so that it had to compile them or to wait"""


def note_missing(name: str) -> None:
    """Note that a kernel or program has to be made."""
    NOT_FOUND.append(name)


def _find(name: str, directory: Path, suffix: str = ".so") -> Path | None:
    """Complete file of a kernel that no other user could have written, or None."""
    for place in _PLACES if directory == DIRECTORY else (directory,):
        path = place / f"{name}{suffix}"
        try:
            with path.open("rb") as file:
                foreign = "" if _TRUSTS else foreign_writer(os.fstat(file.fileno()))
                if not foreign and is_sealed(file.read()):
                    return path
        except OSError:
            continue
        if foreign and MPI.COMM_WORLD.rank == 0:
            print(f"{path}: {foreign}: it is compiled again instead of loaded", file=sys.stderr, flush=True)
    return None


@cache
def interface() -> Any:
    """Return CFFI's description of the C types of kernels."""
    interface = cffi.FFI()
    interface.cdef(ffcx_jit.UFC_HEADER_DECL.format("float64"))
    for declarations in (ffcx_jit.UFC_INTEGRAL_DECL, ffcx_jit.UFC_FORM_DECL, ffcx_jit.UFC_EXPRESSION_DECL):
        interface.cdef(declarations)
    return interface


def read_record(name: str, directory: Path) -> str | None:
    """Return a text that was kept among the kernels, ``None`` if it is not there."""
    path = _find(name, directory, ".txt")
    return None if path is None else unsealed(path.read_bytes()).decode()


def read_data(name: str, directory: Path) -> bytes | None:
    """Return bytes that were kept among the kernels, ``None`` if they are not there."""
    path = _find(name, directory, ".npz")
    return None if path is None else unsealed(path.read_bytes())


def write_data(name: str, content: bytes, directory: Path) -> None:
    """Keep bytes among the kernels, if they can be written."""
    with suppress(NotWritten):
        publish(directory / f"{name}.npz", content)


def write_record(name: str, text: str, directory: Path) -> None:
    """Keep a text among the kernels, if they can be written."""
    with suppress(NotWritten):
        publish(directory / f"{name}.txt", text.encode())


def _load(path: Path, objects: Sequence[str]) -> tuple[list[Any], Any]:
    """The named forms or expressions of a kernel's file, and what DOLFINx calls their module."""
    ffi, library = interface(), ctypes.CDLL(str(path))
    kind = "ufcx_form" if path.name.startswith("libffcx_forms") else "ufcx_expression"
    addresses = [ctypes.addressof(ctypes.c_char.in_dll(library, name)) for name in objects]
    module = SimpleNamespace(ffi=ffi, lib=library, file=path.stem, symbols=objects)
    return [ffi.cast(f"{kind} *", address)[0] for address in addresses], module


def _get_cached_module(name: str, objects: Sequence[str], directory: Path, _timeout: int) -> tuple[Any, Any]:
    """Load a kernel, or return (None, None), so that FFCx compiles it."""
    path = _find(name, Path(directory))
    if path is None:
        note_missing(name)
        return None, None
    return _load(path, objects)


def _load_objects(directory: Path, name: str, objects: Sequence[str]) -> tuple[Any, Any]:
    path = _find(name, Path(directory))
    if path is None:
        raise ModuleNotFoundError(f"the kernel {name} was removed from {directory} after its compilation")
    return _load(path, objects)


def _compile_objects(
    _declarations: str,
    forms: Any,
    _objects: Sequence[str],
    name: str,
    options: Any,
    directory: Path,
    flags: Sequence[str],
    *_cffi: Any,
    visualise: bool = False,
) -> str:
    """Compile a kernel unless another process has done so."""

    def code() -> str:
        (_, code), _suffixes = ffcx.compiler.compile_ufl_objects(
            forms, namespace=name, options=options, visualise=visualise
        )
        return str(code)

    return _publish(code, name, flags, Path(directory))


def _publish(code: Callable[[], str], name: str, flags: Sequence[str], directory: Path) -> str:
    """Compile C code in a private directory and publish it, unless another process has done so; return the code."""
    if _leaves_compilation.get():
        raise _Missing
    with locked(directory, name):
        if _find(name, directory) is not None:
            return ""
        with private_directory() as private:
            written = code()
            publish(directory / f"{name}.so", _compiled(written, name, flags, private))
        return written


def _compiled(code: str, name: str, flags: Sequence[str], private: Path) -> bytes:
    """Compile C code in a private directory; name the reason where it has no room."""
    try:
        return compile_kernel(code, name, flags, private)
    except (NotCompiled, OSError):
        check_room(private)
        raise


_jit_here: Callable[..., Any] = getattr(dolfinx.jit.ffcx_jit, "__wrapped__", dolfinx.jit.ffcx_jit)


class _Missing(Exception):
    """Raised where a kernel is not there and rank 0 compiles it."""


_leaves_compilation = ContextVar("_leaves_compilation", default=False)


def _jit(comm: MPI.Intracomm, *arguments: Any, **further: Any) -> Any:
    """Load on all ranks what rank 0 compiles where it is not there."""
    return _once(comm, lambda: _jit_here(*arguments, **further))


def _once(comm: MPI.Intracomm, load: Callable[[], Any]) -> Any:
    """Compile on rank 0 what ``load`` does not find, load it on all ranks, and let processors of waiting ranks free."""

    def attempt(*, leaves_compilation: bool) -> tuple[Any, str]:
        token = _leaves_compilation.set(leaves_compilation)
        try:
            return load(), ""
        except _Missing:
            return None, ""
        except Exception as error:  # anything that FFCx, CFFI or the compiler raises
            return None, str(error) or type(error).__name__
        finally:
            _leaves_compilation.reset(token)

    compiled, fault = attempt(leaves_compilation=comm.rank != 0)
    wait_for_all(comm)
    if root_fault := comm.bcast(fault):
        raise RuntimeError(f"Failed JIT compilation of form: {root_fault}")
    if comm.rank != 0 and compiled is None:
        compiled, fault = attempt(leaves_compilation=False)
    if faults := [f"rank {rank}: {rank_fault}" for rank, rank_fault in enumerate(comm.allgather(fault)) if rank_fault]:
        raise RuntimeError(f"JIT cache load failed on {faults[0]}")
    return compiled


class NoLibrary(Exception):
    """C code cannot be compiled, or not be loaded; the message is the reason."""


def compile_library(
    comm: MPI.Intracomm,
    code: str,
    directory: Path = DIRECTORY,
    optimisation: Sequence[str] = ("-O3",),
    *,
    is_separate: bool = False,
) -> ctypes.CDLL:
    """Return the functions of C code, compiled unless that was done before; collective.

    It is kept in the cache if that can be written.

    Args:
        is_separate: whether its variables are others than before in this process.

    Raises:
        NoLibrary: on all ranks.
    """
    flags = [*FLAGS, *optimisation, *_environment()]
    name = f"hpcinv_{hashlib.sha1(f'{code}{flags}'.encode()).hexdigest()}"

    def load() -> ctypes.CDLL:
        path = _find(name, directory)
        if path is not None and not is_separate:
            return ctypes.CDLL(str(path))
        with private_directory() as private:
            if path is None:
                note_missing(name)
                path = _made_library(code, name, flags, directory, private)
            if is_separate:
                path = shutil.copyfile(path, private / "copy.so")
            return ctypes.CDLL(str(path))

    try:
        library: ctypes.CDLL = _once(comm, load)
    except RuntimeError as error:
        raise NoLibrary(_reason(str(error))) from None
    return library


def _made_library(code: str, name: str, flags: Sequence[str], directory: Path, private: Path) -> Path:
    """Compile C code; return the file in the cache, or the one in the private directory if it cannot be kept."""
    if _leaves_compilation.get():
        raise _Missing
    with locked(directory, name):
        if (path := _find(name, directory)) is not None:  # another process was faster
            return path
        made = _compiled(code, name, flags, private)
        with suppress(NotWritten):
            publish(directory / f"{name}.so", made)
        return _find(name, directory) or private / f"{name}.so"


def _reason(fault: str) -> str:
    """Return in a few words why C code was not compiled."""
    compiler = c_compiler()[0]
    return f"no C compiler '{compiler}'" if shutil.which(compiler) is None else fault.partition(": ")[2].rstrip(".")


def array_type(dtype: npt.DTypeLike) -> Any:
    """Return the type of arguments of a C function that are arrays, contiguous and with entries of a type."""
    return np.ctypeslib.ndpointer(dtype, flags="C_CONTIGUOUS")


@cache
def _cell(name: str) -> ufl.Cell:
    """Return a cell; a new one with its edges and facets for each question of UFL takes 4 to 9 % of a small run."""
    return ufl.Cell(name)


def _replace_functions() -> None:
    """Replace the functions of the releases `KNOWN`; note on rank 0 that others keep theirs."""
    versions = {"DOLFINx": dolfinx.__version__, "FFCx": ffcx.__version__}
    if all(f"{version}.".startswith(f"{KNOWN}.") for version in versions.values()):
        basix.ufl._ElementBase.cell = property(lambda element: _cell(element._cellname))
        dolfinx.jit.ffcx_jit = _jit
        ffcx_jit.get_cached_module = _get_cached_module
        ffcx_jit._compile_objects = _compile_objects
        ffcx_jit._load_objects = _load_objects
    elif MPI.COMM_WORLD.rank == 0:
        installed = " and ".join(f"{name} {version}" for name, version in versions.items())
        note = f"{installed} compile kernels by themselves: hpcinv replaces functions of {KNOWN} only"
        print(f"{note} (docs/how-to/start-up.md)", file=sys.stderr, flush=True)


_replace_functions()
