"""Tangent of a weak form as a PETSc matrix whose CSR arrays are filled in place.

The place of each entry of each element matrix is computed once, which avoids PETSc's search for it.
"""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives

from hpcinv.base.parallel.c_code import NoLibrary, array_type, compile_library
from hpcinv.base.parallel.malloc import release_freed_memory
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.array_code import CsrCode
from hpcinv.model.assembly.element_matrices import Block, ElementMatrices
from hpcinv.model.assembly.moduli_at_points import moduli_at_points
from hpcinv.model.assembly.pattern import pattern_of
from hpcinv.model.assembly.tangent_moduli import Term, UnsupportedForm
from hpcinv.model.spaces import Unknowns
from hpcinv.model.weak_form import WeakForm

_CODE = Path(__file__).with_suffix(".c")

type FilledTerm = list[ElementMatrices] | fem.Form
type _Code = ctypes.CDLL | type[CsrCode]


def compiled_code(comm: MPI.Intracomm) -> _Code:
    """Return the functions of this module in C, or in NumPy where there is no compiler; collective."""
    try:
        code = compile_library(comm, _CODE.read_text())
    except NoLibrary:
        return CsrCode
    doubles, integers = array_type(np.float64), array_type(np.int32)
    sizes = ctypes.c_int64, *4 * (ctypes.c_int,)
    code.add.argtypes = [*sizes, doubles, integers, integers, ctypes.c_int, doubles]
    code.find.argtypes = [ctypes.c_int64, *5 * (integers,)]
    return code


class FilledTangent:
    """``K = ∂R/∂x`` of the residual of a weak form, with ones on the diagonal of unknowns that are prescribed.

    Raises:
        UnsupportedForm: on all ranks, if the form of the residual has no tangent moduli.
    """

    note = ""
    is_filled = True

    def __init__(
        self,
        weak_form: WeakForm,
        director: Any = None,
    ) -> None:
        self._unknowns, self._director = weak_form.unknowns, director
        unknowns = weak_form.unknowns
        moduli = moduli_at_points(weak_form.residual, unknowns)
        self._volume = [ElementMatrices(part, unknowns, director) for part in moduli]
        self._code = compiled_code(unknowns.mesh.comm)
        surface = surface_tangent(weak_form.residual, unknowns.state)
        self._surface = None if surface is None else fem.form(surface)

    def term(self, term: Term) -> FilledTerm:
        """Return a term that can be added to the tangent; collective."""
        try:
            moduli = moduli_at_points(term, self._unknowns)
            return [ElementMatrices(part, self._unknowns, self._director) for part in moduli]
        except UnsupportedForm:
            return fem.form(ufl.replace(term.form, dict(term.factors)))

    def create_matrix(
        self, conditions: Sequence[fem.DirichletBC], like: object = None
    ) -> tuple[PETSc.Mat, Callable[..., None]]:
        """Return a matrix for Dirichlet conditions, and a collective function to assemble it at the present state.

        The argument of that function are terms that are added.

        Args:
            like: another tangent on the same unknowns, whose pattern is used.
        """
        rows = like._rows if isinstance(like, FilledTangent) else _SparseRows(self._unknowns, self._code)
        self._rows: _SparseRows = rows
        A, values, (starts, columns, ghost_columns, names) = rows.matrix()
        prescribed = np.zeros(rows.count, dtype=bool)
        for condition in conditions:
            prescribed[condition.dof_indices()[0]] = True
        prescribed_places, diagonal = rows.places_of(prescribed)

        def assemble(terms: Sequence[FilledTerm] = ()) -> None:
            A.zeroEntries()
            values[:] = 0.0
            forms = [] if self._surface is None else [self._surface]
            volume = list(self._volume)
            for term in terms:
                if isinstance(term, fem.Form):
                    forms.append(term)
                else:
                    volume += term
            for part in volume:
                places = rows.places(part)
                for chunk, blocks in part:
                    for entries, block_places in zip(blocks, places, strict=True):
                        block_places.add(self._code, chunk, entries, values)
            values[prescribed_places] = 0.0
            values[diagonal] = 1.0
            A.setValuesIJV(starts, columns, ghost_columns, addv=PETSc.InsertMode.ADD, rowmap=names)
            A.assemble()
            for form in forms:
                if self._director is not None:
                    self._director.add(A, form)
                    continue
                fem_petsc.assemble_matrix(A, form, bcs=conditions)
                A.assemble()  # PETSc does not add values after the diagonal of prescribed unknowns was inserted

        return A, assemble


