"""Expressions and moduli at points of cells, which later processes find without UFL."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import cpp, fem

from hpcinv.physics.points.kernels import Structures
from hpcinv.physics.points.program_files import Programs


class PointKernel(fem.Expression):  # type: ignore[misc]  # without types
    """Programs of an expression at points of the reference cell.

    Args:
        mesh: in UFL.
        functions, constants: all of the form or expression of which the programs were made.
    """

    def __init__(
        self,
        programs: Programs,
        points: npt.NDArray[np.float64],
        mesh: Any,
        functions: Sequence[Any],
        constants: Sequence[Any],
    ) -> None:
        self._made = Structures()
        (integral,) = programs.integrals
        shape = (integral.programs[0].width,)
        self._ufcx_expression = self._made.expression(programs, points, shape, len(constants), mesh)
        self._argument_space = None
        ffi = self._made.ffi
        self._cpp_object = cpp.fem.create_expression_float64(
            ffi.cast("uintptr_t", ffi.addressof(self._ufcx_expression)),
            [functions[i]._cpp_object for i in programs.functions],
            [constant._cpp_object for constant in constants],
            [],
            None,
        )
