"""Choice of the linear solver's configuration: by the job, or by size, shape and available memory."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from hpcinv.base.parallel.left_for_run import available
from hpcinv.job.settings import Solver
from hpcinv.model.spaces import Unknowns
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Direction
from hpcinv.solver.linear.cost_model import (
    COMPACT,
    CORRECTIONS,
    LOW_RANK,
    SINGLE,
    SLENDER,
    Forecast,
    Shape,
    flat_share,
    shape_of,
)

MINIMUM_FILL, METIS = 2, 5  # of ICNTL(7); the first takes a fifth of the time, and cuts compact bodies less well
_WORTH = 1.1  # least gain of multigrid: factorizations also give signs along the path, and fail at once
_FLAT_SHARE = 0.1  # of flat cells; above it multigrid hardly converges: smoothers of points leave errors across them
_OBVIOUS = 10.0  # gain by the shape, above which branches cannot make factorizations the faster ones
_UNLIKE = 1.6  # times the operations that are forecast for blocks, up to which MUMPS was seen to take more or fewer
_PATIENCE = 3  # times the Krylov iterations that are forecast for a whole solution, as limit of one Newton solve
# Times the iterations of a correction with which both solvers take the same time, after which factorizations replace
# multigrid. Until then it takes at most 1.5/8 of their time; more waste more, fewer leave multigrid that is worth it.
_REVISED = 1.5
_SLOW = 2.0  # times the iterations by the displacement form, above which the mixed form is recommended
_ROOM = 0.8  # share of the memory that factors may take
_KEPT = 4  # times the memory of multigrid; there must be room for it if it is kept
_WORTH_NESTED = 2.5  # least gain of nested iteration by the forecast, which is rough
_TANGENTS: Mapping[Direction, int] = {
    "inverse": 3,
    "forward": 6,
}
"""Number of tangents of a solve, for slender bodies that turn far."""
_OWN = frozenset({"ksp_type", "pc_type"})
_PACKAGE = "pc_factor_mat_solver_type"


@dataclass(frozen=True)
class Choice:
    """A configuration, and the reason for it.

    Attributes:
        other: configuration after a failure, ``None`` for none.
        is_own: whether the job's PETSc options choose the type of the solver, or the package that factorizes.
        budget: largest number of Krylov iterations in one solve of Newton's method.
        most: largest number of Krylov iterations of one of its corrections.
        precision: of factors, "single" or "double".
        is_refined: whether FGMRES refines solutions, so that factors of earlier tangents serve too.
        low_rank: whether blocks of factors in single precision are compressed.
        minimum_fill: whether factors are ordered by approximate minimum fill.
        nearly_symmetric: whether factors of nearly symmetric tangents are symmetric. Slender bodies turn so far that
            their later tangents are not.
        equal_solves: number of solves by factors that take as long as a factorization. A larger one lets power series
            use factors of an earlier tangent more often.
    """

    configuration: str
    why: str
    other: str | None = None
    is_own: bool = False
    budget: int = 2000
    most: float = math.inf
    precision: str = "double"
    is_refined: bool = False
    low_rank: bool = False
    minimum_fill: bool = False
    nearly_symmetric: bool = False
    equal_solves: float = math.inf


@dataclass(frozen=True)
class Used:
    """The linear solver of a solution: last configuration, reason for it, and reason for a change of configuration.

    Attributes:
        note: remark on an unusual assembly of the tangent; empty if there is none.
    """

    configuration: str
    why: str
    fallback: str | None
    note: str = ""


class Chooser:
    """Rule for the choice, for the unknowns of one model; collective.

    Args:
        stiffness: largest ratio of bulk to shear modulus in the body.

    Attributes:
        forecast: forecast of the cost of both solvers.
        room: memory (bytes) of all ranks for it.
    """

    def __init__(self, unknowns: Unknowns, degree: int, *, against_multigrid: str = "", stiffness: float = 1.0) -> None:
        self._against_multigrid = against_multigrid
        has_hexahedra = unknowns.mesh.topology.cell_type.name == "hexahedron"
        shape, is_mixed = shape_of(unknowns), unknowns.p is not None
        self.forecast = Forecast(unknowns.size, degree, shape, is_mixed, has_hexahedra, stiffness)
        self._flat_share = flat_share(unknowns)
        self.room = _ROOM * available(unknowns.mesh.comm)
        self._is_slender = self.forecast.shape.aspect >= SLENDER
        self._ranks = unknowns.mesh.comm.size
        self._is_analysed = False

    @property
    def is_compact(self) -> bool:
        """True if no extent of the body is much larger than the others."""
        return self.forecast.block.shape.aspect < COMPACT

    @property
    def can_factorize(self) -> bool:
        """True if there is memory for the factors L U."""
        return self.forecast.factors <= self.room

    @property
    def can_factorize_symmetric(self) -> bool:
        """True if there is memory for the factors L D Lᵀ, which need half of that."""
        return self.forecast.factors / 2 <= self.room

    @property
    def can_keep_multigrid(self) -> bool:
        """True if there is memory for a waiting hierarchy, another one, and the fields of finer spaces."""
        return _KEPT * self.forecast.multigrid <= self.room

    def analyse(self, solver: Solver, unknowns: Unknowns) -> None:
        """Count operations by a symbolic analysis where the extents of the body do not decide; collective.

        A body of branches or with holes has smaller separators than a block of its extents.
        """
        if self._is_analysed or not self._is_open(solver):
            return
        self._is_analysed = True
        block = self.forecast
        for ordering in MINIMUM_FILL, METIS:
            operations = on_demand("symbolic analysis")(unknowns, ordering)
            if operations is not None and _UNLIKE * operations < block.operations:
                shape = Shape.equal_rod(operations, block.unknowns)
                self.forecast = replace(block, shape=shape, extents=block.shape)
            else:
                self.forecast = block
            if self.forecast.direct < self.forecast.iterative:  # a better ordering would make it still faster
                return

    def _is_open(self, solver: Solver) -> bool:
        """Return whether neither the job nor the shape of the body decides."""
        if solver.linear != "auto" or self._own(solver) or self._against_multigrid or not self.can_factorize:
            return False
        if self.forecast.shape.is_solid or self._flat_share >= _FLAT_SHARE:
            return False
        return _WORTH < self.forecast.direct / self.forecast.iterative < _OBVIOUS

    def choose(self, solver: Solver) -> Choice:
        """Return the configuration that ``solver.linear`` names, or the faster one for which there is memory."""
        if own := self._own(solver):
            configuration = "iterative" if solver.linear == "iterative" else "direct"
            return Choice(configuration, f"the job's, with {' and '.join(sorted(own))} of solver.petsc", is_own=True)
        chosen = self._choose(solver)
        # A body with holes has factors of fewer operations than a block, but as many entries, which then take the time.
        operations = self.forecast.block.operations
        low_rank = operations >= LOW_RANK and not self._is_slender  # whose fronts are small
        is_refined = operations >= SINGLE
        single = operations >= LOW_RANK if self._takes_series(solver) else is_refined
        precision = str(solver.petsc.get("pc_precision", "single" if single else "double"))
        low_rank = bool(solver.petsc.get("mat_mumps_icntl_35", low_rank))
        krylov = self.forecast.krylov
        is_revised = chosen.configuration == "iterative" and chosen.other == "direct"
        return replace(
            chosen,
            why=chosen.why + self._advice(chosen),
            most=math.ceil(max(_REVISED * self.forecast.equal_krylov, krylov)) if is_revised else math.inf,
            budget=math.ceil(_PATIENCE * CORRECTIONS * krylov),
            precision=precision,
            is_refined=precision == "single" or (is_refined and "pc_precision" not in solver.petsc),
            low_rank=low_rank,
            minimum_fill=self._is_slender and self._ranks == 1,  # two ranks make better use of METIS's ordering
            nearly_symmetric=not self._is_slender,
            equal_solves=self.forecast.factorization / self.forecast.back_substitution,
        )

    def _takes_series(self, solver: Solver) -> bool:
        """Return whether the path is probably a power series, which takes two factorizations only.

        For the series of thin bodies single precision does not suffice. Slender ones are solved by nested iteration, or
        by steps, unless the job asks for a series.
        """
        series = "series" if self._is_slender else "auto"
        return not self.is_compact and solver.strategy == "adaptive" and solver.continuation in ("series", series)

    @staticmethod
    def _own(solver: Solver) -> frozenset[str]:
        """Options of the job that would replace options of another configuration."""
        own = _OWN & set(solver.petsc)
        if solver.linear != "iterative" and solver.petsc.get(_PACKAGE, "mumps") != "mumps":
            own |= {_PACKAGE}  # the direct solver sets options of MUMPS, and asks it for signs of pivots
        return own

    def is_nested_iteration_worth(self, solver: Solver, direction: Direction) -> bool:
        """Return whether the solution on coarser cells clearly saves time, as on large slender bodies that turn far.

        On smaller bodies than those with factors in single precision, cells twice as large are too coarse: the solution
        there is so far from the one sought that several factorizations are left.
        """
        is_large = self._is_slender and self.forecast.operations >= SINGLE
        if not is_large or self._choose(solver).configuration != "direct":
            return False
        return self.forecast.nested_gain(_TANGENTS[direction], self._ranks) >= _WORTH_NESTED

    def _advice(self, chosen: Choice) -> str:
        """Return what makes multigrid slow and can be changed in the job; empty if nothing does."""
        slower = self.forecast.locking
        if chosen.configuration != "iterative" or slower < _SLOW:
            return ""
        return (
            f"; the material is nearly incompressible, which multiplies iterations by about {slower:.2g} in the "
            "displacement form, but not in the mixed one (formulation: mixed, of degree 2)"
        )

    def _choose(self, solver: Solver) -> Choice:
        if solver.linear != "auto":
            return Choice(solver.linear, "the job asks for it")
        if self._against_multigrid:
            return Choice("direct", self._against_multigrid)
        fallback = "direct" if self.can_factorize else None
        if not self.can_factorize:
            return Choice(
                "iterative",
                f"factors would take {_memory(self.forecast.factors)}, and there is room for {_memory(self.room)}",
            )
        if self._flat_share >= _FLAT_SHARE:
            return Choice("direct", f"{self._flat_share:.0%} of the cells are too flat for multigrid", "iterative")
        ratio = self.forecast.direct / self.forecast.iterative
        size = f"at {self.forecast.unknowns} unknowns, {self.forecast.shape.cut:.0f} of them in a cross-section"
        if ratio > _WORTH:
            why = f"{size}, factorizations would take about {ratio:.2g} times as long as multigrid"
            return Choice("iterative", why, fallback)
        why = f"{size}, multigrid would take about {1 / ratio:.2g} times as long as factorizations"
        if ratio > 1:
            why += f"; it is taken below {1 / _WORTH:.2g}, since factorizations cannot fail to converge"
        return Choice("direct", why, "iterative")


def _memory(size: float) -> str:
    return f"{size / 1e9:.2g} GB"