@dataclass(frozen=True)
class _Places:
    """Places of the entries of a block; the unknowns of a node are consecutive, and their rows have equal lengths.

    Attributes:
        first: place of the first components of each pair of nodes, (cells, nodes, nodes).
        row: distance from there to the next row, of the same shape, or (cells, nodes, 1) where it is the row's length.
    """

    block: Block
    first: LocalIndices
    row: LocalIndices

    def add(self, code: _Code, cells: slice, entries: Floats, values: Floats) -> None:
        """Add the entries of some cells, (cells, *block.shape), to the values of the matrix."""
        first, row = self.first[cells], self.row[cells]
        code.add(len(first), *self.block.shape, entries, first, row, row.shape == first.shape, values)


class _SparseRows:
    """Rows of matrices on this rank, and places of their entries in one array of values.

    The array begins with PETSc's diagonal and off-diagonal blocks of the owned rows, which PETSc uses without copies.
    Rows of ghosts follow, whose values are sent to other ranks.
    """

    def __init__(self, unknowns: Unknowns, code: _Code) -> None:
        dofmap = unknowns.space.dofmap
        self._find = code.find
        self._nodes, self._bs = nodes, bs = dofmap.index_map, dofmap.index_map_bs
        pattern, indices = pattern_of(unknowns)
        self._pattern = pattern
        indptr, names = pattern.starts, pattern.names.astype(PETSc.IntType)
        self.owned, self.count = bs * nodes.size_local, len(indptr) - 1
        self._dofs = _unrolled(dofmap.list, bs)
        end = int(indptr[self.owned])  # of the owned rows
        other = np.flatnonzero(indices[:end] >= self.owned)  # last in each row
        row = np.searchsorted(indptr, other, side="right") - 1
        other = other[np.lexsort((names[indices[other]], row))]  # PETSc requires columns in their global order
        preceding = np.zeros(self.owned + 1, dtype=np.int32)  # number of such entries before each row
        preceding[1:] = np.cumsum(np.bincount(row, minlength=self.owned))
        starts, self._diagonal = indptr[: self.owned + 1] - preceding, end - len(other)
        self._indptr, self._other, self._preceding = indptr, other, preceding
        self._off_diagonal_lengths = np.zeros(
            self.count, dtype=np.int32
        )  # row lengths in the off-diagonal and in the diagonal block
        self._off_diagonal_lengths[: self.owned] = np.diff(preceding)
        self._diagonal_lengths = np.diff(indptr) - self._off_diagonal_lengths
        self._off_diagonal_lengths[self.owned :] = self._diagonal_lengths[self.owned :]  # rows of ghosts are not split
        inner = np.delete(indices[:end], other) if len(other) else indices[:end]
        self._blocks = _integers(starts, inner), _integers(preceding, names[indices[other]])
        self._ghost_rows = _integers(indptr[self.owned :] - end, names[indices[end:]])
        self._known: list[tuple[LocalIndices, _Places]] = []
        self._last: tuple[npt.NDArray[np.bool_], LocalIndices, LocalIndices] | None = None

    @cached_property
    def _place(self) -> LocalIndices:
        """Place of each entry of the pattern."""
        end = int(self._indptr[self.owned])
        place = np.arange(self._indptr[-1], dtype=np.int32)
        place[:end] -= np.repeat(self._preceding[:-1], np.diff(self._indptr[: self.owned + 1]))
        place[self._other] = np.arange(self._diagonal, end)
        return place

    def matrix(self) -> tuple[PETSc.Mat, Floats, tuple[Any, ...]]:
        """Return a new matrix, the array of its values, and rows of ghosts: starts, columns, values, and names."""
        nodes, bs, comm = self._nodes, self._bs, self._nodes.comm
        end = len(self._blocks[0][1]) + len(self._blocks[1][1])
        values = np.zeros(end + len(self._ghost_rows[1]))
        own = *self._blocks[0], values[: self._diagonal]
        starts, columns = self._blocks[1]
        off = starts, columns.copy(), values[self._diagonal : end]  # PETSc numbers these columns again, in place
        size = (self.owned, bs * nodes.size_global)
        arrays = own if comm.size == 1 else (own, off)
        A = PETSc.Mat().createAIJWithArrays((size, size), arrays, bsize=bs, comm=comm)
        A.setAttr("arrays", arrays)  # PETSc uses their memory
        here = _global(nodes).astype(PETSc.IntType)
        numbering = PETSc.LGMap().create(here, bsize=bs, comm=comm)  # type: ignore[arg-type]  # an array will do
        A.setBlockSizes(bs, bs)  # createAIJWithArrays drops it
        A.setLGMap(numbering, numbering)
        ghosts = _unrolled(here[nodes.size_local :], bs)
        return A, values, (*self._ghost_rows, values[end:], ghosts)

    def entry_places(self, rows: LocalIndices, columns: LocalIndices) -> LocalIndices:
        """Return places of entries by local row and column."""
        return self._placed(self._pattern.entries(rows, columns, self._find))

    def _placed(self, entries: LocalIndices) -> LocalIndices:
        """Return the places of entries of the pattern, whose order they have where no columns belong to other ranks."""
        return self._place[entries] if len(self._other) else entries

    def places_of(self, unknowns: npt.NDArray[np.bool_]) -> tuple[LocalIndices, LocalIndices]:
        """Return places of all entries in the rows and columns of some local unknowns, and of those on the diagonal.

        They are kept for the next matrix, which mostly has the same supports.
        """
        if self._last is None or not np.array_equal(self._last[0], unknowns):
            own_rows, ghost_rows = unknowns[: self.owned], unknowns[self.owned :]
            names = self._pattern.names[: len(unknowns)][unknowns]
            (starts, inner), (other_starts, other), (ghost_starts, ghosts) = *self._blocks, self._ghost_rows
            chosen = [
                np.repeat(own_rows, np.diff(starts)) | unknowns[inner],
                np.repeat(own_rows, np.diff(other_starts)) | np.isin(other, names),
                np.repeat(ghost_rows, np.diff(ghost_starts)) | np.isin(ghosts, names),
            ]
            places = np.flatnonzero(np.concatenate(chosen)).astype(np.int32)
            diagonal = np.flatnonzero(own_rows).astype(np.int32)
            self._last = unknowns, places, self.entry_places(diagonal, diagonal)
        return self._last[1:]

    def places(self, matrices: ElementMatrices) -> list[_Places]:
        """Return places of the entries of element matrices, block by block; they are computed once."""
        places = [self._places(matrices.cells, block) for block in matrices.blocks]
        if "_place" in self.__dict__:
            del self._place  # as large as the columns of the matrix
            release_freed_memory()  # else the next factorization adds to what the pattern took for a while
        return places

    def _places(self, cells: LocalIndices, block: Block) -> _Places:
        for known_cells, known in self._known:
            ranges = known.block.rows, known.block.columns
            if ranges == (block.rows, block.columns) and np.array_equal(known_cells, cells):
                return known
        dofs = self._dofs[cells]
        rows, columns = np.broadcast_arrays(dofs[:, block.rows.leading(), None], dofs[:, None, block.columns.leading()])
        first = self.entry_places(rows.ravel(), columns.ravel()).reshape(rows.shape)
        if len(self._other):
            row = np.where(columns < self.owned, self._diagonal_lengths[rows], self._off_diagonal_lengths[rows])
        else:
            row = self._diagonal_lengths[rows[:, :, :1]]
        places = _Places(block, first, np.ascontiguousarray(row))
        self._known.append((cells, places))
        return places


