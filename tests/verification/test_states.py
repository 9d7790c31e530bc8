"""States of one body: closed forms in several states, the return to the given mesh, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from math import log
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE
from helpers.soft_column import LAM, MU, SOFT, column_length, column_stretch, confined, gravity
from helpers.verification import box, digits, job
from scipy.integrate import quad

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import Interrupted, JobError, MeshError
from hpcinv.results.solution import Solution
from hpcinv.solver.workspace import Workspace

ROOT = Path(__file__).parents[2]
BASE = [{"region": "z0", "fix": ["x", "y", "z"]}]


def farthest(solution: Solution, points: np.ndarray, others: np.ndarray) -> float:
    comm = solution.displacement.function_space.mesh.comm
    return float(comm.allreduce(float(np.abs(points - others).max(initial=0.0)), op=MPI.MAX))


@pytest.mark.parallel([2, 1])
def test_an_unloaded_body_loaded_again_is_the_given_body(comm: MPI.Intracomm) -> None:
    """On curved cells, with moduli, densities and fibres given on the given body; directly, and by way of others."""
    soft = {"law": "neo-hookean", "mu": "10 kPa*(1 + x/(1 m) + z*z/(1 m)/(1 m))", "lam": "40 kPa"}

    def weight(up: float) -> dict[str, Any]:
        return gravity(up, density="400 + 300*x*z/(1 m)/(1 m)", density_in="current")

    sliding = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 2)) | {"geometry_degree": 2},
            material=soft,
            discretisation={"displacement": 2, "formulation": "displacement"},
            certificate=NO_CERTIFICATE | {"round_trip": "near", "stability": True},
            supports=BASE,
            states=[
                {"name": "prone", "given": True, "effects": [weight(1)]},
                {"name": "rest"},
                {"name": "return", "effects": [weight(1)], "start": "tilted"},
                {"name": "supine", "effects": [weight(-1)]},
                {"name": "again", "effects": [weight(1)]},
                {"name": "tilted", "effects": [weight(0.5)], "supports": sliding},
            ],
            quantities=[{"name": "top", "of": "uz", "at": [0.4, 0.6, 1]}],
        ),
        comm,
    )
    assert [s.state for s in result.solutions] == ["prone", "supine", "again", "tilted", "return"]
    assert [s.direction for s in result.solutions] == ["inverse", *["forward"] * 4]
    given, shapes = result.solutions[0], result.shapes
    moved = farthest(given, shapes["rest"], shapes["prone"])
    gaps = {name: farthest(given, shapes[name], shapes["prone"]) for name in ("again", "return")}
    print(f"{comm.size} rank(s): moved by {moved:.3g} m, gaps {digits(gaps.values())} m")
    assert moved > 0.04
    assert max(gaps.values()) < 1e-11
    assert farthest(given, shapes["supine"], shapes["rest"]) > 0.04
    top = {name: result.quantities[f"top-{name}"] for name in shapes if name != "rest"}
    assert top["prone"] > 0.04
    assert top["again"] == pytest.approx(top["prone"], rel=1e-10)  # the same material point
    assert top["return"] == pytest.approx(top["prone"], rel=1e-10)
    lines = {(line.state, line.name): line for line in result.certificate.lines}
    for solution in result.solutions:
        closure = lines[solution.state, "round trip, relative to the displacement"].value
        assert closure is not None
        assert closure < 1e-9
        assert lines[solution.state, "stability: unstable directions"].verdict.value == "pass"


def test_a_column_that_stands_and_hangs_has_one_mass(comm: MPI.Intracomm) -> None:
    """Confined laterally: stress and weight above a section balance in each state, with the mass measured standing."""
    weight = {"density": 1000, "density_in": "current"}
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 16), lx="0.2 m", ly="0.2 m"),
            **SOFT,
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
            states=[
                {"name": "standing", "given": True, "effects": [gravity(-1, **weight)]},
                {"name": "rest"},
                {"name": "hanging", "effects": [gravity(1, **weight)]},
                {"name": "on-the-moon", "effects": [gravity(-1 / 6, **weight)], "start": "hanging"},
            ],
            quantities=[
                {"name": "top", "of": "z", "at": [0.1, 0.1, 1]},
                {"name": "rest", "of": "Z", "at": [0.1, 0.1, 1]},
            ],
        ),
        comm,
    )

    undeformed = float(quad(lambda z: 1 / column_stretch(z, -1), 0, 1, epsabs=1e-11)[0])
    assert undeformed == pytest.approx(1.0802799, abs=1e-7)
    exact = {"top-hanging": column_length(1), "top-on-the-moon": column_length(-1 / 6), "rest-standing": undeformed}
    print(", ".join(f"{name} {result.quantities[name]:.6g}, exactly {value:.6g}" for name, value in exact.items()))
    for name, value in exact.items():
        assert result.quantities[name] == pytest.approx(value, rel=2e-6)
    assert result.quantities["rest-hanging"] == pytest.approx(undeformed, rel=1e-6)


def test_the_error_of_a_further_state_includes_the_rest_shape(comm: MPI.Intracomm) -> None:
    """Half of the error of the hanging column's length comes from the rest shape."""
    weight = {"density": 1000, "density_in": "current"}
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 16), lx="0.2 m", ly="0.2 m"),
            **SOFT | {"certificate": NO_CERTIFICATE | {"estimate": True}},
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
            states=[
                {"name": "standing", "given": True, "effects": [gravity(-1, **weight)]},
                {"name": "hanging", "effects": [gravity(1, **weight)]},
            ],
            discretisation={"displacement": 1},
            quantities=[{"name": "top", "of": "z", "at": [0.1, 0.1, 1]}],
        ),
        comm,
    )

    exact = column_length(1)
    error = exact - result.quantities["top-hanging"]
    assert result.estimate is not None
    effectivity = result.estimate.quantities["top-hanging"] / error
    print(f"error {error:.2e}, effectivity {effectivity:.3f}")
    assert effectivity == pytest.approx(1, abs=0.1)
    assert "geometry" not in result.estimate.left_out


