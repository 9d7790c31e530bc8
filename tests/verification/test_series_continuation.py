"""Continuation by power series: the solutions of load steps, in fewer factorizations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.paths import OCTANT, SPHERE, cube, tried
from helpers.verification import Solved, box, job
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.model.assembly import taylor_residual
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.solver.linear import selection
from hpcinv.solver.linear.cost_model import Forecast
from hpcinv.solver.methods import fallbacks
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SILENT
from hpcinv.solver.series_continuation import SeriesSteps
from hpcinv.trust.certificate import Verdict
from hpcinv.trust.certificate.limit_points import LIMIT_POINTS

HELD = {"region": "x0", "fix": ["x", "y", "z"]}
GRAVITY = {"effect": "gravity", "acceleration": [0, -4, 0], "density": 1000, "density_in": "reference"}
BEAM: dict[str, Any] = {
    "mesh": box((6, 1, 1), hexahedra=True, lx="8 cm", ly="1 cm", lz="1 cm"),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "30 kPa"},
    "effects": [GRAVITY],
    "supports": [HELD],
}
PATHS: dict[str, dict[str, Any]] = {
    "forward": {"analysis": "forward"},
    "inverse": {"analysis": "inverse"},
    "prescribed motion": {
        "analysis": "forward",
        "supports": [HELD, {"region": "x1", "displacement": ["1 cm", "-2 cm", None]}],
    },
    "load cases": {
        "analysis": "forward",
        "load_cases": ["weight", "pressure"],
        "effects": [
            GRAVITY | {"case": "weight"},
            {"effect": "pressure", "region": "y1", "pressure": "20 Pa", "case": "pressure"},
        ],
    },
}


def solved(comm: MPI.Intracomm, continuation: str, **data: Any) -> Solved:
    return Solved(job(**(BEAM | data), solver={"continuation": continuation, "linear": "direct"}), comm)


def factorizations(solution: Solved) -> int:
    return sum(solve.factorizations for solve in solution.solves)


@pytest.mark.everyday("prescribed motion")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("name", PATHS)
def test_series_and_load_steps_end_in_the_same_state(name: str, comm: MPI.Intracomm) -> None:
    series, steps = (solved(comm, continuation, **PATHS[name]) for continuation in ("series", "steps"))
    assert {solve.strategy for solve in series.solves} == {"power series"}
    assert all(solve.outcome.accepted for solve in series.solves)
    states = [result.model.unknowns.geometry_values(result.model.unknowns.displacement()) for result in (series, steps)]
    error = np.abs(states[0] - states[1]).max() / np.abs(states[1]).max()
    counts = factorizations(series), factorizations(steps)
    print(f"{name}: difference {error:.1e}, factorizations {counts[0]} and {counts[1]}")
    assert error < 1e-10
    assert counts[0] <= counts[1]
    assert counts[0] <= 2 * len(PATHS[name].get("load_cases", ["all"]))


def test_factors_of_an_earlier_tangent_serve_where_new_ones_take_longer(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"mesh": box((4, 1, 1), hexahedra=True, lx="4 cm", ly="1 cm", lz="1 cm"), "analysis": "forward"}
    runs = []
    for seconds in (1e-30, 1e30):  # of a solve by factors
        monkeypatch.setattr(Forecast, "back_substitution", seconds)
        runs.append(solved(comm, "series", **short, effects=[GRAVITY | {"acceleration": [0, -200, 0]}]))
    kept, renewed = (factorizations(run) for run in runs)
    print(f"factorizations {kept} and {renewed}, {len(runs[0].solves)} ranges")
    assert renewed == kept + len(runs[0].solves) - 1 > kept
    states = [run.model.unknowns.geometry_values(run.model.unknowns.displacement()) for run in runs]
    assert np.abs(states[0] - states[1]).max() < 1e-9 * np.abs(states[1]).max()


BENT: dict[str, Any] = {
    "mesh": box((4, 1, 1), lx=4.0, hexahedra=True),
    "material": {"law": "neo-hookean", "mu": 1e3, "lam": 1e5},
    "effects": [{"effect": "gravity", "acceleration": [0, -0.5, 0], "density": 100}],
    "discretisation": {"formulation": "displacement"},
}


def test_auto_takes_a_series_where_steps_would_fail_or_take_several_tangents(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    auto, steps = (solved(comm, continuation, analysis="forward", **BENT) for continuation in ("auto", "steps"))
    (solve,) = auto.solves
    assert (solve.strategy, solve.factorizations) == ("power series", 2)
    assert factorizations(steps) > 2
    states = [result.model.unknowns.geometry_values(result.model.unknowns.displacement()) for result in (auto, steps)]
    assert np.abs(states[0] - states[1]).max() < 1e-9 * np.abs(states[1]).max()
    monkeypatch.setattr(fallbacks, "_FARTHEST_COMPACT", 2.0)  # the first correction is 1.04 of the prediction
    for unknowns, compact, strategy in (
        (10_000, 0.0, "load steps"),
        (0, 0.0, "power series"),
        (0, math.inf, "load steps"),
    ):
        monkeypatch.setattr(fallbacks, "_LARGE", unknowns)
        monkeypatch.setattr(selection, "COMPACT", compact)
        assert {solve.strategy for solve in solved(comm, "auto", **PATHS["inverse"]).solves} == {strategy}


@pytest.mark.everyday("forward")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
def test_limit_load_is_located(analysis: str, comm: MPI.Intracomm) -> None:
    """A cube under 1.2 times the tension that it carries from all sides; there is a closed form."""
    share = 1.2
    solves = tried(cube(share, analysis, strategy="adaptive", continuation="series", linear="direct"), comm)
    *_, extremum, last = solves
    print(f"{analysis}: {len(solves)} solves, error {extremum.load * share - 1:.1e}")
    assert last.outcome is Outcome.LIMIT_POINT
    assert extremum.limit_point
    assert extremum.load * share == pytest.approx(1.0, rel=1e-6)


def test_steps_do_not_repeat_a_series_that_ends(comm: MPI.Intracomm) -> None:
    """A sphere under more pressure than it can carry; without a series, it takes 32 factorizations."""
    sphere = job(
        mesh=SPHERE,
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 2.5}],
        supports=OCTANT,
        solver={"linear": "direct"},
    )
    *solves, reached, last = tried(sphere, comm)
    count = sum(solve.factorizations for solve in (*solves, reached, last))
    print(f"load factor {reached.load:.6f}, {count} factorizations")
    assert last.outcome is Outcome.VOLUME_CHANGED
    assert reached.outcome.accepted
    assert reached.load == max(solve.load for solve in solves if solve.outcome.accepted)
    assert {solve.strategy for solve in solves} == {"power series", "load steps"}
    assert count < 25


ARCH = """
def build(gmsh):
    geo, share = gmsh.model.geo, [i / 40 for i in range(41)]
    curve = geo.addSpline([geo.addPoint(x, 0.24 * x * (1 - x), 0) for x in share])
    geo.mesh.setTransfiniteCurve(curve, 9)
    (section,) = [tag for dim, tag in geo.extrude([(1, curve)], 0, 0.02, 0, [1], recombine=True) if dim == 2]
    (arch,) = [tag for dim, tag in geo.extrude([(2, section)], 0, 0, 0.04, [1], recombine=True) if dim == 3]
    geo.synchronize()
    gmsh.model.addPhysicalGroup(3, [arch], name="arch")
    for _, face in gmsh.model.getEntities(2):
        low, _, _, high, *_ = gmsh.model.getBoundingBox(2, face)
        if high - low < 1e-3:
            gmsh.model.addPhysicalGroup(2, [face], name=f"x{round(high)}")
    gmsh.model.mesh.generate(3)
