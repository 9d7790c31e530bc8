"""Errors of the given surface: against a closed form, against runs on moved meshes, and the statistics of samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.thick_sphere import INNER, OUTER, PRESSURE
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh import read_source, reorder_to_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import Floats
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.certificate.check import Line, Verdict
from hpcinv.trust.certificate.discretisation import DISCRETISATION
from hpcinv.trust.sensitivity.analysis import sensitivities
from hpcinv.trust.sensitivity.sensitivities import SPREAD
from hpcinv.trust.sensitivity.surface_errors import SurfaceErrors, SurfaceSpreads, surface_normals

WEIGHT = {"effect": "gravity", "density": 150, "density_in": "current"}


def block(**data: Any) -> Job:
    """A block in three states, on straight cells whose interior nodes exist, too."""
    states = [
        {"name": name, "effects": [WEIGHT | {"acceleration": g}]}
        for name, g in (("standing", [0, 0, -9.81]), ("lying", [9.81, 0, 0]))
    ]
    states[0]["given"] = True
    common: dict[str, Any] = {
        "mesh": box((1, 1, 2)),
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "discretisation": {"displacement": 1, "formulation": "displacement"},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "states": states,
        "quantities": [
            {"name": "corner", "of": "displacement", "at": [1, 1, 1]},
            {"name": "volume", "of": "1", "on": "block", "reduce": "integral", "over": "reference"},
        ],
        "certificate": {"level": "off", "surface": True},
    }
    return job(**(common | data))


def test_a_sphere_whose_surfaces_are_off(comm: MPI.Intracomm) -> None:
    """All of the surface out by w: the inner radius smaller, the outer one larger; the planes of symmetry stay."""

    def inner(w: float) -> float:
        a, b = INNER - w, OUTER + w

        def carried(A: float) -> float:  # neo-Hooke, c1 = 0.5
            B = (b**3 - a**3 + A**3) ** (1 / 3)
            g = [0.5 * (4 / stretch + stretch**-4) for stretch in (b / B, a / A)]
            return g[0] - g[1]

        return root(lambda A: carried(A) - PRESSURE, 0.5, 1.0)

    sphere = job(
        mesh={
            "file": "../meshes/thick_sphere.py",
            "parameters": {"inner": INNER, "outer": OUTER, "radial": 2, "along": 2, "hexahedra": True},
            "geometry_degree": 2,
        },
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        quantities=[{"name": "inner", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"}],
    )
    with Workspace(comm) as workspace:
        result = hpcinv.run(sphere, comm, workspace=workspace)
        model = workspace.equations(sphere, result.body, Timings())[0]
        moved = surface_normals(sphere, result.body)
        outward = Parameter("w", "mesh", None, (), 0.0, Dimension(), 1.0)
        slopes = sensitivities(model, result.solutions[0], [outward], mesh={"w": moved}).slopes["inner"]["w"]
    exact = (inner(1e-4) - inner(-1e-4)) / 2e-4
    print(f"dA/dw {slopes:.6f}, exactly {exact:.6f}")
    assert slopes == pytest.approx(exact, rel=1e-2)


@pytest.mark.parallel([1, 3, 2])
def test_shapes_and_quantities_follow_the_nodes_of_the_surface(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """In each state, what a sample is said to change is what runs on moved meshes change."""
    tmp_path = comm.bcast(tmp_path)
    plain = block()
    errors = SurfaceErrors(sd=1e-2, correlation=0.7, samples=2, voxel=0.0)
    with Workspace(comm) as workspace:
        result = hpcinv.run(plain, comm, workspace=workspace)
        body = result.body
        moved = errors.displacements(plain, body)["surface 0"]
        nodes = body.given_nodes
        at = Parameter("w", "mesh", None, (), 0.0, Dimension(), 1.0)
        given, further = workspace.equations(plain, body, Timings())
        first = sensitivities(given, result.solutions[0], [at], mesh={"w": moved})
        second = sensitivities(further, result.solutions[1], [at], (result.solutions[0], first))
    source = read_source(plain.mesh, plain.resolve(plain.mesh.file))
    ends = []
    for step in (-1e-3, 1e-3):
        points = _whole(comm, reorder_to_source(body, nodes + step * moved))
        path = tmp_path / f"{step}.msh"
        on_root(comm, lambda path=path, points=points: save(path, source, points))
        corner = points[np.abs(source.points - 1.0).sum(axis=1).argmin()].tolist()
        quantities = [{**q, "at": corner} if "at" in q else q for q in plain.data["quantities"]]
        ends.append(hpcinv.run(block(mesh={"file": str(path)}, quantities=quantities), comm))
    for name, slopes in (("rest", first), ("lying", second)):
        shapes = [reorder_to_source(end.body, end.shapes[name]) for end in ends]
        whole = [_whole(comm, shape) for shape in shapes]
        expected = (whole[1] - whole[0]) / 2e-3
        nodes_of = _whole(comm, reorder_to_source(body, slopes.nodes["w"]))
        error = np.abs(nodes_of - expected).max() / np.abs(expected).max()
        print(f"{name}: {error:.1e}")
        assert error < 1e-5
        for quantity, by_key in slopes.slopes.items():
            difference = np.subtract(*(np.array(end.quantities[quantity]) for end in ends[::-1])) / 2e-3
            np.testing.assert_allclose(by_key["w"], difference, rtol=1e-4, atol=1e-7, err_msg=quantity)


def _whole(comm: MPI.Intracomm, rows: Floats) -> Floats:
    """The rows of all ranks in the order of the source, on all ranks."""
    return np.concatenate(comm.allgather(rows))


@pytest.mark.release
def test_samples_have_the_covariance_that_is_asked_for(comm: MPI.Intracomm) -> None:
    """Along the normals of a cube's faces: σ² at a point, and exp(-1/2) of it a correlation length away."""
    plain = block(mesh=box((4, 2, 2)))
    errors = SurfaceErrors(sd=2.0, correlation=0.5, samples=3000, voxel=0.0)
    with Workspace(comm) as workspace:
        body = workspace.body(plain)
        samples = np.array(list(errors.displacements(plain, body).values()))
        x = body.mesh.geometry.x * body.length_scale
    places = [np.abs(x - p).sum(axis=1).argmin() for p in ([0.25, 0.5, 1.0], [0.75, 0.5, 1.0])]
    a, b = (samples[:, place, 2] for place in places)
    assert samples[:, places, :2] == pytest.approx(0.0, abs=1e-12)
    # 3000 samples give a variance to 2.6 % of itself; bounds are four times that.
    assert np.var(a) == pytest.approx(4.0, rel=0.11)
    assert np.mean(a * b) == pytest.approx(4.0 * np.exp(-0.5), abs=4.0 * 0.11)
    assert np.mean(a) == pytest.approx(0.0, abs=4 * 2.0 / 3000**0.5)
    inside = np.abs(x - 0.5).max(axis=1) < 0.49
    assert inside.any()
    assert not samples[:, inside].any()


