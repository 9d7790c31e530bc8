"""Compilation of a kernel's C code.

CFFI would compile each kernel as an extension module of Python. A kernel needs none of Python's headers: as a plain
shared object it compiles in half the time, with the C compiler alone.
"""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from hpcinv.parallel.children import run_child
from hpcinv.parallel.runtime import c_compiler  # its import order first

# isort: split
import ffcx.codegeneration


class NotCompiled(Exception):
    """The C compiler fails, or cannot be started."""


def compile_kernel(code: str, name: str, flags: Sequence[str], directory: Path) -> bytes:
    """Compile C code to a shared object.

    Args:
        flags: of the compiler; CPPFLAGS, CFLAGS and LDFLAGS in the environment come later and prevail.
        directory: for the files of the compiler.

    Raises:
        NotCompiled: with the first lines that the compiler writes.
        OSError: the code cannot be written, or the shared object not be read.
    """
    source, target = directory / f"{name}.c", directory / f"{name}.so"
    source.write_text(code)
    preprocessor, compiler, linker = (
        shlex.split(os.environ.get(variable, "")) for variable in ("CPPFLAGS", "CFLAGS", "LDFLAGS")
    )
    include = f"-I{ffcx.codegeneration.get_include_path()}"
    command = [*c_compiler(), "-std=c17", "-fPIC", "-shared", *flags, include, *preprocessor, *compiler]
    failure = f"the C compiler '{command[0]}' could not compile a kernel"
    try:
        done = run_child([*command, str(source), "-o", str(target), *linker, "-lm"], keeps_output=False)
    except OSError as error:
        raise NotCompiled(f"{failure}: {error.strerror}") from error
    if done.returncode:
        said = " ".join(done.stderr.decode(errors="replace").split("\n", 3)[:3]).strip()
        raise NotCompiled(f"{failure}: exit code {done.returncode}. {said}".rstrip())
    return target.read_bytes()
