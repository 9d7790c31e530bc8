"""Pairs of runs that theory makes equal, over scenes drawn from the registries of laws and effects.

A scene is a job as data in SI units and its mesh as arrays, so that both can be rotated and scaled, mirrored,
renumbered, split over ranks, written otherwise, or run after another scene with the same equations.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import hpcinv
from helpers.command_line import NO_CERTIFICATE
from helpers.mesh_cases import write_msh22
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.units import Dimension
from hpcinv.errors import SolveError
from hpcinv.job.job import Job, parse
from hpcinv.output.result import Result
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.solver.workspace import Workspace

MODULUS = 30e3  # Pa: of the body for which the examples of effects are meant
AFTER = 5  # number of the last equality, after the ones that `equalities` lists: the same case after another one
# As they are before a test registers one of its own.
LAWS = list(laws())
OF_SOLIDS = [name for name, kind in effects().items() if not kind.only_of_kind]
LOAD = 0.5  # of these examples, so that soft laws carry them
TOLERANCE = 1e-9  # of displacement and energy: Newton's, 1e-12, with what the condition of the tangent adds
SIDES = ("x0", "x1", "y0", "y1", "z0", "z1")
TETRAHEDRA = [
    [0, *(sum(1 << axis for axis in path[:i]) for i in (1, 2)), 7] for path in itertools.permutations(range(3))
]
QUADRANGLE = [0, 1, 3, 2]  # cyclic, of corners numbered by the bits of their places
WRITTEN = {
    "isochoric-neo-hookean": "mu/2*(I1_bar - 3)",
    "fung-demiray": "mu/(2*b)*(exp(b*(I1_bar - 3)) - 1)",
    "yeoh": "c1*(I1_bar - 3) + c2*(I1_bar - 3)**2 + c3*(I1_bar - 3)**3",
}
"""Energies of laws as the law 'formula' has them."""


@dataclass(frozen=True)
class Scene:
    """A job without its mesh, and the mesh: corners of cells, and facets of the six sides, as rows of ``points``."""

    data: Mapping[str, Any]
    points: np.ndarray
    cells: np.ndarray
    sides: Mapping[str, np.ndarray]
    title: str = ""

    def job(self, file: Path) -> Job:
        is_tetrahedra = self.cells.shape[1] == 4
        kind, facet = (4, 2) if is_tetrahedra else (5, 3)
        numbers = {name: i for i, name in enumerate(self.sides, 2)}
        elements = [
            *((facet, numbers[name], numbers[name], row + 1) for name, rows in self.sides.items() for row in rows),
            *((kind, 1, 1, row + 1) for row in self.cells),
        ]
        names = [*((2, n, name) for name, n in numbers.items()), (3, 1, "block")]
        write_msh22(file, self.points.tolist(), elements, names)
        return parse({**self.data, "mesh": {"file": str(file)} | self.data["mesh"]}, file.with_suffix(".yaml"))

    def changed(self, **data: Any) -> Scene:
        return dataclasses.replace(self, data={**self.data, **data})


@dataclass(frozen=True)
class Solution:
    """Nodes of the mesh, their displacements and the strain energy, the same on all ranks."""

    nodes: np.ndarray
    u: np.ndarray
    energy: float

    def difference(self, other: Solution) -> float:
        """Largest difference of displacement and energy, relative to these."""
        size = np.abs(self.nodes).max()
        away, rows = cKDTree(other.nodes).query(self.nodes)
        assert away.max() < 1e-9 * size, "the meshes differ"
        moved = float(np.abs(self.u - other.u[rows]).max() / np.abs(self.u).max())
        return max(moved, abs(self.energy / other.energy - 1))


@dataclass(frozen=True)
class Equality:
    """A change of a scene, and what it makes of a solution: ``x → matrix x``, energies times ``energy``."""

    name: str
    scene: Scene
    matrix: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))
    energy: float = 1.0


def block(rng: np.random.Generator, *, hexahedra: bool, n: int = 2) -> Scene:
    """A block of 1 m in n³ distorted bricks, of tetrahedra if they are not left whole."""
    ticks = np.arange(n + 1)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    points = grid / n
    is_inner = (grid > 0) & (grid < n)
    points = points + is_inner * rng.uniform(-0.08, 0.08, points.shape)

    def number(place: np.ndarray) -> np.ndarray:
        return np.asarray((place[..., 0] * (n + 1) + place[..., 1]) * (n + 1) + place[..., 2])

    bits = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    bricks = number(grid[(grid < n).all(axis=1)][:, None, :] + bits)
    if hexahedra:
        cells = bricks[:, [*QUADRANGLE, *(4 + np.array(QUADRANGLE))]]
    else:
        cells = oriented(points, bricks[:, TETRAHEDRA].reshape(-1, 4))
    sides = {}
    for axis, end in itertools.product(range(3), (0, 1)):
        chosen = bricks[(grid[bricks[:, 0], axis] == (n - 1 if end else 0))]
        faces = chosen[:, (bits[:, axis] == end)][:, QUADRANGLE]
        if not hexahedra:
            whole = {frozenset(f) for row in cells for f in itertools.combinations(row.tolist(), 3)}
            halves = faces[:, [[0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 0]]].reshape(-1, 3)
            faces = halves[[frozenset(row.tolist()) in whole for row in halves]]
        sides[f"{'xyz'[axis]}{end}"] = faces
    return Scene({}, points, cells, sides)


def oriented(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Tetrahedra with positive volumes."""
    volumes = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])
    return np.where(volumes[:, None] > 0, cells, cells[:, [0, 2, 1, 3]])


