"""The interpreter of programs, and functions with the signature of DOLFINx' kernels that run them."""

from __future__ import annotations

import ctypes
import weakref
from collections import deque
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.parallel.jit import compile_library
from hpcinv.parallel.runtime import MPI
from hpcinv.points.program import Program

_MOST = 1024
"""kernels that one process can have at a time: `functions` of interpreter.c"""

_OPTIMISATION = "-O2", "-ftree-vectorize", "-fvect-cost-model=unlimited"
"""-O3 takes 1.5 times as long to compile, and the interpreter then 1.4 times as long"""


class _Program(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int32) for name in ("lanes", "blocks", "points", "rank")),
        *((name, ctypes.c_int32) for name in ("operations", "outputs", "width", "columns")),
        *((name, ctypes.c_void_p) for name in ("rows", "gathers", "bases", "results", "numbers", "tables")),
        ("entity_size", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("places", "slots", "products")),
    )


class _Kernel(ctypes.Structure):
    _fields_ = (("count", ctypes.c_int32), ("programs", ctypes.POINTER(_Program)))


class Kernel:
    """Programs that together make an element's number, vector, matrix or the values of an expression.

    Attributes:
        address: of the function that runs them.
    """

    def __init__(self, programs: Sequence[Program]) -> None:
        library, free = _library()
        if not free:
            raise MemoryError(f"more than {_MOST} forms at a time")
        number = free.popleft()
        self._kept: list[Any] = []
        structures = (_Program * len(programs))(*map(self._structure, programs))
        self._kernel = _Kernel(len(programs), structures)
        _kernels(library)[number] = ctypes.addressof(self._kernel)
        self.address = (ctypes.c_void_p * _MOST).in_dll(library, "functions")[number]
        weakref.finalize(self, free.append, number)

    def _structure(self, program: Program) -> _Program:
        lanes, columns = program.lanes, (program.columns + 3) & ~3
        data = program.rows, program.gathers, program.bases, program.results, program.numbers, program.tables
        room = program.places, np.empty(program.slots * lanes), np.empty(columns * lanes)
        arrays = [np.ascontiguousarray(array) for array in (*data, *room)]
        self._kept += arrays
        pointers = [array.ctypes.data for array in arrays]
        numbers = lanes, program.blocks, program.points, program.rank
        sizes = len(program.rows), len(program.results), program.width, program.columns
        return _Program(*numbers, *sizes, *pointers[: len(data)], program.entity_size, *pointers[len(data) :])


def _kernels(library: ctypes.CDLL) -> Any:
    return (ctypes.c_void_p * _MOST).in_dll(library, "kernels")


@cache
def _library() -> tuple[ctypes.CDLL, deque[int]]:
    """Return the interpreter, and the numbers of its functions that are free."""
    code = Path(__file__).with_name("interpreter.c").read_text()
    return compile_library(MPI.COMM_SELF, code, optimisation=_OPTIMISATION), deque(range(_MOST))
