"""An integral that unknown numbers make zero, with its derivatives; a weak form keeps it and its programs."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.parameters import ParameterDerivative, ParameterDirection, Parameters
from hpcinv.model.spaces import Unknowns


class ConstraintIntegral:
    """An integral C of the state and the parameters, scaled; methods are collective.

    Args:
        form: without arguments.
    """

    def __init__(self, form: Any, unknowns: Unknowns, parameters: Parameters) -> None:
        self._form, self._unknowns, self._parameters = form, unknowns, parameters

    def value(self) -> float:
        """Return C at the present state."""
        return self._total(fem.assemble_vector(self._integral).array)

    def gradient(self, b: PETSc.Vec) -> None:
        """Set ``b`` to the derivative of C by the state."""
        with b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._gradient)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def rate(self, direction: ParameterDirection) -> float:
        """Return the derivative of C in a direction of the parameters."""
        b = fem_petsc.create_vector(self._weight.ufl_function_space())
        self._parameter_derivative.assemble(direction, b)
        with b.localForm() as local:
            total = self._total(local.array)
        b.destroy()
        return total

    def _total(self, values: Any) -> float:
        return float(self._unknowns.mesh.comm.allreduce(float(values.sum()), op=MPI.SUM))

    @cached_property
    def _weight(self) -> Any:
        """A constant of each cell: with it C becomes a vector, which programs assemble."""
        return ufl.TestFunction(fem.functionspace(self._unknowns.mesh, ("DG", 0)))

    @cached_property
    def _weighted(self) -> Any:
        parts = self._form.integrals()
        return ufl.Form([part.reconstruct(integrand=part.integrand() * self._weight) for part in parts])

    @cached_property
    def _integral(self) -> fem.Form:
        return fem.form(self._weighted)

    @cached_property
    def _gradient(self) -> fem.Form:
        return fem.form(ufl.derivative(self._form, self._unknowns.state, self._unknowns.test))

    @cached_property
    def _parameter_derivative(self) -> ParameterDerivative:
        return ParameterDerivative(self._weighted, self._parameters, self._unknowns.mesh)