"""


def arch_path(place: Path, multiple: float, solver: dict[str, str], comm: MPI.Intracomm) -> list[Solve]:
    """Solves of an arch under a multiple of its weight."""
    return tried(arch(place, multiple, solver), comm)


def arch(place: Path, multiple: float, solver: dict[str, str], **data: Any) -> Job:
    (place / "arch.py").write_text(ARCH)
    return job(
        analysis="forward",
        mesh={"file": str(place / "arch.py")},
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "30 kPa"},
        effects=[GRAVITY | {"acceleration": [0, -0.05 * multiple, 0]}],
        supports=[HELD, HELD | {"region": "x1"}],
        solver=solver | {"linear": "direct"},
        **data,
    )


@pytest.mark.everyday("0.98-Verdict.PASS")
@pytest.mark.parametrize(("share", "verdict"), [(0.98, Verdict.PASS), (2.5, Verdict.UNDECIDED)])
def test_jump_in_the_first_load_step_is_seen(
    share: float, verdict: Verdict, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """Snap-through: the tangent has the same sign on both sides, and at each state that Newton's method passes.

    The limit load is 0.628 of the weight.
    """
    certificate = {"level": "quick", "estimate": False, "overlap": False}
    steps = arch(run_directory, 0.6281884 * share, {"continuation": "steps"}, certificate=certificate)
    result = hpcinv.run(steps, comm)
    (solve,) = result.solutions[0].solves
    assert solve.outcome.accepted
    assert set(solve.signs) == {1}
    (line,) = (line for line in result.certificate.lines if line.topic == LIMIT_POINTS)
    assert line.verdict is verdict
    if share > 1:
        last = arch_path(run_directory, 0.6281884 * share, {"continuation": "auto"}, comm)[-1]
        assert last.outcome is Outcome.LIMIT_POINT
        assert last.load == pytest.approx(1 / share, rel=1e-5)


def test_limit_load_of_a_shallow_arch(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """Its limit load is the one of arc-length continuation, which has none of the code of series."""
    series, arcs = (
        arch_path(tmp_path, 1.0, solver, comm) for solver in ({"continuation": "series"}, {"strategy": "arc-length"})
    )
    assert series[-1].outcome is arcs[-1].outcome is Outcome.LIMIT_POINT
    assert series[-1].load == pytest.approx(arcs[-1].load, rel=1e-6)
    counts = [sum(solve.factorizations for solve in solves) for solves in (series, arcs)]
    print(f"limit load {series[-1].load}, factorizations {counts}")
    assert counts[0] < counts[1] / 2


@pytest.mark.release
def test_steps_do_not_jump_past_a_limit_point(comm: MPI.Intracomm) -> None:
    """A shallow shell under 20 times the load: solutions of other paths are rejected (limit load 0.74 before)."""
    roof = Path(__file__).parents[2] / "benchmarks" / "published" / "sze" / "roof.yaml"
    clamped = [{"region": "x0", "fix": ["x"]}, HELD | {"region": "x1"}, {"region": "y0", "fix": ["y"]}]
    loads = []
    for multiple, continuation in ((1.0, "series"), (20.0, "steps")):
        changes: dict[str, Any] = {
            "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "30 kPa"},
            "effects": [GRAVITY | {"acceleration": [0, 0, 0.3 * multiple], "density_in": "reference"}],
            "mesh.parameters": {"radius": "1 m", "angle": 0.45, "width": "4 cm", "ny": 1},
            "mesh.shell": {"thickness": "2 cm"},
            "supports": clamped,
            "regions": {},
            "let": {},
            "quantities": [],
            "solver": {"continuation": continuation, "linear": "direct"},
        }
        solves = tried(hpcinv.load(roof).with_(changes), comm)
        assert solves[-1].outcome is Outcome.LIMIT_POINT
        loads.append(multiple * solves[-1].load)
    assert Outcome.ANOTHER_PATH in {solve.outcome for solve in solves}
    assert loads[1] == pytest.approx(loads[0], rel=1e-6)


def test_without_a_series_load_steps_are_taken(comm: MPI.Intracomm) -> None:
    floor = {"shape": "plane", "point": [0, "-1 cm", 0], "normal": [0, 1, 0]}
    contact = {"effect": "contact", "region": "y0", "obstacle": floor, "stiffness": "1 MPa/m"}
    solution = solved(comm, "series", analysis="forward", effects=[GRAVITY, contact])
    assert solution.solves[-1].outcome is Outcome.CONVERGED
    assert "power series" not in {solve.strategy for solve in solution.solves}


def test_path_that_hardly_moves_is_straight(comm: MPI.Intracomm) -> None:
    """Squares of its displacements are zero as numbers."""
    solution = solved(comm, "series", analysis="forward", effects=[GRAVITY | {"acceleration": [0, -1e-300, 0]}])
    (solve,) = solution.solves
    assert solve.outcome.accepted
    assert solve.strategy == "power series"


SLENDERNESS = 50
EULER = np.pi**2 / 12 / SLENDERNESS**2  # strain


def column(comm: MPI.Intracomm, multiple: float, branch: str = "first") -> Solved:
    """A column between sliding plates, shortened by a multiple of Euler's strain; it may bend towards y."""
    return Solved(
        job(
            analysis="forward",
            mesh=box((8, 1, 1), hexahedra=True, lx="1 m", ly="2 cm", lz="2 cm"),
            discretisation={"displacement": 3, "formulation": "displacement"},
            material={"law": "st-venant-kirchhoff", "young": "1 MPa", "poisson": 0},
            supports=[
                {"region": "x0", "fix": ["x", "y"]},
                {"region": "x1", "displacement": [f"{-multiple * EULER} m", None, None]},
                {"region": "z0", "fix": ["z"]},
                {"region": "z1", "fix": ["z"]},
            ],
            effects=[GRAVITY | {"acceleration": [0, 1e-13, 0]}],  # as large as rounding errors, which may vanish
            solver={"continuation": "series", "branch": branch, "linear": "direct"},
        ),
        comm,
    )


