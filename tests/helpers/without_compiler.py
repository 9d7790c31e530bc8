"""Runs without a C compiler, in this process."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from hpcinv.base.parallel.c_code import NoLibrary
from hpcinv.model.assembly import csr_tangent, tangent_product, taylor_residual
from hpcinv.physics.points import interpreter


def _refuse(*_arguments: Any, **_further: Any) -> Any:
    raise NoLibrary("no C compiler 'cc'")


@contextmanager
def without_compiler() -> Iterator[None]:
    """Context in which NumPy does what C code does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(interpreter, "reason_against_c", lambda: "no C compiler 'cc'")
        for module in (csr_tangent, tangent_product, taylor_residual):
            patch.setattr(module, "compile_library", _refuse)
        yield
