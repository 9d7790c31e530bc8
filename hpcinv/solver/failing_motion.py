"""Motion of the body where load steps keep failing: the one that the load would cause to first order.

A body that is held on little of its surface, or by something soft, moves as a whole long before it is strained. Its
motion, the place of its largest displacement and the area of each support show that before all steps have failed.
"""

from collections.abc import Iterator

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.spatial_fields import ByFormula, fields_in
from hpcinv.base.quantity.units import readable
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.boundary_shells import outer_facets
from hpcinv.mesh.regions import BOUNDARY
from hpcinv.mesh.source import Floats
from hpcinv.model.rigid_motions import Frame, rounded_direction
from hpcinv.solver.bordering import Bordering
from hpcinv.solver.equilibrium import Equilibrium

_FAR = 0.1
"""Largest displacement, in lengths of the body, below which the supports are not blamed."""
_SMALL = 1e-4
"""Displacement, in lengths of the body, that a shell begins with; raised, flat thin ones fail in bending"""
_TURNS = 0.02  # squares of a motion by its rotation, relative to its translation; above it the motion is called a turn


def _moved_and_motion(job: Job, equilibrium: Equilibrium, load: float) -> tuple[Floats, Floats] | None:
    """Return places and motions (scaled) of the owned nodes of the displacement; ``None`` without a factorization."""
    system = equilibrium.system
    x = system.position()
    start = x.copy()
    if not system.is_on_path:
        start.set(0.0)
        load = 0.0
    bordering = Bordering(equilibrium, job.case_count)
    tangent = bordering.tangent(start, load, None)
    bordering.destroy()
    system.set_state(x)
    unknowns, sign = system.weak_form.unknowns, system.weak_form.kinematics.sign
    dofs = unknowns.owned_displacement_dofs
    moved = unknowns.owned_displacement_points() + sign * np.array(start.array)[dofs].reshape(-1, 3)
    x.destroy()
    start.destroy()
    if tangent is None or not np.isfinite(tangent.slope):
        return None
    return moved, (1 - load) / tangent.slope * np.array(tangent.direction.array)[dofs].reshape(-1, 3)


def failing_motion(job: Job, body: Body, equilibrium: Equilibrium, load: float, failures: int) -> list[str]:
    """Return lines on the motion that the load would cause, after some failures; collective.

    It is the one at the unloaded body, or, on a path from another state, at the present one, a solution at a load
    factor. The state is unchanged, the factors are new. Without a factorization there are no lines. Further lines name
    supports that are to be blamed, steps of a flat shell, and effects that are formulas of the unknown body.
    """
    system, comm = equilibrium.system, body.mesh.comm
    found = _moved_and_motion(job, equilibrium, load)
    if found is None:
        return []
    moved, motion = found
    lengths = np.linalg.norm(motion, axis=1)
    here = int(lengths.argmax()) if len(lengths) else -1
    mine = (float(lengths[here]), tuple(moved[here].tolist())) if here >= 0 else (-1.0, ())
    largest, point = max(comm.allgather(mine))
    place = _place(np.array(point), body.length_scale)
    text = f"to first order the load moves the body by {readable(largest * body.length_scale, 'm')}"
    lines = [f"After {failures} failed steps: {text}, most at ({place}) m"]
    share, free = _rigid_part(comm, moved, motion, body.length_scale) if largest > _FAR else (0.0, "")
    if share > job.mesh.kind.rigid_share:
        lines[0] += f"; {share:.0%} of it is rigid: it is nearly free to {free}"
        held = ", ".join(_supports(job, body)) or "none but springs"
        lines.append(f"supports: {held}. Hold a larger part of it, or add springs (elastic-foundation)")
    elif job.mesh.kind.is_slack and largest > 1.0:
        first = f"{_SMALL / largest:.0e}, minimum_step: {1e-4 * _SMALL / largest:.0e}"
        lines.append(f"A sheet hardly resists across itself before it is tense: solver: {{initial_step: {first}}}")
    if system.weak_form.kinematics.direction == "inverse" and (names := list(_unknown_position_formulas(job))):
        text = "depends on X, Y or Z, which are unknown until the end of the path"
        lines.append(f"{names[0]} {text}: write it with x, y, z, or as an array of the mesh")
    return lines


def _unknown_position_formulas(job: Job) -> Iterator[str]:
    """Yield the places of effects' formulas of the reference position."""
    for number, effect in enumerate(job.effects):
        for name, (value, _) in effect.quantities().items():
            if any(not f.formula.names.isdisjoint("XYZ") for f in fields_in(value) if isinstance(f, ByFormula)):
                yield f"effects[{number}].{name}"


def _rigid_part(comm: MPI.Intracomm, points: Floats, motion: Floats, length: float) -> tuple[float, str]:
    """Return the share of a motion (its squares) that is rigid, and what that is; collective."""
    count, total = comm.allreduce(len(points)), comm.allreduce(points.sum(axis=0))
    centre = total / count
    size = float(np.sqrt(comm.allreduce(float(((points - centre) ** 2).sum())) / count))
    frame = Frame(centre, size)
    motions = frame.motions(points)
    matrix = comm.allreduce(np.einsum("nik,nil->kl", motions, motions))
    right = comm.allreduce(np.einsum("nik,ni->k", motions, motion))
    rigid = np.linalg.lstsq(matrix, right)[0]
    squares = comm.allreduce(float((motion**2).sum()))
    translation, rotation = (float(rigid[i] @ matrix[i, i] @ rigid[i]) for i in (slice(3), slice(3, 6)))
    share = min((translation + rotation) / squares, 1.0)
    if rotation < _TURNS * translation:
        return share, f"move along {rounded_direction(rigid[:3])}"
    # The point on the axis that is closest to the centre.
    turn = rigid[3:] / size
    point = centre + np.cross(turn, rigid[:3]) / (turn @ turn)
    return share, f"turn about the axis through ({_place(point, length)}) m along {rounded_direction(turn)}"


def _place(point: Floats, length: float) -> str:
    """Return a point, in scaled lengths, as text in m."""
    return ", ".join(f"{c:.3g}" for c in (point.round(3) + 0.0) * length)


def _supports(job: Job, body: Body) -> Iterator[str]:
    """Yield what each support holds, and on what area of the boundary; collective."""
    whole = _area(body, BOUNDARY)
    for support in job.supports:
        axes, vertices = ", ".join(support.components), body.regions[support.region].vertices
        if vertices is not None:
            owned = np.count_nonzero(vertices < body.mesh.topology.index_map(0).size_local)
            count = body.mesh.comm.allreduce(int(owned))
            yield f"'{support.region}' holds {axes} at {count} {'vertex' if count == 1 else 'vertices'}"
            continue
        area = _area(body, support.region)
        size = f"{area * body.length_scale**2:.3g} m² ({area / whole:.2%} of the surface)"
        yield f"'{support.region}' holds {axes} on {size}"


def _area(body: Body, region: str) -> float:
    """Return the area of a region of the boundary (scaled); collective."""
    facets = body.held_facets(region)
    facets = facets[facets < body.mesh.topology.index_map(2).size_local]
    _, areas = outer_facets(body.mesh, facets)
    return float(body.mesh.comm.allreduce(float(np.linalg.norm(areas, axis=1).sum())))
