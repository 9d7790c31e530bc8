"""How DOLFINx compiles the kernels of forms and expressions, and where they are kept.

A kernel's file is named by the hash of its form, FFCx's version and options, the compiler's flags, and the Python that
loads it, so that a directory of kernels can be shared by any jobs, users and machines. HPCINV_KERNELS names one; left
out, it is DOLFINx's own, ``~/.cache/fenics``. Where it can only be read, what is missing in it goes to DOLFINx's own.

Three functions of FFCx's are replaced here, once: to look for a kernel, to compile it, and to load what was compiled.
FFCx's own take ``NAME.c`` for the sign that somebody compiles a kernel, until ``NAME.c.cached`` says that it is ready,
and compile in place: a process that is killed meanwhile leaves a kernel that all others wait for in vain. Ours, in
`hpcinv.parallel.kernel_files`, have no such state. Kernels are code: those that another user could have written are not
loaded.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import ffcx.codegeneration.jit as ffcx_jit
from dolfinx.jit import get_options

from hpcinv.errors import OutputError
from hpcinv.parallel.kernel_files import check_room, is_sealed, locked, make_directory, private_directory, publish
from hpcinv.parallel.ownership import foreign_hand, foreign_hand_above
from hpcinv.parallel.runtime import MPI

_TRUST = "HPCINV_TRUST_KERNELS"


def _trusts() -> bool:
    """Whether kernels are loaded whoever could have written them."""
    value = os.environ.get(_TRUST, "")
    if value not in ("", "0", "1"):
        raise OutputError(f"{_TRUST}={value}: must be 1, to load kernels whoever could have written them, or unset")
    return value == "1"


def _directories() -> tuple[Path, tuple[Path, ...]]:
    """Where kernels are compiled to, and all places where they are looked for."""
    own, asked = Path(str(get_options()["cache_dir"])), os.environ.get("HPCINV_KERNELS")
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


def refuse_foreign(what: str, directory: Path) -> None:
    """Raise ``OutputError`` for a directory of kernels into which another user could have put some, unless trusted."""
    if _TRUSTS or not directory.is_dir():
        return
    found = [(directory, reason)] if (reason := foreign_hand(directory.stat())) else []
    if above := foreign_hand_above(directory):
        found.append(above)
    if found:
        where, why = found[0]
        raise OutputError(
            f"{what} {directory}: {f'{where} above it' if where != directory else 'it'} {why}, "
            "and what lies in it is executed",
            f"Let only you write there (chmod go-w {where}), name another directory by HPCINV_KERNELS, or, if all who "
            f"could have written there are to be trusted, set {_TRUST}=1.",
        )


def _environment() -> list[str]:
    """A flag without effect but that on the names of kernels, where the user's environment has flags of its own."""
    own = [os.environ[name] for name in ("CPPFLAGS", "CFLAGS", "LDFLAGS") if os.environ.get(name)]
    return [f"-DHPCINV_FLAGS_{hashlib.sha1(' '.join(own).encode()).hexdigest()}"] if own else []


_TRUSTS = _trusts()
DIRECTORY, _PLACES = _directories()
# -O1: most kernels run as fast as with -O2, within what noise lets see, and the largest compile much faster: the
# tangent of a three-term Ogden law in 4 instead of 57 s of processor time, for 18 % more in each assembly. -g0 halves
# the compile time against the interpreter's own -g; -ffast-math would break small-strain accuracy.
FLAGS = ["-O1", "-g0"]
JIT_OPTIONS = {"cffi_extra_compile_args": [*FLAGS, *_environment()], "cache_dir": DIRECTORY}
"""What DOLFINx is told for every form and expression."""

NOT_FOUND: list[str] = []
"""names of the kernels that this process did not find, so that it had to compile them, or to wait for another"""

_compile_in_place = ffcx_jit._compile_objects


def _find(name: str, directory: Path) -> Path | None:
    """The whole file of a kernel that nobody else could have written."""
    for place in _PLACES if directory == DIRECTORY else (directory,):
        path = place / f"{name}.so"
        try:
            with path.open("rb") as file:
                foreign = "" if _TRUSTS else foreign_hand(os.fstat(file.fileno()))
                if not foreign and is_sealed(file.read()):
                    return path
        except OSError:
            continue
        if foreign and MPI.COMM_WORLD.rank == 0:
            print(f"{path}: {foreign}: it is not loaded but compiled again", file=sys.stderr, flush=True)
    return None


def _load(path: Path, name: str, objects: Sequence[str]) -> tuple[list[Any], Any]:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path}: is no extension module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return [getattr(module.lib, of) for of in objects], module


def _get_cached_module(name: str, objects: Sequence[str], directory: Path, _timeout: int) -> tuple[Any, Any]:
    """Load a kernel, or give (None, None), so that FFCx compiles it."""
    path = _find(name, Path(directory))
    if path is None:
        NOT_FOUND.append(name)
        return None, None
    return _load(path, name, objects)


def _load_objects(directory: Path, name: str, objects: Sequence[str]) -> tuple[Any, Any]:
    """Load a kernel that was just compiled."""
    path = _find(name, Path(directory))
    if path is None:
        raise ModuleNotFoundError(f"the kernel {name} has gone from {directory} since it was compiled")
    return _load(path, name, objects)


def _compile_objects(
    declarations: str,
    forms: Any,
    objects: Sequence[str],
    name: str,
    options: Any,
    directory: Path,
    *arguments: Any,
    **further: Any,
) -> str:
    """Compile a kernel in a directory of its own, and publish it, unless another process does so meanwhile."""
    directory = Path(directory)
    with locked(directory, name):
        if _find(name, directory) is not None:
            return ""
        with private_directory() as private:
            try:
                code: str = _compile_in_place(
                    declarations, forms, objects, name, options, private, *arguments, **further
                )
            except Exception:
                check_room(private)
                raise
            (made,) = private.glob(f"{name}.*so")
            publish(directory / f"{name}.so", made.read_bytes())
        return code


ffcx_jit.get_cached_module = _get_cached_module
ffcx_jit._compile_objects = _compile_objects
ffcx_jit._load_objects = _load_objects
