"""The tangent ``K = ∂R/∂x`` of a weak form, and the choice between two ways to assemble it.

Either DOLFINx assembles it as a form. Or its moduli are evaluated at points, and a matrix is filled in place
(`csr_tangent`): each assembly is 2 to 3 times as fast, but its pattern takes longer to make, and the unknowns of a
node must be consecutive. The matrices are the same to rounding errors. A residual without tangent moduli has the form
on every mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, cast

import dolfinx.fem.petsc as fem_petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.mesh.regions import Mesh
from hpcinv.model.assembly.tangent_moduli import Term, UnsupportedForm
from hpcinv.model.weak_form import WeakForm
from hpcinv.on_demand import on_demand

_MANY = 2_000  # cells from which two tangents save more time than the pattern costs
_assumed: list[int] = []


class FormTangent:
    """The tangent as a form that DOLFINx assembles.

    Attributes:
        note: reason for its use where `FilledTangent` would be faster, else empty.
        matrix: the matrix that was created last.
    """

    note = ""
    is_filled = False

    def __init__(self, weak_form: WeakForm) -> None:
        unknowns = weak_form.unknowns
        tangent = ufl.derivative(weak_form.residual, unknowns.state, ufl.TrialFunction(unknowns.space))
        self._form = fem.form(tangent)

    def term(self, term: Term) -> fem.Form:
        """Return a term that can be added to the tangent; collective."""
        return fem.form(ufl.replace(term.form, dict(term.factors)))

    def create_matrix(
        self, conditions: Sequence[fem.DirichletBC], like: Tangent | None = None
    ) -> tuple[PETSc.Mat, Callable[..., None]]:
        """Return a matrix for Dirichlet conditions, and a collective function to assemble it at the present state.

        The argument of that function are terms that are added.

        Args:
            like: another tangent on the same unknowns, assembled, whose pattern is used; a new one takes as long as an
                assembly or two.
        """
        if isinstance(like, FormTangent):
            matrix = like.matrix.duplicate()
            symmetric: Any = PETSc.Mat.Option.SYMMETRIC  # its stub has the wrong type
            matrix.setOption(symmetric, False)
        else:
            matrix = cast("PETSc.Mat", fem_petsc.create_matrix(self._form))
        self.matrix: PETSc.Mat = matrix

        def assemble(terms: Sequence[fem.Form] = ()) -> None:
            matrix.zeroEntries()
            for form in (self._form, *terms):
                fem_petsc.assemble_matrix(matrix, form, bcs=conditions)
                matrix.assemble()  # PETSc does not add values after the diagonal of prescribed unknowns was inserted

        return matrix, assemble


class Tangent(Protocol):
    """The tangent of a weak form: a `FormTangent`, or filled in place (`hpcinv.model.assembly.csr_tangent`)."""

    note: str
    matrix: PETSc.Mat
    is_filled: bool

    def term(self, term: Term) -> Any:
        """Return a term that can be added to the tangent; collective."""

    def create_matrix(
        self, conditions: Sequence[fem.DirichletBC], like: Any = None
    ) -> tuple[PETSc.Mat, Callable[..., None]]:
        """Return a matrix for Dirichlet conditions, and a collective function to assemble it at the present state."""


def tangent_of(
    weak_form: WeakForm,
    like: Tangent | None = None,
    director: Any = None,
) -> Tangent:
    """Return the tangent of a weak form, with the assembly that suits its mesh; collective.

    Args:
        like: another tangent on the same unknowns. This one is assembled in the same way, and can have its pattern.
        director: unknowns of the tangent, if they are not at the nodes; only moduli can be assembled in them.
    """
    if director is not None:
        return on_demand("filled tangent")(weak_form, director)  # type: ignore[no-any-return]
    has_many = cells_of(weak_form.unknowns.mesh) >= _MANY if like is None else like.is_filled
    if not has_many:
        return FormTangent(weak_form)
    try:
        if not weak_form.unknowns.has_whole_nodes:
            raise UnsupportedForm("the unknowns of a node do not follow each other")
        return on_demand("filled tangent")(weak_form)  # type: ignore[no-any-return]
    except UnsupportedForm as why:
        whole = FormTangent(weak_form)
        whole.note = f"the tangent is assembled by DOLFINx, which takes two to three times as long: {why}"
        return whole


def cells_of(mesh: Mesh) -> int:
    """Return the number of cells of a mesh, or of the mesh `tangents_for` which kernels are chosen."""
    return _assumed[-1] if _assumed else int(mesh.topology.index_map(3).size_global)


@contextmanager
def tangents_for(cells: int) -> Iterator[None]:
    """Context in which tangents are chosen as for a mesh of a given number of cells."""
    _assumed.append(cells)
    try:
        yield
    finally:
        _assumed.pop()
