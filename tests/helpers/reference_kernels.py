"""Kernels that FFCx compiles, an independent reference for the interpreted ones."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dolfinx.jit

from hpcinv.base.parallel import code_cache
from hpcinv.physics.points.ffcx_fallback import FLAGS, jit_of_dolfinx


@contextmanager
def kernels_of_ffcx(*flags: str) -> Iterator[None]:
    """Context in which FFCx compiles all forms and expressions, with further flags of the C compiler."""

    def compiled(comm: Any, item: Any, form_compiler_options: Any = None, jit_options: Any = None) -> Any:
        options = {"cffi_extra_compile_args": [*FLAGS, *flags], "cache_dir": code_cache.directory()}
        return jit_of_dolfinx(comm, item, form_compiler_options, options)

    interpreted, dolfinx.jit.ffcx_jit = dolfinx.jit.ffcx_jit, compiled
    try:
        yield
    finally:
        dolfinx.jit.ffcx_jit = interpreted
