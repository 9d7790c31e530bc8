"""Directions of fibres by a rule on a body: frames from Laplace solutions across and along its wall.

With the unit vector ``e1`` along the wall (from apex to base, or from inlet to outlet), ``e2`` across it (outwards,
normal to e1) and ``e0 = e1 × e2`` around it, the fibre at the helix angle α is ``cos α e0 + sin α e1``. The sheet is
``e2``, rotated about the fibre by the sheet angle β. Both angles depend on the Laplace solution across the wall alone.

Source: Bayer, Blake, Plank & Trayanova, Ann. Biomed. Eng. 40, 2243–2254, 2012, doi:10.1007/s10439-012-0593-5. Unlike
there, angles of both ventricles change linearly through free walls too (the paper interpolates twice, so that the
change is quadratic in the left one).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans, LocalIndices
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.fibre_rules import FibreRule, TubeRule, VentricleRule
from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians
from hpcinv.mesh.source import Floats
from hpcinv.model.laplace import Laplace

_COLUMN = {"fibre": 0, "normal": 1, "sheet": 2}
_CHUNK = 10_000  # most cells at a time, to limit memory
_FLAT = 1e-7  # change of a Laplace solution over a cell that is not distinguished from none
_PARALLEL = 1e-3  # sine of the angle between the directions along and across the wall that is not either
_TURN = 0.5  # cosine of the largest turn of the wall between the middle and other points of a cell
_SHORT = 0.4  # length of interpolated unit vectors below which they nearly cancel
_EQUISPACED = basix.LatticeType.equispaced
_TIE = 1e-9  # of the largest distance: points are equally far if theirs differ by less
_DEGREE = 2  # of the directions in a cell, since a helix may turn by 120° through one layer of cells
_SIGNS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
"""Signs of the axes of right-handed frames that are the same lines."""
_MOST_UNDEFINED = 0.05  # share of the cells


@dataclass(frozen=True)
class Directions:
    """Unit vectors of one axis of a rule's frames.

    Attributes:
        function: the vectors, of degree 2 in each cell and discontinuous between cells, of length 1 at its points.
        undefined: number of cells, on all ranks, without a direction along the wall, as at an apex.
        turning: number of cells in which it would turn so far that they have the direction of their middle.
    """

    function: fem.Function
    undefined: int
    turning: int

    @property
    def text(self) -> str:
        """Note for a report; empty if there is nothing to note."""
        turning = f"the direction is constant in {self.turning} cells in which it would turn too far"
        undefined = f"{self.undefined} cells have no direction along the wall, and an arbitrary one in it"
        parts = [turning * bool(self.turning), undefined * bool(self.undefined)]
        return "; ".join(part for part in parts if part)


def rule_directions(body: Body, rule: FibreRule, where: str) -> Directions:
    """Return the directions of a rule on a body; computed once for a body; collective.

    Args:
        where: place of the family in the job, for messages.

    Raises:
        MeshError: on all ranks, if a region is missing or empty, if two touch that must not, or if the directions are
            not defined in more than a few cells.
    """
    key = _key(rule)
    if key not in body.computed:
        body.computed[key] = _computed(body, rule, where)
    directions: Directions = body.computed[key]
    return directions


def _key(rule: FibreRule) -> str:
    return f"fibres {rule.model_dump_json()}"


def notes_on_rules(body: Body) -> Iterator[str]:
    """Yield notes for a report on the directions that rules have found on a body so far."""
    for entry in body.computed.values():
        if isinstance(entry, Directions) and entry.text:
            yield f"{entry.function.name}: {entry.text}"


def _computed(body: Body, rule: FibreRule, where: str) -> Directions:
    mesh, comm = body.mesh, body.mesh.comm
    potentials = _potentials(body, rule, where)
    function = fem.Function(fem.functionspace(mesh, ("DG", _DEGREE, (3,))), name=where)
    dofs, points = function.function_space.dofmap.list, function.function_space.element.basix_element.points
    sample_points = np.vstack([points, points.mean(axis=0)])
    element = function.function_space.element.basix_element
    lattice_shapes: Floats = element.tabulate(0, basix.create_lattice(element.cell_type, 4, _EQUISPACED, True))[
        0, :, :, 0
    ]
    values = function.x.array.reshape(-1, 3)
    owned = mesh.topology.index_map(3).size_local
    counts = np.zeros(3, dtype=np.int64)
    for cells in np.array_split(np.arange(len(dofs)), 1 + len(dofs) // _CHUNK):
        frames, wall, has_normal, has_tangent = _frames(body, rule, potentials, cells, sample_points)
        axes = frames[..., _COLUMN[rule.gives]]
        others, middle = axes[:, :-1], axes[:, -1]
        defined = (has_normal & has_tangent)[:, :-1] | ~has_tangent[:, -1:]
        others = np.where(defined[..., None], others, middle[:, None])
        turn = np.where(defined, np.einsum("cpi,ci->cp", wall[:, :-1], wall[:, -1]), 1.0)
        interpolated = np.linalg.norm(np.einsum("lp,cpi->cli", lattice_shapes, others), axis=2)
        turns = (turn.min(axis=1) < _TURN) | (interpolated.min(axis=1) < _SHORT)
        values[dofs[cells]] = np.where(turns[:, None, None], middle[:, None], others)
        mine = cells < owned
        counts += [np.count_nonzero(flags[mine]) for flags in (~has_normal[:, -1], ~has_tangent[:, -1], turns)]
    lost, undefined, turning = (int(n) for n in comm.allreduce(counts, op=MPI.SUM))
    cells_of_all = mesh.topology.index_map(3).size_global
    for count, most, text in (
        (lost, 0.0, "across the wall is not defined: the Laplace solution between its surfaces is constant"),
        (undefined, _MOST_UNDEFINED * cells_of_all, "along the wall is not defined"),
    ):
        if count > most:
            raise MeshError(
                f"{body.source.path}: {where}.rule: in {count} of {cells_of_all} cells the direction {text}",
                "A rule is for a wall in one piece that lies between the surfaces that it names.",
            )
    return Directions(function, undefined, turning)


# Laplace solutions


def _potentials(body: Body, rule: FibreRule, where: str) -> Mapping[str, fem.Function]:
    """Return the Laplace solutions that a rule needs by name; each set of surfaces is solved for once."""
    laplace = list[Laplace]()  # made only if something is not known yet
    surfaces = dict[str, LocalIndices]()

    def dofs(field: str) -> LocalIndices:
        if field not in surfaces:
            if field == "apex" and "apex" not in rule.surfaces:
                surfaces[field] = _farthest(body, laplace[0], dofs("epi"), dofs("base"))
            else:
                with naming_field(f"{where}.rule.{field}"):
                    surfaces[field] = laplace[0].dofs(rule.surfaces[field])
        return surfaces[field]

    def solved(zero: tuple[str, ...], unit: str) -> fem.Function:
        names = [*zero, unit]
        key = "laplace " + " ".join(f"{name}={rule.surfaces.get(name)}" for name in (*sorted(zero), "to", unit))
        if "apex" in names:
            key += f" of {rule.surfaces['epi']} {rule.surfaces['base']}"
        if key not in body.computed:
            if not laplace:
                laplace.append(Laplace(body))
            for a, b in combinations(names, 2):
                _check_apart(body, laplace[0], rule, (a, b), (dofs(a), dofs(b)), where)
            body.computed[key] = laplace[0].solve([*((dofs(name), 0.0) for name in zero), (dofs(unit), 1.0)])
        potential: fem.Function = body.computed[key]
        return potential

    try:
        match rule:
            case VentricleRule(rv=None):
                return {"outside": solved(("endo",), "epi"), "along": solved(("apex",), "base")}
            case VentricleRule():
                return {
                    "outside": solved(("endo", "rv"), "epi"),
                    "left": solved(("epi", "rv"), "endo"),
                    "right": solved(("endo", "epi"), "rv"),
                    "along": solved(("apex",), "base"),
                }
            case TubeRule(axis=None):
                return {"outside": solved(("inner",), "outer"), "along": solved(("inlet",), "outlet")}
            case _:
                return {"outside": solved(("inner",), "outer")}
    finally:
        for solver in laplace:
            solver.destroy()


def _farthest(body: Body, laplace: Laplace, epi: LocalIndices, base: LocalIndices) -> LocalIndices:
    """Return the unknown on one region that is farthest from the middle of another, on the rank that owns it."""
    comm, owned = body.mesh.comm, laplace.space.dofmap.index_map.size_local
    x = laplace.space.tabulate_dof_coordinates()
    epi, base = (dofs[dofs < owned] for dofs in (epi, base))
    middle = comm.allreduce(x[base].sum(axis=0), op=MPI.SUM) / comm.allreduce(len(base), op=MPI.SUM)
    distances = np.linalg.norm(x[epi] - middle, axis=1)
    most = comm.allreduce(float(distances.max(initial=0.0)), op=MPI.MAX)
    nearly = epi[distances > (1 - _TIE) * most]
    points = np.vstack([np.zeros((0, 3)), *comm.allgather(x[nearly])])
    return np.asarray(nearly[np.linalg.norm(x[nearly] - _first_by_place(points, _TIE * most), axis=1) <= _TIE * most])


def _first_by_place(points: Floats, tolerance: float) -> Floats:
    """Return the point (3,) of least x, of several the one of least y, then z, whatever their order (n, 3)."""
    for axis in range(3):
        points = points[points[:, axis] <= points[:, axis].min() + tolerance]
    return np.asarray(points[0])


def _check_apart(
    body: Body,
    laplace: Laplace,
    rule: FibreRule,
    names: tuple[str, str],
    dofs: tuple[LocalIndices, LocalIndices],
    where: str,
) -> None:
    comm, owned = body.mesh.comm, laplace.space.dofmap.index_map.size_local
    both = np.intersect1d(*dofs)
    if count := comm.allreduce(int(np.count_nonzero(both < owned)), op=MPI.SUM):
        first, second = (f"'{rule.surfaces[name]}' ({name})" if name in rule.surfaces else name for name in names)
        raise MeshError(
            f"{body.source.path}: {where}.rule: {first} and {second} touch, at {count} points of the mesh",
            "They are the ends of a Laplace solution: leave a strip between them that belongs to neither.",
        )


# frames


def _frames(
    body: Body, rule: FibreRule, potentials: Mapping[str, fem.Function], cells: npt.NDArray[np.int64], points: Floats
) -> tuple[Floats, Floats, Booleans, Booleans]:
    """Return frames at reference points of cells, (cells, points, 3, 3) with axes as columns.

    Also returns the unit vectors along the wall, and where the directions across and along it are defined; elsewhere
    they are arbitrary.
    """
    kind, geometry = body.source.kind, body.mesh.geometry
    nodes = geometry.x[geometry.dofmaps[0][cells]]
    inverse = np.linalg.inv(jacobians(kind, body.degree, nodes, points))
    size = np.linalg.norm(nodes.max(axis=1) - nodes.min(axis=1), axis=1)[:, None]

    values, slopes = dict[str, Floats](), dict[str, Floats]()
    for name, function in potentials.items():
        space = function.function_space
        table: Floats = space.element.basix_element.tabulate(1, points)[..., 0]  # (1 + 3, points, shape functions)
        coefficients = function.x.array[space.dofmap.list[cells]]
        values[name] = coefficients @ table[0].T
        reference_slopes = np.einsum("cn,dpn->cpd", coefficients, table[1:])
        slopes[name] = np.einsum("cpd,cpdi->cpi", reference_slopes, inverse) * size[..., None]

    depth = np.clip(values["outside"], 0.0, 1.0)
    if isinstance(rule, TubeRule) and rule.axis is not None:
        longitudinal = np.broadcast_to(np.array(rule.axis), slopes["outside"].shape)
    else:
        longitudinal = slopes["along"]
    has_normal = np.linalg.norm(slopes["outside"], axis=2) > _FLAT
    turned = depth if rule.transmural == "linear" else (1 - (1 - 2 * depth) ** 3) / 2
    helix = np.interp(turned, (0.0, 1.0), rule.helix)
    sheet = np.interp(turned, (0.0, 1.0), rule.sheet if isinstance(rule, VentricleRule) else (0.0, 0.0))
    axes, has_tangent = _axes(longitudinal, slopes["outside"])
    frames = _turned(axes, helix, sheet)
    if "right" in potentials:
        right_share = np.clip(values["right"], 0.0, 1.0)
        total_share = right_share + np.clip(values["left"], 0.0, 1.0)
        share = np.divide(right_share, total_share, out=np.zeros_like(total_share), where=total_share > 1e-12)
        left, has_left = _axes(longitudinal, -slopes["left"])
        right, has_right = _axes(longitudinal, slopes["right"])
        sign = 1 - 2 * share  # across the wall of the right ventricle is from outside to inside
        left, right = (_turned(side_axes, sign * helix, sign * sheet) for side_axes in (left, right))
        left = np.where(has_left[..., None, None], left, np.where(has_right[..., None, None], right, frames))
        right = np.where(has_right[..., None, None], right, left)
        inner_frames = _interpolated(left, right, share)
        frames = np.where(has_tangent[..., None, None], _interpolated(inner_frames, frames, depth), inner_frames)
        frames = _aligned(frames, axes, _turned(np.broadcast_to(np.eye(3), axes.shape), helix, sheet))
        has_normal, has_tangent = has_normal | has_left | has_right, has_tangent | has_left | has_right
    return frames, axes[..., 1], has_normal, has_tangent


def _axes(longitudinal: Floats, transmural: Floats) -> tuple[Floats, Booleans]:
    """Return ``[e0 e1 e2]``, and where they are defined; elsewhere e2 is transmural, if that is, and e1 arbitrary."""
    long, size = np.linalg.norm(longitudinal, axis=-1), np.linalg.norm(transmural, axis=-1)
    e2 = _unit(transmural, size > _FLAT, np.array([0.0, 0.0, 1.0]))
    e1 = _unit(longitudinal, long > _FLAT, e2)
    rest = e2 - np.einsum("cpi,cpi->cp", e1, e2)[..., None] * e1
    sine = np.linalg.norm(rest, axis=-1)
    defined = (sine > _PARALLEL) & (size > _FLAT) & (long > _FLAT)
    other = np.eye(3)[np.abs(e2).argmin(axis=-1)]  # the axis that is farthest from e2
    other -= np.einsum("cpi,cpi->cp", other, e2)[..., None] * e2
    e1 = np.where(defined[..., None], e1, other / np.linalg.norm(other, axis=-1, keepdims=True))
    e2 = np.where(defined[..., None], rest / np.where(defined, sine, 1.0)[..., None], e2)
    return np.stack([np.cross(e1, e2), e1, e2], axis=-1), defined


def _unit(vectors: Floats, defined: Booleans, otherwise: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(defined[..., None], vectors / np.where(defined[..., None], length, 1.0), otherwise)


def _turned(axes: Floats, helix: Floats, sheet: Floats) -> Floats:
    """Return the frames fibre, normal, sheet as columns from the axes around, along and across the wall."""
    circumferential, longitudinal, transmural = (axes[..., i] for i in range(3))
    c, s = np.cos(helix)[..., None], np.sin(helix)[..., None]
    fibre, normal = c * circumferential + s * longitudinal, c * longitudinal - s * circumferential
    c, s = np.cos(sheet)[..., None], np.sin(sheet)[..., None]
    return np.stack([fibre, c * normal - s * transmural, s * normal + c * transmural], axis=-1)


def _aligned(frames: Floats, axes: Floats, turns: Floats) -> Floats:
    """Return frames with signs of their axes that are alike in each cell, apart from what helix and sheet turn.

    Args:
        axes: of the wall.
        turns: rotations (cells, points, 3, 3) from axes of the wall to frames.
    """
    straight = np.einsum("cpij,sj,cpkj->scpik", frames, _SIGNS, turns)
    middle_signs = np.einsum("scij,cij->sc", straight[:, :, -1], axes[:, -1]).argmax(axis=0)
    middle = straight[middle_signs, np.arange(len(frames)), -1]
    best = np.einsum("scpij,cij->scp", straight, middle).argmax(axis=0)
    return np.asarray(frames * _SIGNS[best][..., None, :])


def _interpolated(first: Floats, second: Floats, share: Floats) -> Floats:
    """Return frames on the shortest rotation from one to another, where axes of opposite sign are the same."""
    from scipy.spatial.transform import Rotation

    turn = np.einsum("cpki,cpkj->cpij", first, second)
    best = (np.einsum("cpii->cpi", turn) @ _SIGNS.T).argmax(axis=-1)
    turn = turn * _SIGNS[best][..., None, :]
    rotation = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec() * share.reshape(-1, 1)
    return np.asarray(first @ Rotation.from_rotvec(rotation).as_matrix().reshape(first.shape))
