"""Kernels that FFCx compiles, an independent reference for the interpreted ones."""

from collections.abc import Iterator
from contextlib import contextmanager

import dolfinx.jit

from hpcinv.physics.points.kernels import compiled_by_ffcx


@contextmanager
def kernels_of_ffcx() -> Iterator[None]:
    """Context in which FFCx compiles all forms and expressions."""
    interpreted, dolfinx.jit.ffcx_jit = dolfinx.jit.ffcx_jit, compiled_by_ffcx
    try:
        yield
    finally:
        dolfinx.jit.ffcx_jit = interpreted
