"""``vjp`` and ``jvp`` of a result: central differences of whole runs, and the derivatives under ``sensitivities``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.moved_meshes import write_block
from helpers.sheets import flat, save_sheet
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference
from hpcinv.errors import JobError
from hpcinv.mesh.body import whole_in_source_order
from hpcinv.model.assembly.system import System
from hpcinv.output.result import Result
from hpcinv.solver.linear_solver import LinearSolver
from hpcinv.solver.workspace import Workspace

STEP = 1e-4  # relative; differences of second order have an error of 1e-8, and of 1e-5 on one of the bodies
WITHIN = 1e-6
PLACES = [("point", "displacement", 7), ("place", "X*z/(1 m) + uy", 9), ("there", "sxx - p", 11)]
"""name, formula, and number of the cell that has the point in its middle"""
QUANTITIES: list[dict[str, Any]] = [
    {"name": "height", "of": "Z + x*ux/(1 m)", "on": "z1", "reduce": "mean"},
    {"name": "size", "of": "norm(X, y, z)", "on": "x1", "reduce": "rms"},
    {"name": "energy", "of": "energy", "on": "block", "reduce": "integral", "over": "reference"},
    {"name": "stress", "of": "von_mises", "on": "block", "reduce": "rms"},
    {"name": "area", "of": "nx*J", "on": "z1", "reduce": "mean", "over": "current"},
]
WEIGHTS: dict[str, Any] = {
    "height": 2.0,
    "size": -1.3,
    "energy": 3e-4,
    "stress": 2e-4,
    "there": 1e-4,
    "place": 1.1,
    "area": 0.6,
}
NUMBERS = {
    "effects[0].density": 90.0,
    "effects[1].pressure": 150.0,
    "supports[0].constants.k": 0.02,
}


class Case:
    """A block with moduli by cell, fibres by node, and numbers; each may be replaced."""

    def __init__(
        self,
        comm: MPI.Intracomm,
        directory: Path,
        analysis: str,
        formulation: str = "displacement",
        *,
        fibres: bool = True,
        **mesh: Any,
    ) -> None:
        self.comm, self.directory, self.analysis, self._mesh = comm, directory, analysis, mesh
        self.formulation, self.fibres = formulation, fibres
        points, middles = write_block(comm, directory / "block.vtu", **mesh)
        self.nodes, self.cells = len(points), len(middles)
        random = np.random.default_rng(4)
        self.numbers = NUMBERS | ({} if fibres else {"material.lam": 4e3})
        self.values: dict[str, Any] = {
            "material.lam": 0.0,
            **self.numbers,
            "material.mu": 2e3 * random.uniform(0.7, 1.4, self.cells),
            "fibres.f.direction": np.array([1, 0.3, 0.2]) + 0.2 * random.normal(size=(self.nodes, 3)),
            "nodes": np.zeros((self.nodes, 3)),
        }
        self.directions = {
            key: random.normal(size=np.shape(value)) * np.abs(value).mean() if np.ndim(value) else abs(float(value))
            for key, value in self.values.items()
        } | {"nodes": 0.05 * random.normal(size=(self.nodes, 3))}
        self.covector = WEIGHTS | {"shape": random.normal(size=(self.nodes, 3)), "point": [1.0, -2.0, 3.0]}

    def run(self, workspace: Workspace | None = None, numbers: Iterable[str] = (), **replaced: Any) -> Result:
        values = self.values | replaced
        arrays = {"mu": values["material.mu"], "a": values["fibres.f.direction"]}
        file = self.directory / "block.vtu"
        _, middles = write_block(self.comm, file, moved=values["nodes"], arrays=arrays, **self._mesh)
        points = [{"name": name, "of": of, "at": middles[cell].tolist()} for name, of, cell in PLACES]
        law: dict[str, Any] = {"law": "neo-hookean", "mu": {"data": "mu"}, "lam": values["material.lam"]}
        if self.fibres:
            law |= {"law": "holzapfel-gasser-ogden", "kappa": 9e3, "k1": 800.0, "k2": 0.8}
            law |= {"dispersion": 0.1, "fibres": ["f"]}
            del law["lam"]
        posed = job(
            analysis=self.analysis,
            mesh={"file": str(file)},
            material=law,
            fibres={"f": {"data": "a", "given_on": "current"}} if self.fibres else {},
            effects=[
                {"effect": "gravity", "acceleration": [2, 0, -9.81], "density": values["effects[0].density"]},
                {"effect": "pressure", "region": "x1", "pressure": values["effects[1].pressure"]},
            ],
            supports=[
                {
                    "region": "x0",
                    "displacement": ["k*y*z/(1 m)", 0, "k*y"],
                    "constants": {"k": values["supports[0].constants.k"]},
                }
            ],
            discretisation={"displacement": self._mesh.get("degree", 1), "formulation": self.formulation},
            solver={"tolerance": 1e-13},
            quantities=QUANTITIES + points,
            sensitivities=list(numbers),
        )
        return hpcinv.run(posed, self.comm, workspace=workspace, progress=False)

    def total(self, result: Result) -> float:
        """Weighted sum of all results."""
        shape = float((self.covector["shape"] * result.shape_in_file).sum())
        return shape + sum(float(np.dot(w, result.quantities[n])) for n, w in self.covector.items() if n != "shape")

    def difference(self, keys: list[str], order: int) -> float:
        """Central difference of second or fourth order of the sum along the directions of some keys together."""
        points = POINTS if order == 4 else (-1, 1)
        totals = []
        for k in points:
            moved = {key: self.values[key] + k * STEP * self.directions[key] for key in keys}
            totals.append(self.total(self.run(**moved)))
        return float(central_difference(totals, STEP) if order == 4 else (totals[1] - totals[0]) / (2 * STEP))


def check(case: Case, keys: list[str], order: int = 2) -> None:
    """Compare both products with a difference along all directions, and with each other."""
    with Workspace(case.comm) as workspace:
        result = case.run(workspace, case.numbers)
        fields = [key for key in keys if key not in case.numbers and key != "nodes"]
        gradient = result.vjp(case.covector, [*fields, "effects[1].pressure"], nodes=True)
        assert gradient.nodes is not None
        assert gradient.nodes.shape == (case.nodes, 3)
        found = {key: gradient.numbers[key] * case.directions[key] for key in case.numbers}
        found |= {key: float((gradient.fields[key] * case.directions[key]).sum()) for key in fields}
        found["nodes"] = float((gradient.nodes * case.directions["nodes"]).sum())
        by_facet = gradient.fields["effects[1].pressure"]
        assert by_facet.sum() == pytest.approx(gradient.numbers["effects[1].pressure"], rel=1e-9)
        chosen = {key: case.directions[key] for key in keys} | {
            "effects[1].pressure": np.arange(1.0, len(by_facet) + 1)
        }
        along = result.jvp(chosen)
        total = sum(float(np.sum(np.multiply(w, along[name]))) for name, w in case.covector.items())
        expected = sum(found[key] for key in keys if key != "effects[1].pressure")
        assert total == pytest.approx(expected + float(by_facet @ chosen["effects[1].pressure"]), rel=1e-8)
    difference = case.difference(keys, order)
    print(f"{case.analysis}: {', '.join(f'{key} {found[key]:.10g}' for key in keys)}; differences {difference:.10g}")
    parts = [abs(found[key]) for key in keys]
    assert min(parts) > 100 * WITHIN * max(parts)  # an error of a hundredth in each shows in the sum
    assert sum(found[key] for key in keys) == pytest.approx(difference, abs=WITHIN * max(parts))


@pytest.mark.parallel([1, 3, 2])
def test_products_of_an_inverse_solution_are_differences_of_runs(comm: MPI.Intracomm, run_directory: Path) -> None:
    case = Case(comm, run_directory, "inverse", fibres=False)
    check(case, ["material.mu", "nodes"] if comm.size > 1 else ["material.lam", "supports[0].constants.k"])


@pytest.mark.release
@pytest.mark.parallel([2])
@pytest.mark.parametrize(
    ("analysis", "keys"),
    [
        ("inverse", ["material.mu", "effects[0].density"]),
        ("forward", ["fibres.f.direction", "effects[1].pressure"]),
        ("round_trip", ["material.mu", "supports[0].constants.k"]),
    ],
    ids=["inverse", "forward", "round_trip"],
)
@pytest.mark.parametrize("mesh", [{"degree": 2}, {"hexahedra": True}, {"degree": 2, "hexahedra": True}])
def test_products_on_other_cells_and_in_other_directions(
    comm: MPI.Intracomm, run_directory: Path, analysis: str, keys: list[str], mesh: dict[str, Any]
) -> None:
    check(Case(comm, run_directory, analysis, **mesh), ["nodes", *keys], order=4)


def small(**data: Any) -> Any:
    common: dict[str, Any] = {
        "analysis": "inverse",
        "mesh": box((1, 1, 1)),
        "material": {"law": "neo-hookean", "mu": 2e4, "poisson": 0.3},
        "effects": [{"effect": "pressure", "region": "x1", "pressure": 500}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "discretisation": {"displacement": 1},
        "sensitivities": ["material.mu"],
        "quantities": [
            {"name": "tip", "of": "X", "on": "x1", "reduce": "mean"},
            {"name": "force", "of": "reaction", "on": "x0"},
            {"name": "most", "of": "sxx", "on": "block", "reduce": "max"},
        ],
    }
    return job(**(common | data))


@pytest.fixture(scope="module")
def small_result() -> Result:
    return hpcinv.run(small(), MPI.COMM_WORLD, progress=False)


@pytest.mark.parametrize(
    ("covector", "fields", "message"),
    [
        ({"tipp": 1.0}, [], r"vjp: unknown result 'tipp'\. Did you mean 'tip'\?"),
        ({"shape": np.zeros((7, 3))}, [], r"vjp: the covector of 'shape' must have the shape \(8, 3\), not \(7, 3\)"),
        ({"tip": [1.0, 2.0]}, [], r"vjp: the covector of 'tip' must have the shape \(\), not \(2,\)"),
        ({"tip": "much"}, [], "vjp: the covector of 'tip' is not an array of numbers"),
        ({"tip": np.nan}, [], "vjp: the covector of 'tip' has values that are not finite"),
        ({"force": [1.0, 0.0, 0.0]}, [], "vjp: 'force' is a reaction or a result of contact, which has no derivative"),
        ({"most": 1.0}, [], "vjp: 'most' is a largest value over quadrature points; take 'mean', 'rms' or 'integral'"),
        ({"tip": 1.0}, ["material.nu"], r"vjp: fields: material\.nu is not a number .*"),
        ({"tip": 1.0}, ["nodes"], r"vjp: fields: nodes is not a number .*"),
    ],
)
def test_wrong_covectors_are_one_message(covector: Any, fields: list[str], message: str, small_result: Result) -> None:
    with pytest.raises(JobError, match=message):
        small_result.vjp(covector, fields)


def test_wrong_directions_are_one_message(small_result: Result) -> None:
    for direction, message in (
        ({"material.mu": np.ones(3)}, r"jvp: the direction of 'material\.mu' must have the shape \(6,\), not \(3,\)"),
        ({"nodes": 1.0}, r"jvp: the direction of 'nodes' must have the shape \(8, 3\), not \(\)"),
        ({"material.lambda": 1.0}, r"jvp: fields: material\.lambda is not a number"),
    ):
        with pytest.raises(JobError, match=message):
            small_result.jvp(direction)


def test_products_with_sensitivities_of_a_run(comm: MPI.Intracomm) -> None:
    """Without a workspace, and for a number that others change with."""
    scaled = {"material.mu": {"scale": ["effects[0].pressure"]}}
    weight = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 100}
    effects = [{"effect": "pressure", "region": "x1", "pressure": 500}, weight]
    result = hpcinv.run(small(sensitivities=scaled, effects=effects), comm, progress=False)
    assert result.sensitivities is not None
    weights = np.random.default_rng(3).normal(size=(8, 3))
    nodes = whole_in_source_order(result.body, result.sensitivities.nodes["material.mu"])
    expected = (weights * nodes).sum() + result.sensitivities.slopes["tip"]["material.mu"]
    gradient = result.vjp({"shape": weights, "tip": 1.0})
    assert gradient.numbers == pytest.approx({"material.mu": expected}, rel=1e-9)
    along = result.jvp({"material.mu": 2.0})
    np.testing.assert_allclose(along["shape"], 2 * nodes, rtol=0, atol=1e-9 * np.abs(nodes).max())
    assert set(along) == {"shape", "tip"}


@pytest.mark.parallel([2, 1])
def test_numbers_of_a_shell(comm: MPI.Intracomm, run_directory: Path) -> None:
    """The thickness, too, which moves nodes: as under ``sensitivities``, which differences of runs confirm."""
    path = run_directory / "sheet.msh"
    if comm.rank == 0:
        save_sheet(path, 2, 1, flat(1, 0.5))
    comm.Barrier()
    keys = ["material.mu", "effects[0].pressure", "mesh.shell.thickness"]
    sheet = job(
        analysis="inverse",
        mesh={"file": str(path), "shell": {"thickness": 0.1}},
        material={"law": "neo-hookean", "mu": 3e4, "lam": 1.2e5},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 30}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        quantities=[{"name": "tip", "of": "displacement", "at": [1, 0.25, 0]}],
        sensitivities=keys,
        certificate="off",
    )
    result = hpcinv.run(sheet, comm, progress=False)
    assert result.sensitivities is not None
    weights = np.array([0.3, -0.2, 1.0])
    slopes = {key: float(weights @ result.sensitivities.slopes["tip"][key]) for key in keys}
    assert result.vjp({"tip": weights}).numbers == pytest.approx(slopes, rel=1e-7)


def test_a_result_has_its_own_numbers_in_a_workspace_of_later_runs(comm: MPI.Intracomm) -> None:
    with Workspace(comm) as workspace:
        first = hpcinv.run(small(), comm, workspace=workspace, progress=False)
        expected = first.vjp({"tip": 1.0}, ["material.mu"], nodes=True)
        stiffer = small(material={"law": "neo-hookean", "mu": 4e4, "poisson": 0.3})
        hpcinv.run(stiffer, comm, workspace=workspace, progress=False)
        again = first.vjp({"tip": 1.0}, ["material.mu"], nodes=True)
    alone = first.vjp({"tip": 1.0}, ["material.mu"], nodes=True)
    for found in (again, alone):
        for given, value in (
            (expected.fields["material.mu"], found.fields["material.mu"]),
            (expected.nodes, found.nodes),
        ):
            np.testing.assert_allclose(value, given, rtol=0, atol=1e-10 * np.abs(given).max())


@pytest.mark.everyday("mixed")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
def test_transposed_multigrid_gives_the_products_of_factors(comm: MPI.Intracomm, formulation: str) -> None:
    found = []
    for linear in ("direct", "iterative"):
        posed = small(
            mesh=box((3, 1, 1), hexahedra=False),
            material={"law": "neo-hookean", "mu": 2e4, "lam": 4e5},
            discretisation={"displacement": 2, "formulation": formulation},
            solver={"linear": linear, "tolerance": 1e-12},
        )
        with Workspace(comm) as workspace:
            result = hpcinv.run(posed, comm, workspace=workspace, progress=False)
            found.append(result.vjp({"tip": 1.0}, ["material.mu"], nodes=True))
    expected, gradient = found
    pairs = [(gradient.fields["material.mu"], expected.fields["material.mu"]), (gradient.nodes, expected.nodes)]
    for value, given in pairs:
        assert value is not None
        assert given is not None
        np.testing.assert_allclose(value, given, rtol=0, atol=1e-8 * np.abs(given).max())


@pytest.mark.parametrize("linear", ["direct", "iterative"])
def test_products_at_one_solution_assemble_its_tangent_once(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, linear: str
) -> None:
    """Later runs in the workspace, and a result without one, have tangents of their own; set-ups of runs serve."""
    made: list[System] = []
    set_up: list[LinearSolver] = []
    assemble, prepare = System.tangent, LinearSolver._set_up

    def prepared(solver: LinearSolver) -> None:
        set_up.append(solver)
        prepare(solver)

    def counted(system: System, *terms: Any) -> None:
        made.append(system)
        assemble(system, *terms)

    monkeypatch.setattr(System, "tangent", counted)
    monkeypatch.setattr(LinearSolver, "_set_up", prepared)
    with Workspace(comm) as workspace:
        plain = {"solver": {"linear": linear}, "certificate": "off"}
        first = hpcinv.run(small(**plain), comm, workspace=workspace, progress=False)
        for count, again in ((1, False), (0, False), (1, True), (0, False)):
            if again:
                stiffer = small(**plain, material={"law": "neo-hookean", "mu": 4e4, "poisson": 0.3})
                hpcinv.run(stiffer, comm, workspace=workspace, progress=False)
            made.clear()
            set_up.clear()
            gradient = first.vjp({"tip": 1.0}, nodes=True)
            along = first.jvp({"material.mu": 1.0})
            assert len(made) == count
            assert not set_up
            assert along["tip"] == pytest.approx(gradient.numbers["material.mu"], rel=1e-8)