def surface_tangent(residual: Any, state: fem.Function) -> Any:
    """Return the derivative of the integrals over facets, ``None`` if there is none."""
    surface = [integral for integral in residual.integrals() if integral.integral_type() != "cell"]
    if not surface:
        return None
    tangent = expand_derivatives(ufl.derivative(ufl.Form(surface), state))
    return None if tangent.empty() else tangent


def _unrolled(blocks: npt.NDArray[Any], bs: int) -> npt.NDArray[Any]:
    """Return numbers of unknowns from numbers of nodes; the last axis becomes ``bs`` times as long."""
    unrolled = bs * blocks[..., None] + np.arange(bs, dtype=blocks.dtype)
    return unrolled.reshape(*blocks.shape[:-1], -1)


def _global(numbering: Any) -> npt.NDArray[np.int64]:
    """Return the global numbers of all local indices, ghosts included."""
    numbers: npt.NDArray[np.int64] = numbering.local_to_global(
        np.arange(numbering.size_local + numbering.num_ghosts, dtype=np.int32)
    )
    return numbers


def _integers(starts: Any, columns: Any) -> tuple[Any, Any]:
    """Return rows and columns of CSR arrays in PETSc's type, so that it uses them without copies."""
    starts, columns = (np.ascontiguousarray(array, dtype=PETSc.IntType) for array in (starts, columns))
    return starts, columns
