"""Sensitivities: against closed forms, finite differences of whole runs, and what scaling all stresses must leave."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.accuracy_cases import cases
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT, hpcinv_here, write_job
from helpers.homogeneous import SYMMETRY
from helpers.thick_sphere import INNER, PRESSURE, carried
from helpers.verification import box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import JobError
from hpcinv.job.job import Job
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.output.result import Result
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.sensitivity.sensitivities import Sensitivities

MU, LAM, SQUEEZE = 10e3, 40e3, 3e3
STEP = 1e-3  # relative


def of(result: Result) -> Sensitivities:
    assert result.sensitivities is not None
    return result.sensitivities


def squeezed(**data: Any) -> Job:
    """A cube under the same pressure on all sides, which stays a cube: three of them are planes of symmetry."""
    pressures = [{"effect": "pressure", "region": f"{axis}1", "pressure": SQUEEZE} for axis in "xyz"]
    common: dict[str, Any] = {
        "mesh": box((2, 1, 1)),
        "material": {"law": "neo-hookean", "mu": MU, "lam": LAM},
        "effects": pressures,
        "supports": SYMMETRY,
        "discretisation": {"displacement": 1},
        "solver": {"tolerance": 1e-14},
        "quantities": [
            {"name": "corner", "of": "displacement", "at": [1, 1, 1]},
            {"name": "p", "of": "p", "at": [0.5, 0.4, 0.3]},
            {"name": "energy", "of": "energy", "on": "block", "reduce": "integral", "over": "reference"},
        ],
    }
    return job(**(common | data))


def stretch(mu: float = MU, lam: float = LAM, pressure: float = SQUEEZE) -> float:
    """``λ`` where the Cauchy stress ``(mu (λ² - 1) + 3 lam ln λ)/λ³`` is minus the pressure."""
    return root(lambda s: (mu * (s**2 - 1) + 3 * lam * np.log(s)) / s**3 + pressure, 0.8, 1.0)


def slopes_of_stretch() -> dict[str, float]:
    """By mu, lam and the pressure, from its equation ``mu (λ² - 1) + 3 lam ln λ + p λ³ = 0``."""
    s = stretch()
    by_stretch = 2 * MU * s + 3 * LAM / s + 3 * SQUEEZE * s**2
    return {"mu": -(s**2 - 1) / by_stretch, "lam": -3 * np.log(s) / by_stretch, "pressure": -(s**3) / by_stretch}


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_a_squeezed_cube(comm: MPI.Intracomm) -> None:
    """Nodes and energy follow the stretch; the pressure inside is that outside, whatever the moduli are."""
    for analysis in ("forward", "inverse")[comm.size - 1 :]:
        check_squeezed(analysis, comm)


def check_squeezed(analysis: str, comm: MPI.Intracomm) -> None:
    asked = {"material.mu": "0.5 kPa", "material.lam": None, **{f"effects[{i}].pressure": 30.0 for i in range(3)}}
    result = package.run(squeezed(analysis=analysis, sensitivities=asked), comm)
    sensitivities, exact, s = of(result), slopes_of_stretch(), stretch()
    assert comm.allgather(sensitivities.as_data()) == [sensitivities.as_data()] * comm.size
    given = result.solutions[0].mesh_nodes
    pressure = sum(sensitivities.nodes[f"effects[{i}].pressure"] for i in range(3))
    per_stretch = 1.0 if analysis == "forward" else -1 / s**2
    by_name = {
        "mu": sensitivities.nodes["material.mu"],
        "lam": sensitivities.nodes["material.lam"],
        "pressure": pressure,
    }
    for name, nodes in by_name.items():
        expected = per_stretch * exact[name] * given
        np.testing.assert_allclose(nodes, expected, rtol=0, atol=1e-12 * abs(exact[name]))
    slopes = sensitivities.slopes
    assert slopes["corner"]["material.mu"] == pytest.approx(3 * [abs(per_stretch) * exact["mu"]], rel=1e-10)
    assert abs(slopes["p"]["material.mu"]) < 1e-9 * SQUEEZE / MU
    assert sum(slopes["p"][f"effects[{i}].pressure"] for i in range(3)) == pytest.approx(1, rel=1e-10)
    # The energy per reference volume is 3/2 mu (λ² - 1 - 2 ln λ) + 9/2 lam ln²λ: explicit in mu, and by λ.
    per_volume = 1.5 * MU * (s**2 - 1 - 2 * np.log(s)) + 4.5 * LAM * np.log(s) ** 2
    by_stretch = 3 * MU * (s - 1 / s) + 9 * LAM * np.log(s) / s
    by_mu = 1.5 * (s**2 - 1 - 2 * np.log(s)) + by_stretch * exact["mu"]
    if analysis == "inverse":  # over the reference volume 1/λ³
        by_mu = by_mu / s**3 - 3 * per_volume / s**4 * exact["mu"]
    assert slopes["energy"]["material.mu"] == pytest.approx(by_mu, rel=1e-9)

    # Each of these parameters by itself, and the sum of their squares.
    deviations = {key: 500.0 if key == "material.mu" else 30.0 for key in sensitivities.nodes if key != "material.lam"}
    squares = sum((sd * sensitivities.nodes[key]) ** 2 for key, sd in deviations.items()).sum(axis=1)
    assert sensitivities.deviation == pytest.approx(np.sqrt(np.concatenate(comm.allgather(squares)).max()), rel=1e-12)
    assert sensitivities.deviation_at == pytest.approx([1, 1, 1], abs=1e-15)
    corner = np.linalg.norm([sd * np.array(slopes["corner"][key]) for key, sd in deviations.items()], axis=0)
    assert sensitivities.deviations["corner"] == pytest.approx(corner.tolist(), rel=1e-12)


@pytest.mark.release
def test_first_order_is_what_a_sample_has(comm: MPI.Intracomm) -> None:
    """2 % of the shear modulus: 20000 cubes in closed form."""
    result = package.run(squeezed(analysis="forward", sensitivities={"material.mu": 0.02 * MU}), comm)
    sample = np.random.default_rng(5).normal(MU, 0.02 * MU, 20_000)
    grid = np.linspace(0.85 * MU, 1.15 * MU, 301)
    spread = np.interp(sample, grid, [stretch(mu) for mu in grid]).std()
    deviations = of(result).deviations["corner"]
    print(f"first order {deviations}, sample {spread}")
    assert deviations == pytest.approx(3 * [spread], rel=0.02)


@pytest.mark.release
def test_a_thick_sphere_by_its_pressure_and_modulus(comm: MPI.Intracomm) -> None:
    """``p = mu g(A)``, so that ``dA/dp = 1/(mu g'(A))`` and ``dA/dmu = -p/(mu² g'(A))``; incompressible."""
    mesh = {"radial": 3, "along": 3, "hexahedra": True, "inner": INNER}
    sphere = job(
        mesh={"file": "../meshes/thick_sphere.py", "parameters": mesh | {"outer": 1.5}, "geometry_degree": 2},
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
        supports=SYMMETRY,
        quantities=[{"name": "inner", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"}],
        sensitivities=["material.c1", "effects[0].pressure"],
    )
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    by_A = (carried(A + 1e-5, 0.5, 0.0) - carried(A - 1e-5, 0.5, 0.0)) / 2e-5
    slopes = of(package.run(sphere, comm)).slopes["inner"]
    exact = {"material.c1": -2 * PRESSURE / by_A, "effects[0].pressure": 1 / by_A}
    print(f"found {slopes}, exact {exact}")
    assert slopes == pytest.approx(exact, rel=2e-4)


@pytest.mark.release
def test_a_column_on_the_mesh_that_its_accuracy_asks_for(comm: MPI.Intracomm) -> None:
    """Confined, of undeformed length L and now 1 m high.

    With the stretch λ that carries a pressure, ``∫ λ(y) dy = ρ g`` for y from 0 to ``ρ g L`` at the bottom, where it is
    λ_b; so that ``dL/dρ = (1/λ_b - L)/ρ``.
    """
    (case,) = (c for c in cases() if c.name == "column, density of the body at rest")
    slopes = of(package.run(case.job(sensitivities=["effects[0].density"]), comm)).slopes["q"]["effects[0].density"]
    density, length = 1000.0, case.exact
    bottom = root(lambda s: MU * (s - 1 / s) + LAM * np.log(s) / s + density * 9.81 * length, 0.5, 1.0)
    exact = (1 / bottom - length) / density
    print(f"dL/dρ {slopes}, exact {exact}")
    assert slopes == pytest.approx(exact, rel=1e-4)


def test_a_shear_that_its_boundary_prescribes(comm: MPI.Intracomm) -> None:
    """``u = (-k y, 0, 0)`` on all of it, and so inside: by k it is ``(-y, 0, 0)``, and energy goes with k²."""
    shear = {"region": "boundary", "displacement": ["-k*y", 0, 0], "constants": {"k": 0.3}}
    key = "supports[0].constants.k"
    data = {"mesh": box(), "effects": [], "supports": [shear], "sensitivities": {key: 0.01}}
    result = package.run(squeezed(analysis="inverse", **data), comm)
    sensitivities, exact = of(result), np.zeros((27, 3))
    exact[:, 0] = result.solutions[0].mesh_nodes[:, 1]  # of X = x - u
    np.testing.assert_allclose(sensitivities.nodes[key], exact, rtol=0, atol=1e-12)
    assert sensitivities.slopes["energy"][key] == pytest.approx(MU * 0.3, rel=1e-10)
    assert sensitivities.deviations["corner"] == pytest.approx([0.01, 0, 0], abs=1e-12)


def test_slopes_of_stress_do_not_pass_the_kink_of_a_law(comm: MPI.Intracomm) -> None:
    """Fibres along x that are stretched by a = 1.0001 carry tension, and none below 1.

    Their Cauchy stress is ``2 k1 a²/J E exp(k2 E²)`` with ``E = a² - 1`` and ``J = 1.2 a``.
    """
    k1, k2, key = 1500.0, 0.8, "supports[0].constants.t"

    def slope(stiffness: float) -> float:
        stretch = {"region": "boundary", "displacement": ["(t - 0.0999)*x", 0, "0.2*z"], "constants": {"t": 0.1}}
        fibre_job = job(
            analysis="forward",
            mesh=box((1, 1, 1)),
            regions={"body": "x > -1 m"},
            material={
                "law": "holzapfel-gasser-ogden",
                "fibres": ["fibre1"],
                "mu": 2e3,
                "k1": stiffness,
                "k2": k2,
                "dispersion": 0,
                "kappa": 1e4,
            },
            fibres={"fibre1": {"direction": [1, 0, 0], "given_on": "reference"}},
            supports=[stretch],
            quantities=[{"name": "stress", "of": "sxx", "on": "body", "reduce": "mean"}],
            sensitivities=[key],
        )
        slopes = of(package.run(fibre_job, comm)).slopes["stress"][key]
        assert isinstance(slopes, float)
        return slopes

    a = 1.0001
    strain = a**2 - 1
    exact = 2 * k1 / 1.2 * np.exp(k2 * strain**2) * (strain + 2 * a**2 * (1 + 2 * k2 * strain**2))
    of_fibres = slope(k1) - slope(1e-9)
    print(f"{of_fibres}, exact {exact}")
    assert of_fibres == pytest.approx(exact, rel=1e-6)


LAYERS: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": box(),
    "regions": {"lower": "z < 0.6 m", "upper": "z > 0.4 m", "left": "x < 0.6 m"},
    "material": {
        "lower": {"law": "neo-hookean", "mu": MU, "lam": LAM},
        "upper": {
            "law": "formula",
            "energy": "a/2*(I1_bar - 3) + b*(I1_bar - 3)**2",
            "parameters": {"a": "8 kPa", "b": "3 kPa"},
            "kappa": {"left": "30 kPa", "elsewhere": "20 kPa"},
        },
    },
    "fibres": {"f": {"direction": ["cos(a)", "sin(a)*y/(1 m)", 0.2], "given_on": "current", "constants": {"a": 0.5}}},
    "effects": [
        {
            "effect": "gravity",
            "acceleration": [0, 1, -9.81],
            "density": {"lower": 300, "upper": 200},
            "density_in": "current",
        },
        {"effect": "pressure", "region": "x1", "pressure": "0.4 kPa"},
        {"effect": "active-stress", "fibre": "f", "stress": "0.5 kPa"},
    ],
    "quantities": [
        {"name": "corner", "of": "displacement", "at": [1, 1, 1]},
        {"name": "mises", "of": "von_mises", "on": "lower", "reduce": "rms"},
        {"name": "volume", "of": "1", "on": "upper", "reduce": "integral", "over": "reference"},
    ],
}
LAYERS_STRESSES = {
    "material.lower.mu": MU,
    "material.lower.lam": LAM,
    "material.upper.parameters.a": 8e3,
    "material.upper.parameters.b": 3e3,
    "material.upper.kappa.left": 30e3,
    "material.upper.kappa.elsewhere": 20e3,
    "effects[0].density.lower": 300.0,
    "effects[0].density.upper": 200.0,
    "effects[1].pressure": 400.0,
    "effects[2].stress": 500.0,
}
LAYERS_OTHERS = {"effects[0].acceleration[1]": 1.0, "effects[0].acceleration[0]": 0.0, "fibres.f.constants.a": 0.5}
RUBBER: dict[str, Any] = {
    "analysis": "forward",
    "mesh": box(),
    "material": {"law": "mooney-rivlin", "c1": "3 kPa", "c2": "2 kPa", "d1": "2 MPa"},
    "load_cases": ["weight", "pull"],
    "effects": [
        {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200, "case": "weight"},
        {"effect": "traction", "region": "x1", "traction": [500, 100, 0], "area_in": "current", "case": "pull"},
    ],
    "quantities": [
        {"name": "corner", "of": "displacement", "at": [1, 1, 1]},
        {"name": "stress", "of": "szz", "at": [0.4, 0.6, 0.2]},
        {"name": "area", "of": "1", "on": "x1", "reduce": "integral", "over": "current"},
    ],
}
RUBBER_STRESSES = {
    "material.c1": 3e3,
    "material.c2": 2e3,
    "material.d1": 2e6,
    "effects[0].density": 200.0,
    "effects[1].traction[0]": 500.0,
    "effects[1].traction[1]": 100.0,
}


def written(data: dict[str, Any], **more: Any) -> Job:
    return job(**data, supports=[{"region": "z0", "fix": ["x", "y", "z"]}], solver={"tolerance": 1e-14}, **more)


def differences(data: dict[str, Any], key: str, value: float, space: Workspace) -> tuple[np.ndarray, dict[str, Any]]:
    """Derivatives of nodes and quantities by central differences of fourth order between whole runs."""
    step, results = STEP * (abs(value) or 1.0), []
    for k in (-2, -1, 1, 2):
        number = value + k * step
        # A formula's parameters have a dimension only by their units.
        changed = assigned(data, {key: f"{number!r} Pa" if "parameters" in key else number})
        results.append(package.run(written(changed), space.comm, workspace=space))

    def slope(a: Any, b: Any, c: Any, d: Any) -> np.ndarray:
        return (np.array(a) - 8 * np.array(b) + 8 * np.array(c) - np.array(d)) / (12 * step)

    quantities = {name: slope(*(r.quantities[name] for r in results)) for name in results[0].quantities}
    return slope(*(r.shape for r in results)), quantities


def check(data: dict[str, Any], stresses: dict[str, float], others: dict[str, float], comm: MPI.Intracomm) -> None:
    with Workspace(comm) as space:
        sensitivities = of(package.run(written(data, sensitivities=[*stresses, *others]), comm, workspace=space))
        # On several ranks one of them will do: all are in the sum below.
        for key, value in [*(stresses | others).items()][: None if comm.size == 1 else 1]:
            nodes, quantities = differences(data, key, value, space)
            largest = comm.allreduce(float(np.abs(nodes).max()), op=MPI.MAX)
            error = comm.allreduce(float(np.abs(sensitivities.nodes[key] - nodes).max()), op=MPI.MAX) / largest
            errors = {
                name: float(np.linalg.norm(sensitivities.slopes[name][key] - slope) / np.linalg.norm(slope))
                for name, slope in quantities.items()
            }
            print(f"{key}: shape {error:.1e}, " + ", ".join(f"{name} {e:.1e}" for name, e in errors.items()))
            assert error < 1e-8
            assert max(errors.values()) < 1e-7
    # Twice the moduli and twice the loads leave the body as it was.
    parts = [value * sensitivities.nodes[key] for key, value in stresses.items()]
    largest = comm.allreduce(max(float(np.abs(part).max()) for part in parts), op=MPI.MAX)
    left = comm.allreduce(float(np.abs(sum(parts)).max()), op=MPI.MAX)
    print(f"moduli and loads together: {left / largest:.1e} of the largest")
    assert left < 1e-12 * largest


@pytest.mark.release
def test_two_laws_and_values_by_region_in_an_inverse_analysis(comm: MPI.Intracomm) -> None:
    check(LAYERS, LAYERS_STRESSES, LAYERS_OTHERS, comm)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_a_nearly_incompressible_body_in_a_forward_analysis(comm: MPI.Intracomm) -> None:
    check(RUBBER, RUBBER_STRESSES, {}, comm)


def test_young_and_poisson_are_the_same_law_by_other_numbers(comm: MPI.Intracomm) -> None:
    """``E = 2 mu (1 + ν)``, ``ν = lam/(2 (lam + mu))``, and the slopes by these from those by mu and lam."""
    keys = [f"material.{name}" for name in ("mu", "lam", "young", "poisson")]
    nodes = of(package.run(squeezed(sensitivities=keys), comm)).nodes
    ratio = LAM / (2 * (LAM + MU))
    young = {"mu": 2 * (1 + ratio) - MU * LAM / (LAM + MU) ** 2, "lam": MU**2 / (LAM + MU) ** 2}
    poisson = {"mu": -LAM / (2 * (LAM + MU) ** 2), "lam": MU / (2 * (LAM + MU) ** 2)}
    for name in ("mu", "lam"):
        expected = young[name] * nodes["material.young"] + poisson[name] * nodes["material.poisson"]
        size = np.abs(nodes[f"material.{name}"]).max()
        np.testing.assert_allclose(nodes[f"material.{name}"], expected, rtol=0, atol=1e-12 * size)


@pytest.mark.release
def test_sensitivities_of_a_round_trip_are_of_its_first_solution(comm: MPI.Intracomm) -> None:
    keys = {"material.mu": 100.0}
    alone = of(package.run(squeezed(analysis="inverse", sensitivities=keys), comm))
    result = package.run(squeezed(analysis="round_trip", sensitivities=keys), comm)
    assert of(result).slopes["energy"] == pytest.approx(alone.slopes["energy"])
    np.testing.assert_allclose(of(result).nodes["material.mu"], alone.nodes["material.mu"], rtol=1e-10)
    assert result.errors["round_trip"]["relative"] < 1e-11


FAULTS = {
    "material.nu": "material.nu is not a number of a law, an effect, fibres, a support, a shell or a cavity in this",
    "effects[7].pressure": "Did you mean 'effects",
    "effects[0].region": "not a number of a law, an effect, fibres, a support, a shell or a cavity",
    "mesh.file": "Possible keys are material.mu, material.lam, material.young, material.poisson, …",
    "material": "is not one number; choose material.mu or material.lam or",
    "effects[]": "is not a number",
    "x y": "'x y' is not a key",
}


TIES = [
    ({"also": ["material.lam"], "deviation": 1}, "material.mu: has 'deviation'; it may have sd, also and scale"),
    ({"also": "material.lam"}, "material.mu: also must be a list of keys, not 'material.lam'"),
    ({"also": ["material.mu"]}, "material.mu: material.mu is duplicated"),
    ({"also": ["material.poisson"]}, "material.mu: material.poisson is a pure number, but material.mu is a stress"),
    ({"sd": "1 mm"}, "material.mu: "),
]


@pytest.mark.parametrize(("entry", "message"), TIES, ids=[message for _, message in TIES])
def test_incompatible_sensitivity_parameters_are_refused(entry: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError) as caught:
        squeezed(sensitivities={"material.mu": entry})
    assert message in str(caught.value)


def test_numbers_that_change_together_count_once(comm: MPI.Intracomm) -> None:
    """Slopes add up, and so the standard deviation: √((a + b)² σ²) instead of √(a² σ² + b² σ²)."""
    apart = of(package.run(squeezed(sensitivities={"material.mu": 100.0, "material.lam": 100.0}), comm))
    tied = of(package.run(squeezed(sensitivities={"material.mu": {"sd": 100.0, "also": ["material.lam"]}}), comm))
    for name, by_key in apart.slopes.items():
        total = np.add(*(np.array(by_key[key]) for key in ("material.mu", "material.lam")))
        np.testing.assert_allclose(tied.slopes[name]["material.mu"], total, rtol=1e-8, atol=1e-14)
        np.testing.assert_allclose(tied.deviations[name], abs(total) * 100.0, rtol=1e-8, atol=1e-12)
    whole = apart.nodes["material.mu"] + apart.nodes["material.lam"]
    np.testing.assert_allclose(tied.nodes["material.mu"], whole, rtol=1e-8, atol=1e-14)
    assert tied.as_data()["parameters"]["material.mu"]["also"] == ["material.lam"]


@pytest.mark.parametrize(("key", "message"), FAULTS.items(), ids=list(FAULTS))
def test_non_numbers_are_refused_as_sensitivity_parameters(key: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        squeezed(sensitivities=[key])
    assert caught.value.problems[0].split(": ", 1)[1].startswith("sensitivities[0]: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("law", "key", "message"),
    [
        ({"law": "neo-hookean", "mu": "1 kPa*(1 + x/(1 m))", "lam": 1}, "material.mu", "varies over the body"),
        ({"law": "neo-hookean", "mu": {"data": "a"}, "lam": 1}, "material.mu", "varies over the body"),
        (
            {"law": "neo-hookean", "mu": {"block": 1e3}, "lam": 1},
            "material.mu",
            "not one number; choose material.mu.block",
        ),
        ({"law": "neo-hookean", "mu": 1, "lam": "incompressible"}, "material.lam", "is infinite"),
        ({"law": "neo-hookean", "young": 1, "poisson": 0.5}, "material.poisson", "end of its range"),
        (
            {"law": "formula", "energy": "a*(I1_bar - 3) + b*(I1_bar - 3)**2", "parameters": {"a": "1 Pa", "b": "0 Pa"}}
            | {"kappa": 10},
            "material.parameters.b",
            "is 0, so that its term is not in the law",
        ),
    ],
)
def test_parameters_without_a_derivative_are_refused(law: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        squeezed(material=law, sensitivities={key: None}, discretisation={"displacement": 2, "formulation": "mixed"})
    assert f"sensitivities.{key}: {key} {message}" in str(caught.value) or message in str(caught.value)


@pytest.mark.parametrize(
    ("deviation", "message"),
    [("1 kg", "must be a stress, as material.mu is"), (0, "above 0"), (-1, "above 0"), (True, "must be a number")],
)
def test_a_deviation_is_positive_and_of_the_dimension_of_its_number(deviation: Any, message: str) -> None:
    with pytest.raises(JobError, match=f"sensitivities.material.mu: .*{message}"):
        squeezed(sensitivities={"material.mu": deviation})


def test_the_job_that_comes_with_the_project_on_screen_in_the_summary_and_in_the_fields(tmp_path: Path) -> None:
    import pyvista

    out = tmp_path / "out"
    shipped = read_yaml(ROOT / "jobs" / "uncertain-block.yaml")
    lengths = shipped["mesh"]["parameters"]
    mesh = {"file": str(ROOT / "meshes" / "box.py"), "parameters": {**lengths, "nx": 2, "ny": 2, "nz": 2}}
    path = write_job(tmp_path / "job.yaml", shipped, mesh=mesh, certificate=NO_CERTIFICATE)
    ended = hpcinv_here("run", path, "--output", out, cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    sensitivities = json.loads((out / "summary.json").read_text())["sensitivities"]
    keys = ["material.young", "material.poisson", "effects[0].density"]
    assert list(sensitivities["parameters"]) == keys
    assert sensitivities["parameters"]["material.young"] == {"value": pytest.approx(12e3), "sd": 1e3}
    height = sensitivities["quantities"]["height"]
    parts = [sensitivities["parameters"][key]["sd"] * slope for key, slope in height["slopes"].items()]
    assert height["sd"] == pytest.approx(np.linalg.norm(parts))
    with h5py.File(out / "summary.h5") as file:
        assert dict(file["sensitivities/quantities/height/slopes"].attrs) == height["slopes"]
    assert f"standard deviation {100 * height['sd']:.2g} cm)" in ended.stdout  # the unit of the job's lengths
    assert "per SI unit of\n  material.young: height " in ended.stdout
    # Softer or heavier, it was the higher; the shape depends on E/ρ alone.
    young, _, density = (height["slopes"][key] for key in keys)
    assert young < 0 < density
    assert 12e3 * young == pytest.approx(-1000 * density, rel=1e-9)
    fields = pyvista.read(out / "fields" / "deformed.pvd")[0].point_data
    moved = {key: np.asarray(fields[f"d displacement/d {key}"]) for key in keys}
    for key, vectors in moved.items():
        assert np.linalg.norm(vectors, axis=1).max() >= sensitivities["shape"]["largest"][key] * (1 - 1e-12)
    squares = sum((sensitivities["parameters"][key]["sd"] * vectors) ** 2 for key, vectors in moved.items())
    np.testing.assert_allclose(fields["sd"], np.sqrt(squares.sum(axis=1)), rtol=1e-10, atol=1e-15)