LOW, FULLER = (f"states[{i}].effects[0].pressure" for i in (0, 2))


@pytest.mark.release
def test_a_sphere_in_three_states(comm: MPI.Intracomm) -> None:
    """Inflated as given, at rest, and under twice the pressure (incompressible neo-Hooke)."""

    def pressure(A: float, a: float) -> float:
        B, b = ((A**3 + 1.5**3 - 1) ** (1 / 3), (a**3 + 1.5**3 - 1) ** (1 / 3))
        g = [2 / stretch + stretch**-4 / 2 for stretch in (b / B, a / A)]
        return g[0] - g[1]

    A = root(lambda A: pressure(A, 1.0) - 0.2, 0.5, 1.0)
    assert round(A, 7) == 0.9254360
    exact = {"rest-given": A, "inner-given": 1.0, "inner-fuller": root(lambda a: pressure(A, a) - 0.4, 1.0, 1.3)}

    def inflated(by: float) -> list[dict[str, Any]]:
        return [{"effect": "pressure", "region": "inner", "pressure": by}]

    result = hpcinv.run(
        job(
            mesh={
                "file": "../meshes/thick_sphere.py",
                "parameters": {"inner": 1.0, "outer": 1.5, "radial": 4, "along": 4, "hexahedra": True},
                "geometry_degree": 2,
            },
            material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
            supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            states=[
                {"name": "given", "given": True, "effects": inflated(0.2)},
                {"name": "rest"},
                {"name": "fuller", "effects": inflated(0.4)},
            ],
            quantities=[
                {"name": "inner", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean"},
                {"name": "rest", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean", "state": "given"},
            ],
            certificate=NO_CERTIFICATE,
            sensitivities={"material.c1": 0.01, LOW: None, FULLER: 0.002},
        ),
        comm,
    )
    quantities, derivatives = result.quantities, result.sensitivities
    print({name: (quantities[name if name in quantities else "rest"], value) for name, value in exact.items()})
    assert quantities["rest"] == pytest.approx(exact["rest-given"], rel=3e-6)
    assert quantities["inner-fuller"] == pytest.approx(exact["inner-fuller"], rel=1e-5)

    # Pressures are p = 2 c1 g(A, a): twice the modulus and both pressures leave both radii as they were.
    def slope(function: Callable[[float], float], at: float) -> float:
        return (function(at + 1e-5) - function(at - 1e-5)) / 2e-5

    a = exact["inner-fuller"]
    by_a, by_A = slope(lambda a: pressure(A, a), a), slope(lambda A: pressure(A, a), A)
    rest = {LOW: 1 / slope(lambda A: pressure(A, 1.0), A), FULLER: 0.0}
    fuller = {LOW: -by_A / by_a * rest[LOW], FULLER: 1 / by_a}
    for slopes in (rest, fuller):
        slopes["material.c1"] = -(0.2 * slopes[LOW] + 0.4 * slopes[FULLER]) / 0.5
    assert derivatives is not None
    assert derivatives.slopes["rest"] == pytest.approx(rest, rel=3e-4, abs=1e-9)
    assert derivatives.slopes["inner-fuller"] == pytest.approx(fuller, rel=3e-4)
    deviation = np.hypot(0.01 * fuller["material.c1"], 0.002 * fuller[FULLER])
    assert derivatives.deviations["inner-fuller"] == pytest.approx(deviation, rel=3e-4)


@pytest.mark.release
def test_hot_cold_hot_and_other_supports(comm: MPI.Intracomm) -> None:
    """A block that is measured hot between plates; cold, hot again, colder still, and free under a traction."""

    def heated(by: float) -> dict[str, Any]:
        return {"effect": "thermal-expansion", "coefficient": "1e-3 1/K", "temperature_change": by}

    symmetry = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    pull = {"effect": "traction", "region": "z1", "traction": [0, 0, 5e3], "area_in": "reference"}
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 1)) | {"geometry_degree": 2},
            **SOFT,
            discretisation={"displacement": 2, "formulation": "displacement"},
            supports=symmetry,
            states=[
                {"name": "hot", "given": True, "effects": [heated(100)]},
                {"name": "cold"},
                {"name": "hot-again", "effects": [heated(100)]},
                {"name": "frozen", "effects": [heated(-50)], "start": "hot"},
                {"name": "free", "effects": [pull]},
                {
                    "name": "held",
                    "effects": [pull],
                    "supports": [{"region": "boundary", "fix": ["x", "y"]}, symmetry[2]],
                },
            ],
            quantities=[{"name": "top", "of": "z", "at": [1, 1, 1]}, {"name": "side", "of": "x", "at": [1, 1, 1]}],
        ),
        comm,
    )
    cold = 1 / 1.1
    assert farthest(result.solutions[0], result.shapes["hot-again"], result.shapes["hot"]) < 1e-13
    assert result.quantities["top-frozen"] == pytest.approx(0.95 * cold, rel=1e-11)
    held = root(lambda s: confined(s) - 5e3, 1.0, 2.0)
    assert result.quantities["top-held"] == pytest.approx(held * cold, rel=1e-10)
    assert result.quantities["side-held"] == pytest.approx(cold, rel=1e-10)

    # Free at the sides: μ(t² - 1) + Λ ln(s t²) = 0 across, and along it (μ(s² - 1) + Λ ln(s t²))/s = traction.
    def across(s: float) -> float:
        return root(lambda t: MU * (t * t - 1) + LAM * log(s * t * t), 0.5, 1.5)

    free = root(lambda s: (MU * (s * s - 1) + LAM * log(s * across(s) ** 2)) / s - 5e3, 1.0, 2.0)
    assert result.quantities["top-free"] == pytest.approx(free * cold, rel=1e-10)
    assert result.quantities["side-free"] == pytest.approx(across(free) * cold, rel=1e-10)