@pytest.mark.parallel([1, 2])
def test_bifurcation_is_eulers_load_with_its_mode(comm: MPI.Intracomm) -> None:
    """The straight column is a solution beyond it, too: a tiny load begins the progression."""
    assert all(solve.bifurcation is None for solve in column(comm, 0.9).solves)
    (solve,) = (solve for solve in column(comm, 1.2).solves if solve.bifurcation is not None)
    assert solve.bifurcation is not None
    expected = 1 / (1 + EULER * 2 * 6 / 5)  # E/(k G) of a rectangle whose Poisson's ratio is 0 (Timoshenko)
    print(f"critical load over Euler's: {1.2 * solve.bifurcation:.6f}, with shear {expected:.6f}, mode {solve.mode}")
    assert 1.2 * solve.bifurcation == pytest.approx(expected, abs=1e-3)
    assert abs(solve.mode[1]) > 0.999


@pytest.mark.everyday("positive")
@pytest.mark.parametrize(("branch", "side"), [("positive", 1), ("negative", -1)])
def test_buckled_column_is_the_elastica(branch: str, side: int, comm: MPI.Intracomm) -> None:
    """At 300 times Euler's strain: turned by 0.6 rad, and shortened by bending and by the axial force."""
    strain = 300 * EULER
    solution = column(comm, 300, branch)
    u = solution.model.unknowns.displacement().x.array.reshape(-1, 3)[:, 1] * solution.body.length_scale

    def shortened(m: float) -> float:
        K, E = float(ellipk(m)), float(ellipe(m))  # of a quarter of its wave
        return 2 * (1 - E / K) + EULER * (2 * K / np.pi) ** 2 * (2 * E / K - 1) - strain

    m = brentq(shortened, 1e-9, 0.9)
    sway, expected = side * u[np.abs(u).argmax()], 2 * np.sqrt(m) / ellipk(m)
    print(f"sway {sway:.5f}, elastica {expected:.5f}, {factorizations(solution)} factorizations")
    assert sway == pytest.approx(expected, rel=2e-3)  # shear, and half of a thickness of 1/50
    assert solution.solves[0].strategy == "branch switching"
    assert solution.solves[0].bifurcation == pytest.approx(1 / 300, rel=1e-3)


