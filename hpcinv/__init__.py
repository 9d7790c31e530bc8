"""The undeformed shape of a soft body from its deformed one: MPI-parallel inverse finite elasticity."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from hpcinv.version import __version__

if TYPE_CHECKING:
    from hpcinv.interface import run
    from hpcinv.job.job import Job, load
    from hpcinv.studies.sweep.sweep_interface import sweep

__all__ = ["Job", "__version__", "load", "run", "sweep"]

_HOME = {"Job": "hpcinv.job.job", "load": "hpcinv.job.job", "run": "hpcinv.interface"}  # imported when first asked for


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    if name == "sweep":  # the package, which can be called
        return importlib.import_module("hpcinv.studies.sweep")
    raise AttributeError(f"module 'hpcinv' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__