@pytest.mark.everyday("9")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("iterations", [3, 9])
def test_a_run_that_stops_in_any_state_goes_on_to_the_same_shapes(
    iterations: int, comm: MPI.Intracomm, run_directory: Path
) -> None:
    whole = job(
        **BLOCK | {"supports": BASE, "solver": {"strategy": "fixed", "steps": 2}},
        states=[PRONE, SUPINE, {"name": "side", "start": "supine", "effects": [gravity(0.5)]}],
    )
    expected, left = hpcinv.run(whole, comm).shapes, iterations

    def stop_asked() -> bool:
        nonlocal left
        left -= 1
        return left < 0

    with pytest.raises(Interrupted):
        hpcinv.run(whole, comm, directory=run_directory / "run", stop_asked=stop_asked)
    resumed = hpcinv.run(whole, comm, directory=run_directory / "run", resume=True)
    gaps = {name: farthest(resumed.solutions[0], shape, expected[name]) for name, shape in resumed.shapes.items()}
    assert set(gaps) == {"prone", "rest", "supine", "side"}
    assert max(gaps.values()) < 1e-9


def test_the_given_state_may_be_the_rest_shape(comm: MPI.Intracomm) -> None:
    whole = BLOCK | {"supports": BASE}
    states = [{"name": "printed", "given": True}, {"name": "mounted", "effects": [gravity(-1)]}]
    result = hpcinv.run(job(**whole, states=[*states, {"name": "turned", "effects": [gravity(1)]}]), comm)
    alone = hpcinv.run(job(**whole, analysis="forward", effects=[gravity(1)]), comm)
    assert [s.direction for s in result.solutions] == ["forward", "forward"]
    assert farthest(alone.solutions[0], result.shapes["turned"], alone.shape) < 1e-13
    assert list(result.shapes) == ["printed", "mounted", "turned"]