def test_a_series_without_factors_is_one_failed_solve(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tangent that cannot be factorized: the path ends with the reason."""
    given = job(**BEAM | PATHS["forward"], solver={"linear": "direct"})
    equations = Equations(given, build_body(given.mesh, given.regions, comm, resolve=given.resolve), Timings())
    equilibrium = equations.equilibrium(equations.weak_form("forward"))
    linear = equilibrium.linear

    def fails(*_: object) -> bool:
        linear.forget_factors()
        return False

    for name in ("solve", "back_substitute"):
        monkeypatch.setattr(linear, name, fails)
    (solve,) = EquilibriumPath(equilibrium, 1e-10).follow(SeriesSteps(1e-3, 1e-6))
    assert not solve.outcome.accepted
    equilibrium.destroy()


def test_little_memory_makes_fewer_orders(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(SILENT, "failing", lines.extend)
    plenty = solved(comm, "series", **PATHS["forward"])
    assert not lines
    monkeypatch.setattr(taylor_residual, "available", lambda _: 1e6)
    little = solved(comm, "series", **PATHS["forward"])
    orders = {int(line.split()[3]) for line in lines if line.startswith("power series of")}
    print(lines[0])
    assert len(orders) == 1
    assert 8 <= orders.pop() < 20
    unknowns = [result.model.unknowns for result in (plenty, little)]
    states = [each.geometry_values(each.displacement()) for each in unknowns]
    assert np.abs(states[0] - states[1]).max() < 1e-10 * np.abs(states[0]).max()
