"""Identification of parameters with the rest shape: closed forms, synthetic scans, confidence, and what is free."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT
from helpers.verification import box

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import JobError, MeshError, OutputError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.identification_report import identifiability, warnings
from hpcinv.studies.identification.identification_run import Identified, identify
from hpcinv.studies.identification.shares import StateShare, shares_of, teams_of

TRUE = {"material.mu": 9e3, "material.lam": 30e3}
MARKS = [(1.0, 1.0, 1.0), (0.0, 1.0, 1.0), (0.5, 1.0, 0.5)]


def weight(*acceleration: float, density: float = 150.0) -> list[dict[str, Any]]:
    gravity = {"effect": "gravity", "acceleration": list(acceleration), "density": density, "density_in": "current"}
    return [gravity]


def block(divisions: tuple[int, int, int]) -> dict[str, Any]:
    return box(divisions) | {"file": str(ROOT / "meshes" / "box.py"), "geometry_degree": 2}


BLOCK: dict[str, Any] = {
    "mesh": block((1, 1, 1)),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "discretisation": {"displacement": 2, "formulation": "displacement"},
    "certificate": NO_CERTIFICATE,
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "states": [
        {"name": "standing", "given": True, "effects": weight(0, 0, -9.81)},
        {"name": "hanging", "effects": weight(0, 0, 9.81)},
        {"name": "lying", "effects": weight(9.81, 0, 0)},
    ],
    "quantities": [
        {"name": "top", "of": "uz", "at": [0.5, 0.5, 1]},
        {"name": "corner", "of": "displacement", "at": [1, 1, 1]},
        {"name": "volume", "of": "1", "on": "block", "reduce": "integral", "over": "current", "state": "lying"},
    ],
}


def job(path: Path = ROOT / "tests" / "job.yaml", **data: Any) -> Job:
    return parse({**BLOCK, **data}, path)


def true_values(comm: MPI.Intracomm, workspace: Workspace) -> dict[str, Any]:
    result = hpcinv.run(job(material={"law": "neo-hookean", "mu": 9e3, "lam": 30e3}), comm, workspace=workspace)
    return dict(result.quantities)


def section(parameters: dict[str, Any], values: dict[str, Any], sd: dict[str, float]) -> dict[str, Any]:
    """Observed quantities."""
    observed = [{"name": name, "quantity": name, "value": values[name], "sd": sd[name]} for name in sd]
    return {"parameters": parameters, "observations": observed}


@pytest.mark.release
def test_a_sphere_at_two_pressures(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """Given at one pressure, its inner radius ``a`` at another one gives its modulus, by a closed form."""

    def pressure(A: float, a: float) -> float:  # over 2 c1, incompressible neo-Hooke; 1 and 1.5 are given radii
        B, b = ((A**3 + 1.5**3 - 1) ** (1 / 3), (a**3 + 1.5**3 - 1) ** (1 / 3))
        g = [2 / stretch + stretch**-4 / 2 for stretch in (b / B, a / A)]
        return g[0] - g[1]

    def radius(c1: float) -> float:
        A = root(lambda A: 2 * c1 * pressure(A, 1.0) - 0.2, 0.5, 1.0)
        return root(lambda a: 2 * c1 * pressure(A, a) - 0.4, 1.0, 1.3)

    mesh = {"inner": 1.0, "outer": 1.5, "radial": 2, "along": 2, "hexahedra": True}

    def inflated(by: float) -> list[dict[str, Any]]:
        return [{"effect": "pressure", "region": "inner", "pressure": by}]

    sphere = {
        "mesh": {"file": str(ROOT / "meshes" / "thick_sphere.py"), "parameters": mesh, "geometry_degree": 2},
        "material": {"law": "mooney-rivlin", "c1": 0.6, "c2": 0.0, "d1": "incompressible"},
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "states": [
            {"name": "scan", "given": True, "effects": inflated(0.2)},
            {"name": "fuller", "effects": inflated(0.4)},
        ],
        "quantities": [{"name": "a", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean", "state": "fuller"}],
        "certificate": NO_CERTIFICATE,
    }
    by_radius = section({"material.c1": None}, {"a": radius(0.5)}, {"a": 1e-3})
    # Points of the outer surface, whose facets are large and curved.
    random = np.random.default_rng(2)
    directions = np.abs(random.standard_normal((200, 3)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    outer = (radius(0.5) ** 3 + 1.5**3 - 1) ** (1 / 3) + 2e-3 * random.standard_normal((200, 1))
    (tmp_path / "cloud.csv").write_text("\n".join(",".join(map(str, point)) for point in outer * directions))
    cloud = {"name": "cloud", "state": "fuller", "surface": "cloud.csv", "on": "outer", "sd": 2e-3}
    by_surface = {"parameters": {"material.c1": None}, "observations": [cloud]}

    with Workspace(comm) as workspace:

        def found(observed: dict[str, Any]) -> Any:
            return identify(parse(sphere | {"identify": observed}, tmp_path / "job.yaml"), comm, workspace=workspace)

        single = found(by_radius).estimate
        slope = (radius(0.5 + 1e-5) - radius(0.5 - 1e-5)) / 2e-5
        print(f"c1 {single.values[0]}, sd {single.deviations[0]}, exact {1e-3 / abs(slope)}")
        assert single.values[0] == pytest.approx(0.5, rel=5e-4)
        assert single.deviations[0] == pytest.approx(1e-3 / abs(slope), rel=1e-3)
        other = found(by_surface).estimate
        print(f"c1 {other.values[0]}, sd {other.deviations[0]}, probability {other.probability}")
        assert abs(other.values[0] - 0.5) < 3.5 * other.deviations[0]
        assert other.deviations[0] < 1e-3
        assert other.probability is not None
        assert other.probability > 1e-3


@pytest.mark.parallel([1, 2])
def test_three_synthetic_scans(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """Two moduli from a mesh, points of a surface and landmarks, all with noise, on any number of ranks."""
    tmp_path = comm.bcast(tmp_path)
    with Workspace(comm) as workspace:
        material = {"law": "neo-hookean", "mu": 9e3, "lam": 30e3}
        truth = hpcinv.run(job(material=material), comm, directory=tmp_path / "truth", workspace=workspace)
        sd = 2e-3

        def write() -> list[list[list[float]]]:
            random = np.random.default_rng(3)
            sources = {
                s: read_source(
                    truth.job.mesh.model_copy(
                        update={"file": str(tmp_path / "truth" / f"shape-{s}.msh"), "parameters": {}}
                    ),
                    tmp_path / "truth" / f"shape-{s}.msh",
                )
                for s in ("hanging", "lying")
            }
            hanging, lying = sources["hanging"], sources["lying"]
            noisy = [state.points + sd * random.standard_normal(state.points.shape) for state in (hanging, lying)]
            save(tmp_path / "hanging.msh", hanging, noisy[0])
            given = read_source(truth.job.mesh, truth.job.resolve(truth.job.mesh.file)).points
            on_top = noisy[1][given[:, 2] > 0.999]
            lines = ["x [mm], y [mm], z [mm]", *(", ".join(f"{1e3 * c:.6f}" for c in point) for point in on_top)]
            (tmp_path / "top.csv").write_text("\n".join(lines))
            rows = [int(np.abs(given - mark).sum(axis=1).argmin()) for mark in MARKS]
            return [[list(given[row]), noisy[1][row].tolist()] for row in rows]

        marks = on_root(comm, write)
        observations = [
            {"name": "mesh", "state": "hanging", "mesh": "hanging.msh", "sd": "2 mm"},
            {"name": "surface", "state": "lying", "surface": "top.csv", "on": "z1", "unit": "mm", "sd": "2 mm"},
            {
                "name": "marks",
                "state": "lying",
                "landmarks": [{"at": a, "observed": o} for a, o in marks],
                "sd": "2 mm",
            },
        ]
        parameters = {
            "material.mu": {"start": "9.5 kPa"},
            "material.lam": {"start": "32 kPa", "bounds": ["1 kPa", None]},
        }
        for observed in (observations[:1], observations) if comm.size == 1 else (observations,):
            identified = identify(
                job(tmp_path / "job.yaml", identify={"parameters": parameters, "observations": observed}),
                comm,
                workspace=workspace,
            )
            check_scans(identified, len(observed))
        if comm.size > 1:
            started = zip(parameters.items(), identified.estimate.values, strict=True)
            near: Any = {key: content | {"start": 1.01 * float(value)} for (key, content), value in started}
            other = job(tmp_path / "job.yaml", identify={"parameters": near, "observations": observed})
            teams = identify(other, comm, ranks_per_state=1).estimate
            assert teams.history[-1] == pytest.approx(identified.estimate.history[-1], rel=1e-3)
            np.testing.assert_allclose(teams.values, identified.estimate.values, rtol=1e-4)
            np.testing.assert_allclose(teams.covariance, identified.estimate.covariance, rtol=1e-3)


def test_shares_of_states() -> None:
    """States that begin at one another stay together; numbers and observations of states go where these are."""
    turned = {"name": "turned", "effects": weight(0, 9.81, 0), "start": "lying"}
    given, *further = BLOCK["states"]
    marks = [{"at": [1, 1, 1], "observed": [1, 1, 1]}]
    observed = [{"name": s, "state": s, "landmarks": marks, "sd": 1} for s in ("free", "hanging", "turned")]
    observed.append({"name": "volume", "quantity": "volume", "value": 1.0, "sd": 1.0})
    whole = job(
        states=[given, {"name": "free"}, *further, turned],
        sensitivities={
            "material.mu": None,
            "states[0].effects[0].density": {"also": ["states[2].effects[0].density"]},
            "states[3].effects[0].density": {"also": ["states[4].effects[0].density"]},
        },
        identify={"parameters": {"material.mu": None}, "observations": observed},
    )
    assert whole.identify is not None
    with pytest.raises(OutputError, match="3 teams of ranks, but 2 further states"):
        shares_of(whole, 3)
    with pytest.raises(OutputError, match="5 ranks cannot be divided into teams"):
        teams_of(5, 2)
    parts = []
    for i, share in enumerate(shares_of(whole, teams_of(6, 3))):
        part = share.job(whole.with_({"identify": None}))
        names = [
            observation.name for observation in whole.identify.observations if share.has(observation, first=i == 0)
        ]
        keys = {p.key: [t.key for t in p.ties] for p in part.differentiated}
        parts.append(([state.name for state in part.states], names, [q.name for q in part.quantities], keys))
    density = "states[{}].effects[0].density".format
    for share in shares_of(whole, 2):  # a number that is scaled stands for the parameter where that is not
        heavier = whole.with_(
            {"identify": None, density(2): 300.0, "sensitivities": {density(3): {"scale": [density(2)]}}}
        )
        (number,) = heavier.differentiated
        own = share.number(number)
        assert own is not None
        assert (own.key, own.ratio) == ((density(2), 1.0) if 3 in (share.states or ()) else (density(2), 2.0))
        assert [p.key for p in share.job(heavier).differentiated] == [density(2)]
    assert parts == [
        (
            ["standing", "free", "lying", "turned"],
            ["free", "turned", "volume"],
            [f"{name}-{state}" for name in ("top", "corner") for state in ("standing", "lying", "turned")] + ["volume"],
            {"material.mu": [], density(0): [], density(2): [density(3)]},
        ),
        (
            ["standing", "free", "hanging"],
            ["hanging"],
            [f"{name}-{state}" for name in ("top", "corner") for state in ("standing", "hanging")],
            {"material.mu": [], density(0): [density(2)]},
        ),
    ]
    assert [share.job(whole) is whole for share in shares_of(whole, 1)] == [True]


def check_scans(identified: Identified, scans: int) -> None:
    estimated = identified.estimate
    deviations = [
        (value - true) / sd
        for value, true, sd in zip(estimated.values, TRUE.values(), estimated.deviations, strict=True)
    ]
    print(
        f"{1 + scans} scans: {estimated.values}, sd {estimated.deviations}, errors {deviations},"
        f" chi² {estimated.chi_squared}"
    )
    assert max(map(abs, deviations)) < 3.5
    assert estimated.probability is not None
    assert 1e-3 < estimated.probability < 1 - 1e-3
    assert not warnings(estimated)
    assert len(estimated.history) < 12
    # The rest shape agrees with the true material's, to about its standard deviation.
    assert 0 < identified.shape_deviations["rest"] < 0.02


def test_derivatives_of_all_kinds_of_observations(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """What is predicted for landmarks, nodes and points of surfaces moves as its derivatives say."""
    from hpcinv.studies.identification.job_evaluation import Evaluations

    given = read_source(job().mesh, job().resolve(job().mesh.file))
    rng = np.random.default_rng(1)
    save(tmp_path / "seen.msh", given, given.points + 0.1 * rng.standard_normal(given.points.shape))
    points = np.concatenate([rng.random((20, 2)), np.full((20, 1), 1.1)], axis=1) * 0.9 + 0.05
    (tmp_path / "points.csv").write_text("\n".join(",".join(map(str, point)) for point in points))
    line = [[0.3, 0.4, 0.6], [0.3, 0.4, 0.2], [0.7, 0.4, 0.2]]
    observations = [
        {"name": "mesh", "state": "hanging", "mesh": "seen.msh", "sd": 1.0},
        {"name": "surface", "state": "lying", "surface": "points.csv", "sd": 1.0},
        {"name": "marks", "state": "rest", "landmarks": [{"at": at, "observed": [0, 0, 0]} for at in line], "sd": 1.0},
        {"name": "strain", "state": "rest", "strains": [{"line": line, "strain": 0.1}], "sd": 1.0},
        {"name": "corner", "quantity": "corner-hanging", "value": [0, 0, 0], "sd": 1.0},
        {"name": "volume", "quantity": "volume", "value": 1.0, "sd": 1.0},
    ]
    ties = {"states[0].effects[0].density": {"also": [f"states[{i}].effects[0].density" for i in (1, 2)]}}
    both = job(
        tmp_path / "job.yaml",
        identify={"parameters": {"material.mu": None} | ties, "observations": observations, "given_sd": 2.0},
    )
    with Workspace(comm) as workspace:
        evaluations = Evaluations(both, comm, workspace, StateShare(both), None, lambda: False)
        at = np.array([10e3, 150.0])
        base = evaluations.evaluate(at)
        assert base is not None
        # The deviation of the given mesh is added to the deviation of positions.
        assert [observation.deviation for observation in evaluations.observed] == pytest.approx(
            [*3 * [5**0.5], 1.0, 1.0, 1.0]
        )
        first = sum(observation.count for observation in evaluations.observed[:2])
        marks, strain = base.differences[first : first + 9].reshape(3, 3), base.differences[first + 9]
        assert strain + 0.1 == pytest.approx(np.linalg.norm(np.diff(marks, axis=0), axis=1).sum() / 0.8 - 1)
        for i, step in enumerate(1e-3 * at):
            shift = np.eye(2)[i] * step
            ahead, behind = evaluations.evaluate(at + shift), evaluations.evaluate(at - shift)
            assert ahead is not None
            assert behind is not None
            expected = (ahead.differences - behind.differences) / (2 * step)
            error = np.abs(base.jacobian[:, i] - expected).max() / np.abs(expected).max()
            print(f"parameter {i}: {error:.1e}")
            assert error < 1e-5


def test_weight_alone_determines_the_modulus_over_the_density_only(comm: MPI.Intracomm) -> None:
    """A body under two further directions of gravity: twice its moduli and its mass, and nothing moves."""
    with Workspace(comm) as workspace:
        values = true_values(comm, workspace)
        states = [f"states[{i}].effects[0].density" for i in range(3)]
        parameters = {"material.mu": None, states[0]: {"also": states[1:]}}
        material = {"law": "neo-hookean", "mu": 9e3, "lam": 30e3}
        proportional = {"material.young": None, states[0]: {"also": states[1:]}}
        young = {"law": "neo-hookean", "young": "24 kPa", "poisson": 30 / (2 * 39)}
        observed = section(proportional, values, {"top-hanging": 1e-3, "corner-lying": 1e-3})
        free = identify(job(material=young, identify=observed), comm, workspace=workspace).estimate
        texts = identifiability(free)
        print("\n".join(texts))
        ratio = free.values[0] / free.values[1]
        exact = TRUE["material.mu"] * (3 * 30 + 2 * 9) / (30 + 9) / 150.0
        assert ratio == pytest.approx(exact, rel=1e-6)
        assert free.deviations == [None, None]
        vague = free.combinations[-1]
        assert vague.vector[0] == pytest.approx(vague.vector[1], rel=1e-5)
        assert not np.isfinite(vague.deviation)
        assert texts[0].startswith(f"determined: material.young · {states[0]}^-1 to ") or texts[0].startswith(
            f"determined: material.young^-1 · {states[0]} to "
        )
        assert "not determined: to multiply material.young by f and states[0].effects[0].density by f" in texts[1]
        assert any("do not determine material.young and states" in text for text in warnings(free))
        # A prior of the density determines both, with its relative standard deviation.
        observed["parameters"][states[0]] = observed["parameters"][states[0]] | {"prior": {"sd": "3 kg/m^3"}}
        known = identify(job(material=young, identify=observed), comm, workspace=workspace).estimate
        assert known.values == pytest.approx([150 * exact, 150.0], rel=1e-5)
        assert known.deviations[1] == pytest.approx(3.0, rel=1e-3)
        assert known.deviations[0] == pytest.approx(np.hypot(0.02, texts_deviation(known)) * 150 * exact, rel=0.02)
        # With a fixed other modulus the weight does determine both.
        other = section(parameters, values, {"top-hanging": 1e-3, "corner-lying": 1e-3})
        assert (
            None not in identify(job(material=material, identify=other), comm, workspace=workspace).estimate.deviations
        )


def texts_deviation(estimated: Any) -> float:
    """Relative standard deviation of the ratio that is determined."""
    combination = estimated.combinations[0]
    return float(combination.deviation / np.abs(combination.vector).max())


def test_undetermined_parameters_are_refused(comm: MPI.Intracomm) -> None:
    with Workspace(comm) as workspace:

        def refused(parameters: dict[str, Any], message: str, **observed: Any) -> None:
            values = {"top-hanging": 0.05, "top-standing": 0.0}
            with pytest.raises(JobError, match=message):
                identify(job(identify=section(parameters, values, observed)), comm, workspace=workspace)

        three = {"material.mu": None, "material.lam": None, "states[1].effects[0].density": None}
        refused(three, "3 parameters are more than the 1 observed numbers and 0 priors", **{"top-hanging": 1e-3})
        density = {"states[1].effects[0].density": None}
        refused(
            density, r"nothing that was observed depends on states\[1\].effects\[0\].density", **{"top-standing": 1e-3}
        )


def test_observations_that_do_not_fit_the_mesh(comm: MPI.Intracomm, tmp_path: Path) -> None:
    source = read_source(job().mesh, job().resolve(job().mesh.file))
    other = job(mesh=block((2, 1, 1)))
    save(tmp_path / "other.msh", *(lambda s: (s, s.points))(read_source(other.mesh, other.resolve(other.mesh.file))))
    (tmp_path / "mm.csv").write_text("x,y,z\n" + "\n".join(",".join(map(str, 1e3 * p)) for p in source.points))
    (tmp_path / "bad.csv").write_text("0,0,1\n0,0,one\n")
    marks = [{"at": [0, 0, 3], "observed": [0, 0, 0]}]
    faults: list[tuple[dict[str, Any], str]] = [
        ({"mesh": "other.msh"}, r"job.yaml: identify.observations\[0\] \(seen\): .*nodes, but the job's mesh has"),
        ({"surface": "mm.csv"}, r"extend over .* m, and the body over 1.73 m"),
        ({"surface": "bad.csv"}, r"bad.csv: line 2: 'one' is not a number"),
        ({"landmarks": marks}, r"landmark 0: its position \(0, 0, 3\) m in the given mesh is outside"),
        ({"strains": [LINE | {"line": [[0, 0, 0], [0, 0, 3]]}], "sd": 0.01}, r"strains\[0\]: point 1 \(0, 0, 3\) m"),
        ({"surface": "mm.csv", "unit": "mm", "on": "top"}, "no region 'top'"),
    ]
    for changes, message in faults:
        observations = [{"name": "seen", "state": "hanging", "sd": "1 mm"} | changes]
        seeking = {"parameters": {"material.mu": None}, "observations": observations}
        with pytest.raises(MeshError, match=message):
            identify(job(tmp_path / "job.yaml", identify=seeking), comm)


@pytest.mark.release
def test_regions_of_confidence_hold_the_true_parameters_as_often_as_they_say(comm: MPI.Intracomm) -> None:
    """100 repeats with new noise: two moduli from two further states, all with real solves."""
    random, inside, pulls = np.random.default_rng(11), 0, []
    sd = dict.fromkeys(("top-hanging", "corner-hanging", "corner-lying", "volume"), 1e-3)
    with Workspace(comm) as workspace:
        exact = true_values(comm, workspace)
        for _ in range(100):
            noisy = {
                n: (np.array(exact[n]) + s * random.standard_normal(np.shape(exact[n]))).tolist() for n, s in sd.items()
            }
            observed = section(dict.fromkeys(TRUE), noisy, sd)
            estimated = identify(job(identify=observed), comm, workspace=workspace).estimate
            error = estimated.values - np.array([*TRUE.values()])
            pulls.append(error / np.sqrt(np.diag(estimated.covariance)))
            inside += float(error @ np.linalg.solve(estimated.covariance, error)) < 5.991
    print(f"95 % regions hold the true values in {inside} of 100; pulls {np.std(pulls, axis=0)}")
    assert 88 <= inside <= 100


NEEDED: dict[str, Any] = section({"material.mu": None}, {"volume": 1.0}, {"volume": 0.01})


def changed(change: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    import copy

    changed_content = copy.deepcopy(NEEDED)
    change(changed_content)
    return changed_content


def parameter(**content: Any) -> dict[str, Any]:
    return changed(lambda s: s["parameters"].update({"material.mu": content}))


def observation(**content: Any) -> dict[str, Any]:
    return changed(lambda s: s["observations"].__setitem__(0, {"name": "one", "sd": "1 mm", **content}))


MARK = [{"at": [0, 0, 1], "observed": [0, 0, 1]}]
LINE = {"line": [[0, 0, 0], [0, 0, 1]], "strain": 0.1}


@pytest.mark.parametrize(
    ("identification", "message"),
    [
        (changed(lambda s: s.update(parameters={})), "identify.parameters: must name one number"),
        (changed(lambda s: s.update(parameters={"material.nu": None})), "material.nu is not a number of a law"),
        (changed(lambda s: s.update(observations=[])), "one scan by itself fixes no material"),
        (parameter(start="3 kg"), "material.mu.start: must be a stress, as material.mu is, but it is a mass"),
        (parameter(start="3 kg", bounds=["20 kPa", None]), "material.mu.start: must be a stress"),
        (parameter(bounds=["20 kPa", "10 kPa"]), "bounds: must be the least and the largest value"),
        (parameter(bounds=["20 kPa", None]), "the starting value 10000 .SI. must be within the bounds"),
        (parameter(prior={"sd": 0}), "prior.sd: must be above 0"),
        (parameter(also=["material.mu"]), "material.mu is duplicated"),
        (
            parameter(also=["states[0].effects[0].density"]),
            r"also.0.: states.0..effects.0..density is a density, but material.mu is a stress",
        ),
        (observation(quantity="volume", value="1 m^3", state="lying"), "state: is not valid with a quantity"),
        (observation(quantity="grip[2]", value=1.0), "'grip.2.' is a component: give 'quantity: grip'"),
        (observation(quantity="volumes", value=1.0), "there is no quantity 'volumes'. Did you mean 'volume'"),
        (observation(quantity="top-lying", value="1 kg"), "value: must be a length"),
        (observation(quantity="corner-lying", value=1.0), "value: must be a list of 3 lengths"),
        (observation(quantity="volume"), "value: is needed, and valid, with a quantity"),
        (observation(landmarks=MARK), "state: is needed: one of hanging, lying, rest"),
        (observation(landmarks=MARK, state="standing"), "'standing' is the given state, which is the mesh itself"),
        (observation(landmarks=MARK, state="lyin"), "there is no computed state 'lyin'. Did you mean 'lying'"),
        (observation(landmarks=MARK, state="lying", sd="1 kPa"), "sd: must be a length"),
        (observation(landmarks=MARK, state="lying", mesh="a.msh"), "needs exactly one of mesh, surface, landmarks"),
        (observation(strains=[LINE], state="lying", sd="1 mm"), "sd: must be a number, as strains are"),
        (observation(strains=[LINE | {"strain": -1.1}], state="lying"), "strain: must be above -1"),
        (
            observation(strains=[LINE | {"line": [[0, 0, 0]]}], state="lying", sd=0.01),
            "line: must have two points at least",
        ),
        (observation(mesh="no.msh", state="lying"), "there is no file"),
        (observation(surface="no.step", state="lying"), "'no.step' must end in"),
    ],
)
def test_bad_sections_are_refused_with_one_message(identification: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message) as caught:
        job(identify=identification)
    assert len(caught.value.problems) == 1