def test_a_state_that_buckles_while_it_is_released_is_not_decided_to_have_a_limit_point(comm: MPI.Intracomm) -> None:
    """A column that is held at its sides beyond the load of Greenhill (1881), and then free below it.

    The critical weight per length is 7.84 E I/L³ about the weak axis (more on few cells), and four times that about the
    other one.
    """
    young, width = MU * (3 * LAM + 2 * MU) / (LAM + MU), 0.1
    critical = 7.84 * young * width**2 / 12 / 9.81  # density, kg/m³
    free = {"name": "free", "effects": [gravity(-0.2, density=3.5 * critical)]}
    whole: dict[str, Any] = BLOCK | {
        "mesh": box((1, 1, 6), lx=width, ly=2 * width) | {"geometry_degree": 2},
        "supports": BASE,
        "certificate": NO_CERTIFICATE | {"stability": True},
    }
    held = {
        "name": "held",
        "effects": [gravity(-1, density=3.5 * critical)],
        "supports": [*BASE, {"region": "boundary", "fix": ["x", "y"]}],
    }
    for start, verdict in (({}, "pass"), ({"start": "held"}, "not decided")):
        result = hpcinv.run(job(**whole, states=[{"name": "cast", "given": True}, held, free | start]), comm)
        lines = {line.name: line for line in result.certificate.lines if line.state == "free"}
        assert lines["stability: unstable directions"].verdict.value == "pass"
        assert lines["limit points of the path"].verdict.value == verdict
    assert "state 'held' were removed" in lines["limit points of the path"].note


BLOCK: dict[str, Any] = {
    "mesh": box((1, 1, 1)) | {"geometry_degree": 2},
    "discretisation": {"displacement": 2, "formulation": "displacement"},
    **SOFT,
}