@pytest.mark.release
def test_the_certificate_reports_surface_errors(comm: MPI.Intracomm) -> None:
    known = block(mesh={**box((2, 2, 2)), "surface_error": {"sd": "1 cm", "correlation": 100, "samples": 150}})
    result = hpcinv.run(known, comm)
    lines = [line for line in result.certificate.lines if line.topic == SPREAD]
    assert [line.state for line in lines] == ["standing", "lying"]
    assert "surface known to 10 mm over 100 m; 150 samples, to 6 %" in lines[0].note
    spread = result.statistics["surface_errors"]
    # The whole surface in or out by 1 cm: the volume of a unit cube changes by its area times that, but at the base.
    assert spread["quantities"]["volume-standing"] == pytest.approx(0.05, rel=0.25)
    assert set(spread["shapes"]) == {"rest", "lying"}
    assert spread["shapes"]["rest"]["sd"] == lines[0].value
    off = hpcinv.run(known.with_({"certificate.surface": False}), comm)
    assert off.surface_spread is None


def test_a_mesh_need_not_be_better_than_its_surface(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """A warning of the mesh's error ends where the given surface is known less well."""

    def line(**mesh: Any) -> Line:
        checks = {"level": "quick", "surface": True, "estimate": True}
        weight = [WEIGHT | {"acceleration": [0, 0, -9.81]}]
        plain = block(mesh=box((2, 2, 2)) | mesh, certificate=checks, states=[], effects=weight, quantities=[])
        result = hpcinv.run(plain, comm, directory=tmp_path / f"run-{len(mesh)}")
        return next(line for line in result.certificate.lines if line.topic == DISCRETISATION)

    assert line().verdict is Verdict.WARN
    rough = line(surface_error={"sd": "10 cm", "samples": 4})
    assert rough.verdict is Verdict.PASS
    assert "the given surface is uncertain by" in rough.note
    assert len(list(tmp_path.glob("run-*/summary.h5"))) == 2


def test_contact_with_a_rigid_obstacle_has_no_derivatives(comm: MPI.Intracomm) -> None:
    """A warning says so, and the run goes on."""
    contact = {
        "effect": "contact",
        "region": "z1",
        "obstacle": {"shape": "plane", "point": [0, 0, 1], "normal": [0, 0, -1]},
    }
    pressed = block(
        mesh=box((1, 1, 1)) | {"surface_error": {"sd": "1 mm"}},
        analysis="forward",
        states=[],
        effects=[contact],
        quantities=[],
    )
    with Workspace(comm) as workspace:
        spread = SurfaceSpreads(pressed, workspace.body(pressed)).spread_of([])
    assert spread is not None
    (line,) = spread.lines()
    assert line.verdict is Verdict.SKIPPED
    assert line.note == "there are no derivatives of contact with a rigid obstacle"
    assert spread.as_data()["failure"] == line.note
    assert not spread.fields()