def drawn(rng: np.random.Generator, *, most: int = 2, degrees: tuple[int, ...] = (1, 2)) -> Scene:
    """A scene of one law and up to ``most`` effects, held on its lowest face."""
    scene = block(rng, hexahedra=bool(rng.integers(2)))
    law = str(rng.choice(LAWS))
    names = sorted(rng.choice(OF_SOLIDS, size=rng.integers(1, most + 1), replace=False).tolist())
    return scene_of(scene, law, names, str(rng.choice(["forward", "inverse"])), int(rng.choice(degrees)))


def scene_of(scene: Scene, law: str, names: list[str], direction: str, degree: int) -> Scene:
    """The scene of a law and effects on a mesh; loads are in proportion to the stiffness."""
    material = laws()[law].model_validate(laws()[law].example)
    shear = float(material.shear_modulus(next(iter(material.cases()))))
    scene_effects = [effects()[name].model_validate(effects()[name].example) for name in names]
    if all(effect.holds for effect in scene_effects):
        scene_effects.append(effects()["gravity"].model_validate(effects()["gravity"].example))
    families = dict.fromkeys([*material.families, *(f for effect in scene_effects for f in effect.families)])
    directions = [[2 / 3, -1 / 3, 2 / 3], [2 / 3, 2 / 3, -1 / 3], [-1 / 3, 2 / 3, 2 / 3]]
    stiffer = LOAD * shear / MODULUS
    title = f"{law}, {' and '.join(names)}, {direction}, degree {degree}, {len(scene.cells)} cells"
    return dataclasses.replace(
        scene,
        title=title,
        data={
            "analysis": direction,
            "material": material.model_dump(mode="json", exclude_none=True),
            "effects": [changed_quantities(e, lambda v, d: np.multiply(v, stiffer**d.mass)) for e in scene_effects],
            "fibres": {
                f: {"direction": a, "given_on": "reference"} for f, a in zip(families, directions, strict=False)
            },
            "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
            # Linear displacements have no stable pressure for nearly incompressible laws.
            "discretisation": {"displacement": degree} | ({"formulation": "displacement"} if degree == 1 else {}),
            "mesh": {"geometry_degree": degree},
            "solver": {"tolerance": 1e-12},
            "certificate": NO_CERTIFICATE,
            "output": {"unit_warnings": False},
        },
    )


def changed_quantities(ingredient: Any, change: Callable[[Any, Dimension], Any]) -> dict[str, Any]:
    """Data (SI) of a law or an effect with each quantity changed, which is given with its dimension."""
    data: dict[str, Any] = ingredient.model_dump(mode="json", exclude_none=True)
    for name, (value, dimension) in ingredient.quantities().items():
        owner, key = (
            (data["obstacle"], name.removeprefix("obstacle_")) if name.startswith("obstacle_") else (data, name)
        )
        if key in owner:
            owner[key] = np.asarray(change(value, dimension)).tolist()
    return data