def test_states_that_differ_in_numbers_share_equations(comm: MPI.Intracomm) -> None:
    states = [{"name": f"s{i}", "given": i == 0, "effects": [gravity(1 - i / 2)]} for i in range(4)]
    with Workspace(comm) as workspace:
        hpcinv.run(job(**BLOCK, supports=BASE, states=states), comm, workspace=workspace)
        (model,) = workspace._equations.values()
        assert len(model._idle) == 2  # one matrix for each direction
        states[3] |= {"supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]}
        hpcinv.run(job(**BLOCK, supports=BASE, states=states), comm, workspace=workspace)
        first, other = workspace._equations.values()
        assert first.unknowns is other.unknowns


DIFFERENTIATED: dict[str, Any] = {
    "mesh": box((2, 1, 2)) | {"geometry_degree": 2},
    "material": {"law": "neo-hookean", "mu": "10 kPa*(1 + x/(1 m) + z*z/(1 m)/(1 m))", "lam": LAM},
    "discretisation": {"displacement": 2, "formulation": "displacement"},
    "certificate": NO_CERTIFICATE,
    "solver": {"tolerance": 1e-13},
    "supports": BASE,
    "states": [
        {"name": "prone", "given": True, "effects": [gravity(1, density="400 + 300*x*z/(1 m)/(1 m)")]},
        {"name": "supine", "effects": [gravity(-1, density=300, density_in="current")]},
        {
            "name": "pulled",
            "start": "supine",
            "effects": [gravity(0.5)],
            "supports": [*BASE, {"region": "z1", "displacement": ["0.1*s*x", 0, "0.1*s"], "constants": {"s": 1}}],
        },
    ],
    "quantities": [
        {"name": "top", "of": "displacement", "at": [0.4, 0.6, 0.9]},
        {"name": "stress", "of": "szz", "at": [0.5, 0, 0.5]},  # of one cell, of several that meet there
        {"name": "volume", "of": "1", "on": "block", "reduce": "integral", "over": "current"},
        {"name": "energy", "of": "energy", "on": "block", "reduce": "integral", "over": "reference"},
    ],
}
DIFFERENTIATED["states"][0]["effects"][0]["density_in"] = "current"
KEYS = [
    "material.lam",
    "states[0].effects[0].acceleration[2]",
    "states[1].effects[0].density",
    "states[2].supports[1].constants.s",
]


@pytest.mark.parallel([2, 1])
def test_derivatives_of_all_states_are_differences_of_whole_runs(comm: MPI.Intracomm) -> None:
    """A modulus and a density are given on the given body, so that all states follow the given one in two ways.

    All numbers change together.
    """
    with Workspace(comm) as workspace:

        def found(shift: float) -> Any:
            changed = DIFFERENTIATED
            for p in job(**DIFFERENTIATED, sensitivities=KEYS).differentiated:
                changed = assigned(changed, {p.key: p.value * (1 + shift)})
            return hpcinv.run(job(**changed), comm, workspace=workspace)

        derivatives = hpcinv.run(job(**DIFFERENTIATED, sensitivities=KEYS), comm, workspace=workspace).sensitivities
        assert list(derivatives.shapes) == ["rest", "supine", "pulled"]
        ahead, behind = (found(shift) for shift in (1e-3, -1e-3))
    assert list(derivatives.slopes) == list(ahead.quantities)
    for number, (state, of_state) in enumerate(derivatives.shapes.items()):
        later, other = (r.solutions[number].other_nodes for r in (ahead, behind))
        expected = (later - other) / 2e-3
        size = comm.allreduce(abs(expected).max(), op=MPI.MAX)
        total = np.zeros_like(expected)
        for p in derivatives.parameters:
            part = of_state.nodes[p.key] * p.value
            if p.key.startswith(("material", "states[0]", f"states[{number}]")):
                assert comm.allreduce(abs(part).max(), op=MPI.MAX) > 1e-3 * size  # an error of each shows in the sum
            else:
                assert not part.any()
            total += part
        error = comm.allreduce(abs(total - expected).max(), op=MPI.MAX)
        print(f"{state}: {size:.3g}, difference {error:.1g}")
        assert error < 2e-5 * size
    for name, slopes in derivatives.slopes.items():
        expected = (np.array(ahead.quantities[name]) - behind.quantities[name]) / 2e-3
        size = max(abs(expected).max(), 1e-7 * np.abs(ahead.quantities[name]).max())
        total = sum(np.multiply(slopes[p.key], p.value) for p in derivatives.parameters)
        assert total == pytest.approx(expected, rel=0, abs=2e-5 * size)


def test_a_support_of_one_state_that_the_mesh_lacks_is_named(comm: MPI.Intracomm) -> None:
    states = [
        {"name": "prone", "given": True, "effects": [gravity(1)], "supports": BASE},
        {"name": "supine", "effects": [gravity(-1)], "supports": [{"region": "bed", "fix": ["x", "y", "z"]}]},
    ]
    with pytest.raises(MeshError, match=r"states\[1\]\.supports\[0\]\.region: .*no region 'bed'"):
        hpcinv.run(job(mesh=box((1, 1, 1)), **SOFT, states=states), comm)


PRONE = {"name": "prone", "given": True, "effects": [gravity(1)]}
SUPINE = {"name": "supine", "effects": [gravity(-1)]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": [PRONE | {"given": False}, SUPINE]}, "states: none of them is given"),
        ({"states": [PRONE, SUPINE | {"given": True}]}, r"states\[1\]\.given: the mesh is already 'prone'"),
        (
            {"states": [PRONE, SUPINE | {"name": "prone"}]},
            r"states\[1\]\.name: 'prone' is the name of an earlier state",
        ),
        ({"states": [PRONE, {"name": "a"}, {"name": "b"}]}, r"states\[2\]: has neither effects nor supports"),
        ({"states": [{"name": "a", "given": True}]}, "states: none of them is loaded"),
        ({"states": [PRONE, SUPINE | {"start": "spine"}]}, r"\.start: there is no state 'spine'.*supine"),
        ({"states": [PRONE, SUPINE | {"start": "supine"}]}, r"\.start: leads back to the state itself"),
        ({"states": [PRONE | {"start": "supine"}, SUPINE]}, r"start: is not valid for the given state"),
        ({"effects": [gravity(1)]}, "effects: belong to states in a job with 'states'"),
        ({"cavities": {"c": {"surface": "z1", "gas": {"ambient": 1e5}}}}, "cavities.c: is not valid with 'states'"),
        ({"analysis": "inverse"}, "analysis: is not valid with 'states'"),
        ({"supports": []}, "supports: in state 'prone': leave the body free to move along x and y and z"),
        (
            {"states": [PRONE | {"supports": [{"region": "z0", "fix": ["z"]}]}, SUPINE]},
            r"states\[0\]\.supports: leave the body free to move along x and y",
        ),
        (
            {"states": [{"name": "r", "given": True}, {"name": "s", "effects": [gravity(1, density_in="current")]}]},
            r"states\[1\]\.effects\[0\]\.density_in is given on the current body",
        ),
        ({"states": [PRONE, {"name": "r", "effects": [{"effect": "gravtiy"}]}]}, r"unknown effect 'gravtiy'"),
        (
            {"quantities": [{"name": "top", "of": "uz", "at": [0, 0, 1], "state": "suppine"}]},
            "there is no loaded state 'suppine'",
        ),
        ({"accuracy": {"top-prone": 1e-3}}, "accuracy: is not possible with 'states'"),
    ],
)
def test_bad_states_are_refused_with_one_message(changes: dict[str, Any], message: str) -> None:
    whole = {"states": [PRONE, SUPINE], "supports": BASE, "quantities": [{"name": "top", "of": "uz", "at": [0, 0, 1]}]}
    with pytest.raises(JobError, match=message) as caught:
        job(mesh=box((1, 1, 1)), **SOFT, **whole | changes)
    assert len(caught.value.problems) == 1


