"""The interpreter of programs, functions with the signature of DOLFINx' kernels that run them, and values at points."""

from __future__ import annotations

import ctypes
import weakref
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.parallel.c_code import NoLibrary, compile_library
from hpcinv.base.parallel.runtime import MPI
from hpcinv.on_demand import on_demand
from hpcinv.physics.points.program import EXPRESSION, Doubles, Integers, Place, Program
from hpcinv.physics.points.program_files import Programs

_MOST = 1024
"""kernels that one copy of the interpreter can have at a time: `functions` of interpreter.c"""

_BLOCK = 16
"""points of several cells that the interpreter does at once: `values_of_cells` of interpreter.c"""

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


class _Cells(ctypes.Structure):
    _fields_ = (("count", ctypes.c_int), *((name, ctypes.c_int64) for name in ("w", "x", "A")))


def kernel_of(programs: Sequence[Program], place: Place) -> Any:
    """Return the kernel of programs: in C, or in NumPy (`array_interpreter`) where there is no compiler.

    Args:
        place: of the integral in its form.
    """
    if not reason_against_c():
        with suppress(NoLibrary):
            return Kernel(programs)
    return on_demand("kernel in NumPy")(programs, place)


@cache
def reason_against_c() -> str:
    """Return why the interpreter cannot be in C on this machine; "" if it can."""
    try:
        _copy(0)
    except NoLibrary as reason:
        return str(reason)
    return ""


def note_on_speed() -> str:
    """Return the line that a run prints where NumPy is the interpreter; "" where it is not."""
    reason = reason_against_c()
    return reason and f"{reason}: NumPy evaluates laws and loads, which takes longer (docs/how-to/start-up.md)"


class Kernel:
    """Programs that together make an element's number, vector, matrix or the values of an expression.

    Attributes:
        address: of the function that runs them.
        size: values of an expression in a cell.
        chunk: cells whose nodal values are given at once.
    """

    chunk = 512

    def __init__(self, programs: Sequence[Program]) -> None:
        library, number = _take_function()
        self._library, self.size = library, programs[0].points * programs[0].width
        self._kept: list[Any] = []
        structures = (_Program * len(programs))(*map(self._structure, programs))
        self._kernel = _Kernel(len(programs), structures)
        (ctypes.c_void_p * _MOST).in_dll(library, "kernels")[number] = ctypes.addressof(self._kernel)
        self.address = (ctypes.c_void_p * _MOST).in_dll(library, "functions")[number]
        weakref.finalize(self, _free.append, (library, number))

    def evaluate(self, w: Doubles, constants: Doubles, x: Doubles) -> Doubles:
        """Return the values of an expression on some cells (cells, `size`).

        Args:
            w: nodal values of the functions (cells, any number).
            x: coordinates of the nodes (cells, 3 nodes).
        """
        values = np.empty((len(x), self.size))
        arrays = [np.ascontiguousarray(array) for array in (w, constants, x, values)]
        steps = _Cells(1, w.shape[1], x.shape[1], self.size)
        addresses = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        self._library.values_of_cells(ctypes.byref(self._kernel), ctypes.c_int64(len(x)), steps, *addresses)
        return values

    def _structure(self, program: Program) -> _Program:
        lanes, columns = program.lanes, (program.columns + 3) & ~3
        data = program.rows, program.gathers, program.bases, program.results, program.numbers, program.tables
        together = _BLOCK if program.rank < 0 else lanes  # points of several cells
        room = program.places, np.empty(program.slots * together), np.empty(columns * lanes)
        arrays = [np.ascontiguousarray(array) for array in (*data, *room)]
        self._kept += arrays
        pointers = [array.ctypes.data for array in arrays]
        numbers = lanes, program.blocks, program.points, program.rank
        sizes = len(program.rows), len(program.results), program.width, program.columns
        return _Program(*numbers, *sizes, *pointers[: len(data)], program.entity_size, *pointers[len(data) :])


_free: deque[tuple[ctypes.CDLL, int]] = deque()
"""functions that no kernel has: copies of the interpreter with their numbers"""
_copies: list[ctypes.CDLL] = []
"""copies of the interpreter whose functions are free or taken"""


def _take_function() -> tuple[ctypes.CDLL, int]:
    """Return a function that no kernel has, of a further copy of the interpreter if all have one."""
    if not _free:
        _copies.append(_copy(len(_copies)))
        _free.extend((_copies[-1], number) for number in range(_MOST))
    return _free.popleft()


@cache
def _copy(number: int) -> ctypes.CDLL:
    """Return a copy of the interpreter, with functions of its own."""
    code = Path(__file__).with_name("interpreter.c").read_text()
    return compile_library(MPI.COMM_SELF, code, optimisation=_OPTIMISATION, is_separate=number > 0)


class PointKernel:
    """Programs of an expression at points of the reference cell.

    Args:
        functions, constants: all of the form or expression of which the programs were made.
    """

    def __init__(self, programs: Programs, functions: Sequence[Any], constants: Sequence[Any]) -> None:
        (integral,) = programs.integrals
        (program,) = integral.programs
        self._kernel, self._shape = kernel_of([program], EXPRESSION), (program.points, program.width)
        self._functions, self._constants = [functions[i] for i in programs.functions], constants

    def eval(self, mesh: Any, cells: Integers) -> Doubles:
        """Return the present values on some local cells, (cells, points, values)."""
        constants = np.concatenate([np.zeros(0), *(constant.value.ravel() for constant in self._constants)])
        dofs, positions = mesh.geometry.dofmaps[0], mesh.geometry.x
        values = np.empty((len(cells), *self._shape))
        for start in range(0, len(cells), self._kernel.chunk):
            chunk = cells[start : start + self._kernel.chunk]
            nodal = [np.zeros((len(chunk), 0)), *(_nodal_values(f, chunk) for f in self._functions)]
            made = self._kernel.evaluate(
                np.concatenate(nodal, axis=1), constants, positions[dofs[chunk]].reshape(len(chunk), -1)
            )
            values[start : start + len(chunk)] = made.reshape(-1, *self._shape)
        return values


def _nodal_values(f: Any, cells: Integers) -> Doubles:
    """Return the values of a function at the degrees of freedom of cells, the components of a node together."""
    dofmap = f.function_space.dofmap
    values: Doubles = f.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells]].reshape(len(cells), -1)
    return values
