"""Result of a run: the recovered shape, its fields, and their certificate."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any
from weakref import ReferenceType

from hpcinv.base.parallel.runtime import on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.body import whole_in_source_order
from hpcinv.mesh.source import Floats
from hpcinv.on_demand import on_demand
from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.output.surfaces.gathering import boundary_of
from hpcinv.output.surfaces.interior import Interior
from hpcinv.output.surfaces.interior_gathering import interior_of
from hpcinv.output.surfaces.picture import Colour, Picture
from hpcinv.output.vtk import write_fields
from hpcinv.results.solution import Solution
from hpcinv.results.totals import Totals
from hpcinv.solver.equations import Equations
from hpcinv.trust.accuracy import AccuracyRecord
from hpcinv.trust.certificate import Certificate, Estimate, Verdict
from hpcinv.trust.certificate.overlap import OVERLAP
from hpcinv.trust.sensitivity.sensitivities import Gradient, Sensitivities, SurfaceSpread


class Quantities(dict[str, Any]):
    """Quantities of interest by name, in SI; shown with their units.

    Attributes:
        units: SI units of those that have one.
    """

    def __init__(self, values: Mapping[str, Any], units: Mapping[str, str]) -> None:
        super().__init__(values)
        self.units = {name: unit for name, unit in units.items() if unit and name in self}

    def __reduce__(self) -> tuple[Any, ...]:
        return Quantities, (dict(self), self.units)

    def shown(self, name: str) -> str:
        """Return a quantity with its unit, as text."""
        return f"{_short(self[name])} {self.units.get(name, '')}".rstrip()

    def __repr__(self) -> str:
        return f"{{{', '.join(f'{name!r}: {self.shown(name)}' for name in self)}}}"


@dataclass(frozen=True, repr=False)
class Result:
    """Result of a run.

    Attributes:
        solutions: one for each direction or state that was solved; the first is on the mesh that the job gives.
        quantities: the job's quantities of interest by name, with their ``units``.
        errors: distances from the job's expected shape, and of a round trip from the given shape.
        estimate: estimated discretisation errors, ``None`` if not requested.
        sensitivities: derivatives by numbers of the job, ``None`` if not requested.
        surface_spread: what errors of the given surface cause, ``None`` if they are not known, or not requested.
        statistics: content of ``summary.json``.
        directory: of the run, ``None`` if nothing was written.
        accuracy: record of the search for the accuracy that the job demands, if any.
        totals: size, volume, mass and load of the meshed part.
        equations: of the first solution; kept alive by a `Workspace` only, since they hold forms and communicators.
    """

    job: Job
    body: Body
    solutions: tuple[Solution, ...]
    certificate: Certificate
    quantities: Mapping[str, Any] = field(default_factory=dict)
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    estimate: Estimate | None = None
    sensitivities: Sensitivities | None = None
    surface_spread: SurfaceSpread | None = None
    statistics: Mapping[str, Any] = field(default_factory=dict)
    directory: Path | None = None
    accuracy: AccuracyRecord | None = None
    totals: Totals | None = None
    equations: ReferenceType[Equations] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "quantities", Quantities(self.quantities, self._units()))

    def _units(self) -> dict[str, str]:
        """Units of the quantities of interest by name, which ends with the state of the body, if there are states.

        An integral is over the cells of its region, if it has some.
        """
        units: dict[str, str] = {}
        for quantity in sorted(self.job.quantities, key=lambda quantity: len(quantity.name)):  # the longest fits best
            region = self.body.regions.get(quantity.on or "")
            is_integral = quantity.reduce == "integral" and region is not None and not quantity.is_reaction
            volume = 3 if region is not None and region.cell_count else 2
            unit = quantity.unit_of_integral(volume) if is_integral else quantity.unit
            own = (name for name in self.quantities if name == quantity.name or name.startswith(f"{quantity.name}-"))
            units |= dict.fromkeys(own, unit)
        return units

    @property
    def shapes(self) -> dict[str, Floats]:
        """Coordinates of the local geometry nodes in each state, (n, 3) in m, by its name; empty without states."""
        shapes = {solution.state: solution.current_nodes for solution in self.solutions if solution.state}
        return {self.job.rest: self.solutions[0].reference_nodes} | shapes if shapes else {}

    @property
    def shape(self) -> Floats:
        """Coordinates of the local geometry nodes in the unknown body, (n, 3) in m."""
        return self.solutions[0].other_nodes

    def vjp(self, covector: Mapping[str, Any], fields: Iterable[str] = (), *, nodes: bool = False) -> Gradient:
        """Return the gradient of ``Σ weight · result``, by one solve with the transposed tangent; collective.

        It is by all numbers under ``sensitivities``, by fields, and by the nodes of the given body. If the run had a
        `Workspace` that still exists, its factors are used; else each call makes equations and factorizes the tangent.

        Args:
            covector: weights by the name of a quantity, or ``shape``, (nodes, 3) in the order of `shape_in_file`.
            fields: keys of quantities of laws, effects or fibres, such as ``material.mu``; the gradient is by a value
                in each cell, facet or node.
            nodes: whether to differentiate by the nodes of the given body, too.

        Raises:
            JobError: on all ranks: unknown names, wrong shapes, or what has no such derivative.
            SolveError: on all ranks, if the tangent at the solution is singular.
        """
        made: Gradient = on_demand("products with derivatives")(
            self._own_equations(), self.solutions[0], self.job, covector, fields, nodes=nodes
        )
        return made

    def jvp(self, direction: Mapping[str, Any]) -> dict[str, Any]:
        """Return the derivatives of the shape and of the quantities along a direction, by one solve; collective.

        Args:
            direction: rates (SI) by keys of numbers under ``sensitivities``, by keys of fields, with arrays as `vjp`
                returns, and ``nodes``, (nodes, 3).

        Returns:
            ``shape``, (nodes, 3) in m in the order of `shape_in_file`, and each quantity that has a derivative.

        Raises:
            JobError, SolveError: as `vjp`.
        """
        made: dict[str, Any] = on_demand("products with directions")(
            self._own_equations(), self.solutions[0], self.job, direction
        )
        return made

    def _own_equations(self) -> Equations:
        """Equations that a workspace has kept, or new ones."""
        kept = self.equations() if self.equations else None
        return kept or Equations(self.solutions[0].job, self.body, Timings())

    @property
    def shape_in_file(self) -> Floats:
        """Coordinates (m) of the nodes of the computed body in the order of the job's mesh, (nodes, 3); collective."""
        return whole_in_source_order(self.body, self.shape)

    @property
    def given_in_file(self) -> Floats:
        """Coordinates (m) of the nodes of the given body in the order of the job's mesh, (nodes, 3); collective."""
        return whole_in_source_order(self.body, self.body.given_nodes)

    def plot(self, colour: Colour = "displacement") -> Picture:
        """Draw the given body next to the computed one; collective.

        A notebook displays the picture, and ``picture.save(path)`` writes it as PNG.

        Args:
            colour: field on the bodies.

        Raises:
            OutputError: the run has no values of this colour.
        """
        boundary = self.boundary()

        def draw() -> Picture:
            assert boundary is not None  # on rank 0
            picture: Picture = on_demand("picture of a result")(self.statistics, boundary, colour)
            return picture

        return on_root(self.body.mesh.comm, draw)

    def boundary(self) -> Boundary | None:
        """Gather the boundary with the results on rank 0, ``None`` on others; collective."""
        overlapping = {
            line.state for line in self.certificate.lines if line.topic == OVERLAP and line.verdict is Verdict.FAIL
        }
        return boundary_of(self.body, self.solutions, self.estimate, self.job.fibres, overlapping=overlapping)

    def interior(self) -> Interior | None:
        """Gather the interior with the results on rank 0, ``None`` on others; collective."""
        labels = [where.partition(".")[2] for where in self.job.laws]
        return interior_of(self.body, self.solutions, labels)

    def write_fields(self, directory: Path) -> None:
        """Write fields for ParaView, on both bodies and in all states; collective.

        Raises:
            OutputError: they cannot be written.
        """
        first, *others = self.solutions
        solutions = [first, *(solution for solution in others if solution.state)]
        slopes = self.sensitivities
        field_lists = [slope.fields() for slope in slopes.shapes.values() or [slopes]] if slopes else []
        spreads = self.surface_spread.fields() if self.surface_spread is not None else []
        checked = [self.certificate.point_fields(solution.state) for solution in solutions]
        field_lists = [[*(a or ()), *(b or ()), *(c or ())] for a, b, c in zip_longest(field_lists, spreads, checked)]
        write_fields(directory, self.body, solutions, field_lists, families=self.job.fibres, estimate=self.estimate)

    def to_dict(self) -> dict[str, Any]:
        """Return a copy of the content of ``summary.json``, the same on every rank."""
        return copy.deepcopy(dict(self.statistics))

    def __repr__(self) -> str:
        """Return five lines of text; not collective."""
        statistics = self.statistics
        mesh, solution = statistics.get("mesh", {}), statistics.get("solutions", [{}])[0]
        lines = statistics.get("certificate", {}).get("lines", ())
        doubts = [line["name"] for line in lines if line["verdict"] not in ("pass", "not checked")]
        known = Quantities(self.quantities, self._units())
        values = ", ".join(f"{name} = {known.shown(name)}" for name in list(known)[:_SHOWN])
        more = len(self.quantities) - _SHOWN
        return "\n".join(
            (
                f"Result of '{self.job.job}': {self.job.kind}, {statistics.get('status', 'not finished')}",
                f"  mesh: {mesh.get('cells')} cells, {mesh.get('unknowns')} unknowns;"
                f" largest displacement {_short(solution.get('largest_displacement'))} m",
                f"  certificate: {self.certificate.verdict.value}" + (f" ({'; '.join(doubts)})" if doubts else ""),
                f"  quantities: {values or 'none'}" + (f", and {more} more" if more > 0 else ""),
                f"  directory: {self.directory or 'none, nothing was written'}",
            )
        )


_SHOWN = 6  # quantities in a line


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_short, value))}]"
    return "not known" if value is None else f"{value:.6g}"