def transformed(scene: Scene, matrix: np.ndarray) -> Scene:
    """The scene rotated or mirrored, and scaled in length at equal stresses, by a multiple of an orthogonal matrix."""
    scale = abs(np.linalg.det(matrix)) ** (1 / 3)
    turn = matrix / scale

    def change(value: Any, dimension: Dimension) -> Any:
        array = np.asarray(value, dtype=float)
        if array.shape in ((3,), (2, 3)):  # a vector, or two of them
            array = array @ turn.T
        elif array.shape == (3, 3):
            array = turn @ array @ turn.T
        return array * scale ** (dimension.length + dimension.mass)

    given = [effects()[data["effect"]].model_validate(data) for data in scene.data["effects"]]
    fibres = {name: f | {"direction": (turn @ f["direction"]).tolist()} for name, f in scene.data["fibres"].items()}
    points = scene.points @ matrix.T
    cells = scene.cells
    if np.linalg.det(matrix) < 0:
        cells = oriented(points, cells) if cells.shape[1] == 4 else cells[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    moved = scene.changed(effects=[changed_quantities(effect, change) for effect in given], fibres=fibres)
    return dataclasses.replace(moved, points=points, cells=cells)


def renumbered(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same mesh with nodes, cells and the vertices of each cell in another order."""
    order = rng.permutation(len(scene.points))
    place = np.argsort(order)
    corners = scene.cells.shape[1]
    if corners == 4:
        turns = [p for p in itertools.permutations(range(4)) if np.linalg.det(np.eye(4)[list(p)]) > 0]
    else:
        quarter, tip = [3, 0, 1, 2, 7, 4, 5, 6], [4, 5, 1, 0, 7, 6, 2, 3]
        turns = [tuple(range(8))]
        for turn in turns:
            turns += [
                t for t in (tuple(turn[i] for i in permutation) for permutation in (quarter, tip)) if t not in turns
            ]
    cells = np.array([row[list(turns[rng.integers(len(turns))])] for row in scene.cells])
    sides = {name: place[rng.permutation(rows)] for name, rows in scene.sides.items()}
    return dataclasses.replace(
        scene, points=scene.points[order], cells=place[cells[rng.permutation(len(cells))]], sides=sides
    )


def halved_loads(scene: Scene) -> Scene:
    """The scene with each load, foundation and obstacle as two with half the force."""
    halves = []
    for data in scene.data["effects"]:
        effect = effects()[data["effect"]].model_validate(data)
        has_force = any(d.mass for value, d in effect.quantities().values() if value is not None)
        half = changed_quantities(effect, lambda v, d: np.multiply(v, 0.5**d.mass))
        halves += [half, half] if has_force else [data]
    return scene.changed(effects=halves)


def written_otherwise(scene: Scene) -> Scene:
    """The scene with its law as a formula, or by region."""
    name = scene.data["material"]["law"]
    law = laws()[name].model_validate(scene.data["material"])
    if name in WRITTEN:
        values = {name: f"{value!r} Pa" if d.mass else value for name, (value, d) in law.quantities().items()}
        kappa = values.pop("kappa")
        formula = {"law": "formula", "energy": WRITTEN[name], "parameters": values, "kappa": kappa}
        return scene.changed(material=formula)
    return scene.changed(material={"block": scene.data["material"]})


def rotation(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))


def equalities(scene: Scene, rng: np.random.Generator) -> Iterator[Equality]:
    """Each change of a scene that theory makes equal, on one rank."""
    scale = float(rng.uniform(0.3, 3))
    matrix = scale * rotation(rng)
    yield Equality("rotated and scaled", transformed(scene, matrix), matrix, scale**3)
    mirror = np.diag([1.0, 1.0, -1.0]) @ rotation(rng)
    yield Equality("mirrored", transformed(scene, mirror), mirror)
    yield Equality("renumbered", renumbered(scene, rng))
    yield Equality("loads in halves", halved_loads(scene))
    yield Equality("law written otherwise", written_otherwise(scene))


def solved(scene: Scene, file: Path, comm: MPI.Intracomm, workspace: Workspace | None = None) -> Solution | None:
    """The solution, ``None`` if the load cannot be carried; collective."""
    job = scene.job(file) if comm.rank == 0 else None
    job = comm.bcast(job)
    try:
        return gathered(hpcinv.run(job, comm, workspace=workspace), comm)
    except SolveError:
        return None


def gathered(result: Result, comm: MPI.Intracomm) -> Solution:
    solution = result.solutions[0]
    nodes, u = (np.concatenate(comm.allgather(part)) for part in (solution.mesh_nodes, solution.u))
    return Solution(nodes, u, solution.strain_energy)


def compare(
    scene: Scene, rng: np.random.Generator, directory: Path, chosen: Collection[int] = range(6)
) -> Iterator[tuple[str, float]]:
    """Name and relative difference of the chosen equalities of a scene on this process, of `equalities` and one more.

    None if its load cannot be carried.
    """
    comm = MPI.COMM_SELF
    base = solved(scene, directory / "base.msh", comm)
    if base is None:
        return
    for number, equality in enumerate(equalities(scene, rng)):
        if number not in chosen:
            continue
        other = solved(equality.scene, directory / f"{number}.msh", comm)
        turn = equality.matrix
        expected = Solution(base.nodes @ turn.T, base.u @ turn.T, equality.energy * base.energy)
        yield equality.name, np.inf if other is None else expected.difference(other)
    if AFTER not in chosen:
        return
    with Workspace(comm) as workspace:
        softer = [{**e, "density": 0.9 * e["density"]} if "density" in e else e for e in scene.data["effects"]]
        solved(scene.changed(effects=softer), directory / "base.msh", comm, workspace)
        other = solved(scene, directory / "base.msh", comm, workspace)
    yield "after another case", np.inf if other is None else base.difference(other)
