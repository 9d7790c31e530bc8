"""Sweeps: many cases of one job, in one allocation or many, each solved once.

The package is callable, ``hpcinv.sweep("sweep.yaml")``: see `hpcinv.studies.sweep.sweep_interface.sweep`.
"""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> Any:
        from hpcinv.studies.sweep.sweep_interface import sweep

        return sweep(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
