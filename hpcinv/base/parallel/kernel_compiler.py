"""Compilation of a kernel's C code.

CFFI would compile each kernel as an extension module of Python. A kernel needs none of Python's headers: as a plain
shared object it compiles in half the time, with the C compiler alone.
"""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from hpcinv.base.parallel.children import run_child
from hpcinv.base.parallel.runtime import c_compiler  # its import order first

# isort: split
import ffcx.codegeneration

_QUICK = ("--param=lra-max-considered-reload-pseudos=5", "--param=max-combine-insns=2", "-fira-region=one")
"""Flags by which GCC allocates registers and combines instructions with less care. The largest kernels compile in 30 %
less processor time and run 1 to 2 % slower, with the same results bit by bit, so that names of kernels do not depend on
them. Other compilers may refuse them."""


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
    command = [*c_compiler(), "-std=c17", "-fPIC", "-shared", *flags, include]
    rest = [*preprocessor, *compiler, str(source), "-o", str(target), *linker, "-lm"]
    failure = f"the C compiler '{command[0]}' could not compile a kernel"
    for quick in ((),) if "-O3" in flags else (_QUICK, ()):  # -O3: loops written by hand, which compile quickly
        try:
            done = run_child([*command, *quick, *rest], keeps_output=False)
        except OSError as error:
            raise NotCompiled(f"{failure}: {error.strerror}") from error
        if not done.returncode:
            return target.read_bytes()
    said = " ".join(done.stderr.decode(errors="replace").split("\n", 3)[:3]).strip()
    raise NotCompiled(f"{failure}: exit code {done.returncode}. {said}".rstrip())
