"""Values of programs at points of cells, which later processes find without UFL."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hpcinv.physics.points.interpreter import kernel_of
from hpcinv.physics.points.program import EXPRESSION, Doubles, Integers
from hpcinv.physics.points.program_files import Programs


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