@pytest.mark.release
def test_a_ventricle_fills_as_klotz_found(comm: MPI.Intracomm) -> None:
    """Volumes at 2 to 30 mmHg, from that at 9 mmHg alone, by the curve of human hearts.

    Source: Klotz et al. (2006), doi:10.1152/ajpheart.01240.2005.
    """
    quantities = hpcinv.run(hpcinv.load(ROOT / "jobs" / "ventricle.yaml"), comm).quantities
    pressure, volume = 9.0, quantities["volume-filled"]
    a, c, base = 25e-3, 60e-3, 15e-3
    cavity = np.pi * a**2 * ((base - base**3 / (3 * c**2)) + 2 * c / 3)
    assert volume == pytest.approx(cavity, rel=1e-3)  # of curved cells of 8 mm
    empty = volume * (0.6 - 0.006 * pressure)
    at_30 = empty + (volume - empty) / (pressure / 27.78) ** (1 / 2.76)
    beta = np.log(pressure / 30) / np.log(volume / at_30)
    for p in (2, 4, 6, 30):
        klotz = at_30 * (p / 30) ** (1 / beta)
        print(f"{p} mmHg: {1e6 * quantities[f'volume-at-{p}']:.1f} ml, Klotz {1e6 * klotz:.1f} ml")
        assert quantities[f"volume-at-{p}"] == pytest.approx(klotz, rel=0.05)
