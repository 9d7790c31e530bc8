"""Estimate of the discretisation error of a solution, as `discretisation_error` makes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.job.state_differences import parts, with_differences
from hpcinv.mesh.source import Floats

DEGREE_MORE = "in spaces of one degree more"
"""where the finer problem of a solid is solved"""
LINEAR = 0.5
"""Correction of the shape, relative to the displacement; above it one Newton step does not suffice."""
RAISED = 0.2
"""Presumed ratio of smooth errors of one degree more; a larger one refines more."""


@dataclass(frozen=True)
class Correction:
    """Correction of the rest shape by the estimate of the given state. Further states are solved on it.

    Attributes:
        nodes: correction of the local geometry nodes of the rest shape, (n, 3) in m.
        displacement: corrected displacement of the given state in the finer spaces, in m.
        without_geometry: as in `Estimate`, of further states.
        finer_nodes: of a shell: the corrected rest shape at the nodes of the finer problem, (m, 3) in m.
    """

    nodes: Floats
    displacement: fem.Function
    without_geometry: str
    finer_nodes: Floats | None = None


@dataclass(frozen=True)
class LayerError:
    """Error (SI) that the layer may leave in a quantity, 0 where it is not known, and its cause."""

    size: float
    cause: str


@dataclass(frozen=True)
class SingularLimit:
    """Effect of singular edges on the error of one solution.

    Attributes:
        share: share of the error that is in cells that touch these edges.
        order: order at which this share of the error falls with the size of cells.
        factor: ratio of the whole error to the part that the estimate finds.
        is_reliable: whether an estimate on one mesh is reliable.
        name: name of the edge with most of this error.
        point: a point of that edge (m).
        missed: factor of each owned cell: its share of the estimate is too small by it.
        orders: order of the errors of each owned cell; infinite in those that touch no singular edge.
    """

    share: float
    order: float
    factor: float
    is_reliable: bool
    name: str
    point: tuple[float, float, float]
    missed: Floats
    orders: Floats

    @property
    def text(self) -> str:
        """The edge, and what it does to the rate."""
        coordinates = ", ".join(f"{c:.4g}" for c in self.point)
        return f"{self.name} at ({coordinates}) m: errors fall by {2**-self.order:.2g} where cells are halved"

    @property
    def doubt(self) -> str:
        """Text for a note; empty if the estimate is reliable."""
        return "" if self.is_reliable else f"not reliable here: {self.text}"

    def as_data(self) -> dict[str, Any]:
        """The effect as JSON data, without the cells."""
        return {
            "edge": self.name,
            "at": list(self.point),
            "share": self.share,
            "order": self.order,
            "factor": self.factor,
            "reliable": self.is_reliable,
        }

    def remaining(self, refinement: float, degree: int, higher: int) -> float:
        """Return the ratio of errors on cells smaller by ``refinement``, of a ``higher`` degree, to the present ones.

        Errors away from the edges are presumed to fall as they do where nothing is known (`RAISED`).
        """
        smooth = refinement ** -(higher + 1.0) * RAISED ** (higher - degree)
        return float(self.least_remaining(refinement, degree, higher) + (1 - self.share) * smooth)

    def least_remaining(self, refinement: float, degree: int, higher: int) -> float:
        """Return the part of that ratio at the edges."""
        return float(self.share * (refinement * (higher / degree) ** 2) ** -self.order)


@dataclass(frozen=True)
class Estimate:
    """Estimated discretisation errors of one solution.

    Attributes:
        quantities: corrected less computed value of each quantity of interest (SI), a list of 3 for a vector. Reactions
            are left out: the corrected solution balances its forces only to first order.
        corrected: the corrected values.
        shape: largest correction of the displacement at a geometry node, in m.
        cells: ``∫ |∇δ|² dx`` of each owned cell, in scaled lengths: where the error is.
        unknowns: number of unknowns of the finer spaces.
        limit: effect of singular edges; the errors are corrected for it; ``None`` without one.
        segments: ends (n, 2, 3) m of these edges, the same on all ranks.
        finer: where the finer problem is solved, as text for a note.
        tangents: number of tangents of the finer spaces that were factorized.
        is_solved: whether the finer problem was solved: of a shell, or with a correction too large for one Newton step.
        is_too_dear: whether that was left out or given up, since it takes too long.
        without_geometry: why the error of the geometry is left out; empty if it is included.
        unreliable: names of the quantities at a point where fibres are singular.
        correction: of the rest shape; ``None`` if it is not finite.
        layer: errors of a shell's quantities that the estimate leaves out, since its layer is the same on finer cells.
    """

    quantities: Mapping[str, QuantityValue]
    corrected: Mapping[str, QuantityValue]
    shape: float
    cells: npt.NDArray[np.float64]
    unknowns: int
    limit: SingularLimit | None = None
    segments: Floats | None = None
    finer: str = DEGREE_MORE
    tangents: int = 1
    is_solved: bool = False
    is_too_dear: bool = False
    without_geometry: str = ""
    unreliable: tuple[str, ...] = ()
    correction: Correction | None = None
    layer: Mapping[str, LayerError] = field(default_factory=dict)

    @property
    def left_out(self) -> str:
        """Text for a note: which errors the estimate leaves out."""
        return f", without the error of the geometry: {self.without_geometry}" if self.without_geometry else ""

    def joined(self, other: Estimate) -> Estimate:
        """Return the estimate with the quantities of another state added."""
        quantities, corrected = {**self.quantities, **other.quantities}, {**self.corrected, **other.corrected}
        unreliable = (*self.unreliable, *other.unreliable)
        layer = {**self.layer, **other.layer}
        return replace(self, quantities=quantities, corrected=corrected, unreliable=unreliable, layer=layer)

    def of_quantities(self, quantities: Sequence[QuantityOfInterest]) -> Estimate:
        """Return the estimate with the quantities between two states; their parts in each state are left out."""
        return replace(
            self,
            quantities=with_differences(quantities, self.quantities),
            corrected=with_differences(quantities, self.corrected),
            unreliable=tuple(q.name for q in quantities if not {p.name for p in parts(q)}.isdisjoint(self.unreliable)),
        )

    def as_data(self) -> dict[str, Any]:
        """The estimate as JSON data, without the cells."""
        return {
            "geometry": "left out" if self.without_geometry else "included",
            "without_geometry": self.without_geometry,
            "quantities": dict(self.quantities),
            "corrected": dict(self.corrected),
            "shape": self.shape,
            "unknowns": self.unknowns,
            "solved": self.is_solved,
            "singular": self.limit and self.limit.as_data(),
            "unreliable": list(self.unreliable),
            "layer": {name: {"error": error.size, "cause": error.cause} for name, error in self.layer.items()},
        }
