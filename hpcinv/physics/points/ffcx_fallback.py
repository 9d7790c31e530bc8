"""FFCx, which compiles forms and expressions of plugins that programs cannot have; a run of hpcinv's own needs none.

DOLFINx does so by functions of its own. They write into our cache, and need a C compiler and Python's headers.
"""

import os
import re
import shutil
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import dolfinx.jit

from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.c_code import c_compiler
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SystemPartMissing

_REMEDY = "Install a C compiler with Python's headers (Debian, Ubuntu: apt-get install gcc libc6-dev python3-dev)."
FLAGS = ("-O1", "-g0")
"""flags of the C compiler: the largest kernels compile much faster than by the default ones, and run as fast"""

term_places: dict[str, str] = {}
"""files and lines of terms of plugins, by what they have and programs do not"""
_notes: dict[str, bool] = {}
"""lines on what FFCx compiled, and whether they are new"""
jit_of_dolfinx = dolfinx.jit.ffcx_jit
_COMPILER_FAILED = re.compile(r"CompileError|LinkError|command .* failed", re.DOTALL)
_CACHE_FAILED = re.compile(r"JIT compilation timed out|\[Errno \d+\]")


def notes_on_ffcx() -> list[str]:
    """Return lines on what FFCx compiled in this process, each of them once."""
    new = [line for line, is_new in _notes.items() if is_new]
    _notes.update(dict.fromkeys(new, False))
    return new


def compiled_by_ffcx(
    comm: MPI.Intracomm, item: Any, missing: str, form_compiler_options: Any = None, jit_options: Any = None
) -> Any:
    """Return what DOLFINx' just-in-time compiler returns for a form, or for an expression and points; collective.

    Args:
        missing: what the item has and programs do not.

    Raises:
        SystemPartMissing: on all ranks, if it cannot be compiled.
    """
    place = f"{term_places.get(missing, 'a form')}: {missing}"
    _notes.setdefault(f"{place}, which programs do not have: FFCx compiles it", True)
    options = {"cffi_extra_compile_args": list(FLAGS), "cache_dir": code_cache.directory()} | (jit_options or {})
    try:
        return jit_of_dolfinx(comm, item, form_compiler_options=form_compiler_options, jit_options=options)
    except Exception as error:  # of FFCx, CFFI, or DOLFINx, which raises the first rank's on all
        compiler = c_compiler()[0]
        if shutil.which(compiler) is None:
            what = f"no C compiler '{compiler}' on {os.uname().nodename}, which is needed for {place}"
            raise SystemPartMissing(what, _REMEDY) from None
        text, fault = f"{type(error).__name__} {error}", f"{place}, which FFCx cannot compile: {error}"
        if _COMPILER_FAILED.search(text):
            raise SystemPartMissing(fault, _REMEDY) from None
        if _CACHE_FAILED.search(text):
            remedy = f"Make {code_cache.directory()} writable, and remove libffcx_* there if a run was killed."
            raise SystemPartMissing(fault, remedy) from None
        raise
