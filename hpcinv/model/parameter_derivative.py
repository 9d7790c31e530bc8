"""Derivative ``∂R/∂θ`` of the residual of a scene by its parameters."""

from typing import Any

import basix.ufl
import dolfinx.fem.petsc as fem_petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.mesh.regions import Mesh
from hpcinv.model.parameters import Direction, Parameters
from hpcinv.parallel.jit import JIT_OPTIONS


class ParameterDerivative:
    """Derivative of a scene's residual in any direction of its parameters, as one form that is compiled once.

    UFL differentiates by coefficients, not by constants: a coefficient replaces the constant of all parameters during
    differentiation. Parameters and their rates are then two halves of one constant (see `Parameters`).
    """

    def __init__(self, residual: Any, par: Parameters, mesh: Mesh) -> None:
        self._parameters, count = par, par.constant.value.size
        self._point_and_way = both = fem.Constant(mesh, np.zeros(2 * count))
        space = ufl.FunctionSpace(mesh.ufl_domain(), basix.ufl.element("DG", mesh.basix_cell(), 0, shape=(count,)))
        point, way = ufl.Coefficient(space), ufl.Coefficient(space)
        self._functions, self._rates = par.functions, [fem.Function(f.function_space) for f in par.functions]
        residual = ufl.replace(residual, {par.constant: point})
        derivative = ufl.derivative(residual, (point, *self._functions), (way, *self._rates))
        halves = (ufl.as_vector([both[i] for i in part]) for part in (range(count), range(count, 2 * count)))
        form = ufl.replace(derivative, dict(zip((point, way), halves, strict=True)))
        self._form = fem.form(form, jit_options=JIT_OPTIONS)

    def assemble(self, along: Direction, b: PETSc.Vec) -> None:
        """Assemble the derivative at the present state and load into ``b``, for the cells of this rank."""
        self._point_and_way.value[:] = np.concatenate([self._parameters.constant.value, along.entries])
        for function, rate in zip(self._functions, self._rates, strict=True):
            given = [found for known, found in along.functions if known is function]
            rate.x.array[:] = given[0].x.array if given else 0.0
        with b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._form)
