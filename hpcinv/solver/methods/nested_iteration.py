"""Nested iteration: the first solve of a job begins with the solution on coarser cells of the same generator.

A large slender body that turns far needs several factorizations on the way to its full load. On cells twice as large
each takes a tenth of the time or less, and from the solution there, at full load, one is left on the given mesh.

Source: Hackbusch, *Multi-Grid Methods and Applications*, 1985, ch. 5, doi:10.1007/978-3-662-02427-0.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.mesh_generators import resolution_of
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.region_rules import RegionRule
from hpcinv.mesh.body import Body, build_body, read_source
from hpcinv.mesh.gathered_cells import FARTHEST, GatheredCells
from hpcinv.mesh.source import MeshSource
from hpcinv.model.assembly.tangent import tangents_for
from hpcinv.model.outcome import Outcome
from hpcinv.physics.effects import Direction
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import COARSER
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.load_stepping import AdaptiveSteps
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import NESTED, UNLOADED, Guess, Start
from hpcinv.solver.newton import CoarseSolve, Solve
from hpcinv.solver.observer import IterationObserver, Observer, SolvedDirection, SolveEvent
from hpcinv.solver.workspace import collect_garbage

_MOST_CELLS = 0.5  # share of the cells above which the coarser mesh is not worth a solve
_EFFORT = 40  # factorizations on coarser cells after which a solve there is given up


def solve_nested(
    equations: Equations, direction: Direction, observer: Observer, note: Callable[[str], None]
) -> tuple[SolvedDirection, CoarseSolve | None]:
    """Solve as `solve_direction` from the unloaded body, or from the solution on coarser cells; collective.

    Without that, or if Newton's method rejects it, the path begins with the unloaded body.

    Args:
        equations: of the first solve of a job, whose mesh is at its given coordinates.
        note: called with lines of text on the coarse solve.

    Returns:
        The report, with one on the coarse solve if there was one.
    """
    if _is_interrupted(equations, observer, ()):  # what follows may take as long as the solve
        return _not_begun(equations, direction), None
    if equations.job.solver.nested_iteration != "on" and not _has_cell_sizes(equations):
        return solve_direction(equations, direction, UNLOADED, observer), None
    with tangents_for(sum(equations.body.partition.cells)):  # with the kernels of the given mesh
        guess, coarse = _coarse_solution(equations, direction, observer, note)
    collect_garbage(equations.body.mesh.comm)  # before the first factorization on the given mesh
    if _is_interrupted(equations, observer, coarse.solves):
        return _not_begun(equations, direction), coarse
    if coarse.unused:
        note(f"  not used: {coarse.unused}")
    solved = solve_direction(equations, direction, Start(guess=guess), observer)
    first = next((solve for solve in solved.solves if solve.strategy == NESTED), None)
    if first is not None and not first.outcome.accepted:
        coarse = replace(coarse, unused=first.outcome.text)
    return solved, coarse


def _not_begun(equations: Equations, direction: Direction) -> SolvedDirection:
    """Return the report of a solution that a request to stop has ended before it began; collective."""
    choice = equations.chooser.choose(equations.job.solver)
    used = Used(choice.configuration, choice.why, None)
    return SolvedDirection(direction, (), 0.0, used, stopped=True, can_restart=False, unused_options=None)


def _has_cell_sizes(equations: Equations) -> bool:
    """Return whether the generator may make larger cells: not if it has numbers of divisions alone; collective."""
    job = equations.job

    def read_on_root() -> bool:
        resolution = resolution_of(job.resolve(job.mesh.file), job.mesh.parameters)
        return bool(resolution.sizes) or not resolution.divisions

    return on_root(equations.body.mesh.comm, read_on_root)


def _coarse_solution(
    equations: Equations, direction: Direction, observer: Observer, note: Callable[[str], None]
) -> tuple[Guess | None, CoarseSolve]:
    """Return the solution on coarser cells as a guess, ``None`` if it cannot be one, and a report; collective."""
    job, timings, watching = equations.job, equations.timings, _OnCoarserCells(observer, note)
    report, coarse = CoarseSolve(), None
    try:
        with timings("coarser mesh"):
            body = coarser_body(
                equations.body, job.mesh, job.regions, resolve=job.resolve, size_factor=COARSER, most=_MOST_CELLS
            )
        coarse = Equations(_coarse_job(job), body, timings)
        report = CoarseSolve(sum(body.partition.cells), coarse.unknowns.size)
        note(f"on cells {COARSER:g} times as large, {report.cells} cells, {report.unknowns} unknowns:")
        solved = solve_direction(coarse, direction, UNLOADED, watching)
        report = replace(report, solves=tuple(watching.solves))
        if solved.stopped and not watching.is_spent:
            return None, replace(report, unused=Outcome.INTERRUPTED.text)
        if solved.load < 1.0:
            return None, replace(report, unused=f"the load was not reached there: {report.solves[-1].outcome.text}")
        sign, fault = _sign(report.solves, equations, coarse)
        if not fault:
            with timings("transfer"):
                guess = _transferred(coarse, equations, direction, sign)
            if guess is not None:
                return guess, report
            fault = "the given mesh has points that are too far outside the coarser one"
        return None, replace(report, unused=fault)
    except MeshError as error:  # such a mesh may lack regions, be inverted at a curved surface, or touch an obstacle
        return None, replace(report, unused=error.message)
    finally:
        if coarse is not None:
            coarse.destroy()


class _OnCoarserCells(IterationObserver):
    """Observer that notes each solve, and ends the path after more factorizations than it is worth (`_EFFORT`)."""

    def __init__(self, observer: Observer, note: Callable[[str], None]) -> None:
        super().__init__(observer)
        self.solves: list[Solve] = []
        self._note = note

    def solved(self, event: SolveEvent) -> None:
        self.solves.append(event.solve)
        self._note(_line(event.solve))

    @property
    def is_spent(self) -> bool:
        return sum(solve.factorizations for solve in self.solves) > _EFFORT

    def stop_asked(self) -> bool:
        return super().stop_asked() or self.is_spent


def _coarse_job(job: Job) -> Job:
    """Return the job with a solver that ends soon: the error of coarser cells is larger than its tolerance."""
    tolerance = max(job.solver.tolerance, AdaptiveSteps.path_tolerance)
    return job.model_copy(update={"solver": job.solver.model_copy(update={"tolerance": tolerance, "rescue": ()})})


def _is_interrupted(equations: Equations, observer: Observer, solves: Sequence[Solve]) -> bool:
    """Return whether a request to stop ended the last solve, or there is one now; collective."""
    here = observer.stop_asked() or any(solve.outcome is Outcome.INTERRUPTED for solve in solves)
    return bool(equations.body.mesh.comm.allreduce(here, op=MPI.LOR))


def _line(solve: Solve) -> str:
    reached = "" if solve.outcome.accepted else f" not reached: {solve.outcome.text}"
    return (
        f"  load {solve.load:.4g}{reached}: {len(solve.iterations)} iterations, {solve.factorizations} factorizations"
    )


def _sign(solves: Sequence[Solve], equations: Equations, coarse: Equations) -> tuple[int, str]:
    """Return the sign that the determinant of the tangent has on the given mesh if no limit point is passed there.

    It is 0 where it is not known, neither here nor there; and there is a reason why the solution cannot be used, or
    none. The last tangent of each solve on coarser cells has the sign of that at its solution.
    """
    accepted = [solve.signs for solve in solves if solve.outcome.accepted and solve.signs]
    if not accepted:
        may_tell = equations.chooser.choose(equations.job.solver).configuration == "direct"
        return 0, "no sign of the tangent's determinant is known there" if may_tell else ""
    unloaded = coarse.unknowns.unloaded_sign
    if any(signs[-1] != unloaded for signs in accepted) or any(s.limit_point for s in solves):
        return 0, "the path has a limit point there"
    return equations.unknowns.unloaded_sign, ""


def _transferred(coarse: Equations, equations: Equations, direction: Direction, sign: int) -> Guess | None:
    """Return the state of ``coarse`` on the finer mesh; ``None`` if that has points far outside; collective."""
    cells = GatheredCells(coarse.body.mesh, coarse.body.length_scale)
    farthest = 0.0
    pairs = zip(equations.state().fields, coarse.state().fields, coarse.unknowns.scalar_elements, strict=False)
    fields = []
    for new, old, element in pairs:
        space, values = new.function_space, cells.values(old)
        points = space.tabulate_dof_coordinates() * equations.body.length_scale
        nodal = new.x.array.reshape(len(points), space.dofmap.bs)
        for dofs, layer_cells in _layers(equations, coarse, cells, space):
            part = cells if layer_cells is None else cells.part(layer_cells)
            places = part.find(points[dofs])
            nodal[dofs] = part.evaluate(places, element, values if layer_cells is None else values[layer_cells])
            farthest = max(farthest, float(places.distance.max(initial=0.0)))
        new.x.scatter_forward()  # an extrapolated value may depend on the rank by rounding errors
        fields.append(new)
    if equations.body.mesh.comm.allreduce(farthest, op=MPI.MAX) > FARTHEST:
        return None
    equations.put_fields((fields[0], fields[1] if len(fields) > 1 else None))
    equations.impose_supports(direction)
    u, p = equations.state().fields
    equations.unload()
    return Guess(np.array(u.x.array), None if p is None else np.array(p.x.array), sign, NESTED)


def _layers(
    equations: Equations, coarse: Equations, cells: GatheredCells, space: fem.FunctionSpace
) -> Iterator[tuple[LocalIndices, npt.NDArray[np.bool_] | None]]:
    """Yield owned degrees of freedom, and the cells of ``coarse`` in the same layer: ``None`` for all; collective."""
    owned = space.dofmap.index_map.size_local
    layers, coarse_layers = equations.unknowns.layers, coarse.unknowns.layers
    if layers is None or coarse_layers is None or space is not equations.unknowns.pressure_space:
        yield np.arange(owned, dtype=np.int32), None
        return
    given = cells.gathered(coarse_layers)
    for layer in np.unique(layers):
        dofs = np.unique(space.dofmap.list[layers == layer])
        is_in_layer = given == layer
        yield dofs[dofs < owned], is_in_layer if is_in_layer.any() else None


def coarser_body(
    body: Body,
    spec: MeshSpec,
    regions: Mapping[str, RegionRule],
    *,
    resolve: Callable[[str], Path],
    size_factor: float,
    most: float,
) -> Body:
    """Return the body on cells larger by a factor, by gmsh's ``Mesh.MeshSizeFactor``; collective.

    Args:
        spec: mesh of the job, from a generator.
        resolve: makes the path in the job one that can be opened.
        most: largest number of cells, as a share of the cells of ``body``.

    Raises:
        MeshError: the same on every rank: the generator makes no such mesh, or not an admissible one.
    """
    comm, sources = body.mesh.comm, list[MeshSource]()
    cells = sum(body.partition.cells)

    def read_on_root() -> None:
        source = read_source(spec, resolve(spec.file), size_factor=size_factor)
        if len(source.cells) > most * cells:
            raise MeshError(f"its generator makes {len(source.cells):,} coarser cells instead of {cells:,}")
        sources.append(source)

    on_root(comm, read_on_root)
    coarse_source = sources[0] if sources else None
    return build_body(spec, regions, comm, resolve=resolve, degree=body.degree, replacement=coarse_source)
