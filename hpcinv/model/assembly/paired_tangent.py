"""The tangent of a body with interfaces: its matrix, and the stiffness of the interfaces in the same matrix.

An interface joins unknowns of different cells, maybe of different ranks, so the pattern is the union of both. It grows
where surfaces that slide meet other facets, and never shrinks: then there is a new symbolic factorization.
"""

from collections.abc import Callable, Sequence
from typing import Any

from dolfinx import fem
from petsc4py import PETSc

from hpcinv.model.interfaces.entries import DIFFERENT_PATTERN
from hpcinv.model.interfaces.pair import SurfacePair

_SUBSET: Any = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN  # its stub has the wrong type


class PairedTangent:
    """A matrix with the sum of a body's tangent and the stiffness of its interfaces; methods are collective.

    Args:
        own: the tangent of the body, with a function that assembles it.
        conditions: of prescribed unknowns, whose rows and columns the interfaces leave as they are.

    Attributes:
        matrix: the sum.
        pattern: number of its pattern.
    """

    def __init__(
        self,
        own: PETSc.Mat,
        assemble: Callable[..., None],
        pairs: Sequence[SurfacePair],
        conditions: Sequence[fem.DirichletBC],
    ) -> None:
        self._own, self._assemble, self._pairs = own, assemble, pairs
        self._free = own.createVecRight()
        self._free.set(1.0)
        for condition in conditions:
            dofs = condition.dof_indices()[0]
            self._free.array[dofs[dofs < self._free.getLocalSize()]] = 0.0
        self.matrix: PETSc.Mat = own.duplicate()
        symmetric: Any = PETSc.Mat.Option.SYMMETRIC  # its stub has the wrong type
        self.matrix.setOption(symmetric, False)
        self._versions: tuple[int, ...] = ()
        self.pattern = 0

    def assemble(self, terms: Sequence[Any] = ()) -> None:
        """Assemble the sum at the present state, with additional terms of the body's tangent."""
        self._assemble(terms)
        self.matrix.assemble()
        self.matrix.zeroEntries()
        versions = tuple(pair.version for pair in self._pairs)
        structure = _SUBSET if versions == self._versions else DIFFERENT_PATTERN
        self.pattern += versions != self._versions
        self._versions = versions
        self.matrix.axpy(1.0, self._own, structure)
        for pair in self._pairs:
            stiffness = pair.stiffness(self._free)
            self.matrix.axpy(1.0, stiffness, structure)
            stiffness.destroy()

    def destroy(self) -> None:
        """Free PETSc objects, the body's tangent included."""
        for part in (self.matrix, self._own, self._free):
            part.destroy()
