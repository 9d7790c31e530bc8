"""Sensitivities of a run, and spreads of its shapes by errors of the given surface, as far as a job asks for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from dolfinx import fem

from hpcinv.job.job import Job
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.job.sensitivities import Parameter
from hpcinv.job.state_differences import with_differences
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.check import Line, topic

SPREAD = topic(
    "standard deviation of the shape by errors of the given surface",
    "How uncertain the shape is, since the given surface is known to some accuracy only.",
    computed="[standard deviation](../how-to/images.md#what-the-image-is-worth) of the nodes",
    thresholds="no verdict",
    costs="16 linear solves",
)


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of one solution by parameters (SI), and standard deviations to first order.

    Attributes:
        slopes: of each quantity of interest but reactions by parameter, a list of 3 for a vector.
        displacement: of ``u = x - X``, by parameter.
        nodes: of the body that was looked for, at the local geometry nodes, (n, 3), by parameter.
        shape: largest length of those over all nodes.
        deviations: of each quantity, ``None`` if no parameter has one.
        deviation: of the shape, at the node where it is largest: ``√(Σ |dX/dθ|² σ²)`` in m, ``None`` likewise.
        deviation_at: position (m) of that node in the body on whose mesh was solved.
        shapes: the same of each solve by itself, by the state whose shape it computes; the other attributes but
            ``slopes`` and ``deviations`` are then the first solve's.
        assumption: on contacts, in words; empty without any.
    """

    parameters: Sequence[Parameter]
    slopes: Mapping[str, Mapping[str, QuantityValue]]
    displacement: Mapping[str, fem.Function]
    nodes: Mapping[str, Floats]
    shape: Mapping[str, float]
    deviations: Mapping[str, QuantityValue | None]
    deviation: float | None
    deviation_at: list[float] | None
    shapes: Mapping[str, Sensitivities] = field(default_factory=dict)
    assumption: str = ""

    def as_data(self) -> dict[str, Any]:
        """Return JSON data, without the fields."""
        shapes = {name: sensitivities._shape() for name, sensitivities in self.shapes.items()}
        further = {"shapes": shapes, "assumption": self.assumption}
        return {
            "parameters": {p.key: {"value": p.value, "sd": p.deviation} | p.tied_keys for p in self.parameters},
            "quantities": {
                name: {"slopes": dict(key_slopes), "sd": self.deviations[name]}
                for name, key_slopes in self.slopes.items()
            },
            "shape": self._shape(),
        } | {name: value for name, value in further.items() if value}

    def _shape(self) -> dict[str, Any]:
        return {"largest": dict(self.shape), "sd": self.deviation, "sd_at": self.deviation_at}

    def fields(self) -> list[fem.Function]:
        """Return fields for ParaView: ``d displacement/d KEY`` and, if known, the standard deviation ``sd`` in m."""
        functions = []
        for key, function in self.displacement.items():
            named = function.copy()
            named.name = f"d displacement/d {key}"
            functions.append(named)
        if self.deviation is not None:
            functions.append(self.deviation_field("sd"))
        return functions

    def deviation_field(self, name: str) -> fem.Function:
        """Return the standard deviation of the displacement in m."""
        space = next(iter(self.displacement.values())).function_space
        scalar = fem.functionspace(space.mesh, ("Lagrange", space.ufl_element().degree))
        field = fem.Function(scalar, name=name)
        vectors = {key: function.x.array.reshape(-1, 3) for key, function in self.displacement.items()}
        field.x.array[:] = deviations_of(self.parameters, vectors)
        return field


@dataclass(frozen=True)
class Gradient:
    """Gradient of a weighted sum of results, in SI; the same on all ranks.

    Attributes:
        numbers: by the numbers under ``sensitivities``, with what changes with each.
        fields: by the fields that were asked for: (cells,), (facets,) or (nodes, …) in the order of the job's mesh.
        nodes: by the nodes of the given body, (nodes, 3); ``None`` if it was not asked for.
    """

    numbers: Mapping[str, float]
    fields: Mapping[str, Floats] = field(default_factory=dict)
    nodes: Floats | None = None


def joined_sensitivities(
    shapes: Mapping[str, Sensitivities], quantities: Iterable[QuantityOfInterest]
) -> Sensitivities | None:
    """Join what was found with each computed shape, by its name, or with the one shape of a job without states.

    Args:
        quantities: all quantities of interest, in order.
    """
    first, *more = shapes.values() or [None]
    if first is None or not more:
        return first
    slopes = {name: key_slopes for owner in shapes.values() for name, key_slopes in owner.slopes.items()}
    slopes = with_differences(quantities, slopes)
    deviations = {name: deviation_of(first.parameters, key_slopes) for name, key_slopes in slopes.items()}
    return replace(first, slopes=slopes, deviations=deviations, shapes=shapes)


class SurfaceSpread(Protocol):
    """Standard deviations that errors of the given surface cause."""

    @property
    def seconds(self) -> float:
        """Time that they took."""

    def as_data(self) -> dict[str, Any]:
        """Return JSON data, without the fields."""

    def deviations(self) -> dict[str, float]:
        """Return the largest standard deviation (m) of each shape, by the state that was solved."""

    def lines(self) -> list[Line]:
        """Return the lines of the certificate, which inform and do not judge."""

    def fields(self) -> list[list[fem.Function]]:
        """Return fields for ParaView for each shape."""


class Spreads:
    """Spread of the shapes of a run by errors of the given surface: none, where no errors are known."""

    def add(self, shape: str, equations: Equations, solution: Solution) -> None:
        """Follow the errors to the shape that a solve has found; collective."""

    def spread_of(self, quantities: Iterable[QuantityOfInterest]) -> SurfaceSpread | None:
        """Return what was found, ``None`` if no errors are known.

        Args:
            quantities: all quantities of interest, in order.
        """
        return None


def spreads_of(job: Job, body: Body) -> Spreads:
    """Return the spreads of a run; their errors are the job's, or follow from the voxels of its image.

    There are none with interfaces, which derivatives by the surface leave out.
    """
    is_known = job.mesh.surface_error is not None or body.source.voxel
    if not (job.certificate.surface and is_known) or job.all_interfaces:
        return Spreads()
    spreads: Spreads = on_demand("spreads by errors of the surface")(job, body)
    return spreads


def deviations_of(parameters: Sequence[Parameter], vectors: Mapping[str, Floats]) -> Floats:
    """Return standard deviations (n,) of the lengths of vectors (n, 3) with these derivatives."""
    squares = [(vectors[p.key] ** 2).sum(axis=1) * p.deviation**2 for p in parameters if p.deviation is not None]
    return np.asarray(np.sqrt(sum(squares)))


def deviation_of(parameters: Sequence[Parameter], key_slopes: Mapping[str, QuantityValue]) -> QuantityValue | None:
    """Return the standard deviation of a quantity with these derivatives; ``None`` if no parameter has one."""
    parts = [np.array(key_slopes[p.key]) * p.deviation for p in parameters if p.deviation is not None]
    if not parts:
        return None
    deviation: QuantityValue = np.linalg.norm(parts, axis=0).tolist()
    return deviation
