"""The volume lines of the certificate: what a nearly incompressible material may do, and what shows a coarse mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.thick_sphere import sphere
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.outcome import Outcome
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate import Line, Verdict
from hpcinv.trust.certificate.volume import UNACCOUNTED

INCOMPRESSIBLE = {"law": "neo-hookean", "mu": 1.0, "lam": "incompressible"}

VARYING = {"law": "neo-hookean", "mu": "1 Pa*(1 + X/(100 m))", "lam": 49.0}


def nearly(poisson: float) -> dict[str, Any]:
    return {"law": "neo-hookean", "young": 3.0, "poisson": poisson}


def unaccounted(job: hpcinv.Job, comm: MPI.Intracomm) -> Line | None:
    certificate = hpcinv.run(job, comm).certificate
    lines = [line for line in certificate.lines if line.topic == UNACCOUNTED]
    print(*(f"{line.name} {line.value}" for line in certificate.lines if "volume" in line.name))
    return lines[0] if lines else None


def sheared(material: Any, divisions: int, force: float, *, effects: tuple[Any, ...] = (), **changes: Any) -> Any:
    """A cube that stands on its clamped bottom, pulled sideways at its top."""
    traction = {"effect": "traction", "region": "z1", "area_in": "reference", "traction": [force, 0, 0]}
    return job(
        analysis="forward",
        mesh=box((divisions,) * 3),
        material=material,
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        effects=[traction, *effects],
        certificate=NO_CERTIFICATE,
        **changes,
    )


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(("width", "outcome"), [(0.12, None), (0.3, Outcome.VOLUME_CHANGED)])
def test_volume_that_changes_at_a_point_only_is_physical(
    width: float, outcome: Outcome | None, comm: MPI.Intracomm
) -> None:
    """A cube of 8³ cells with a displacement around one of its nodes; elsewhere it is not deformed."""
    cube = sheared(INCOMPRESSIBLE, 8, 0.0)
    model = Equations(cube, build_body(cube.mesh, cube.regions, comm, resolve=cube.resolve), Timings())
    system = model.equilibrium(model.weak_form("forward")).system
    u, _ = model.unknowns.state.split()

    def around_middle(x: np.ndarray) -> np.ndarray:
        middle = np.array([[0.5], [0.5], [0.5]]) / model.body.length_scale
        distances = np.linalg.norm(x - middle, axis=0) * model.body.length_scale
        size = 0.8 * width * np.exp(-((distances / width) ** 2)) / model.body.length_scale
        return np.stack([size, 0 * size, 0 * size])

    u.interpolate(around_middle)
    model.unknowns.state.x.scatter_forward()
    assert 0 < system.min_mesh_J() < 0.5
    assert system.fault_of_solution() is outcome
    model.destroy()


@pytest.mark.everyday("incompressible")
@pytest.mark.parallel([2, 3, 1])
@pytest.mark.parametrize(
    ("material", "discretisation"),
    [
        (INCOMPRESSIBLE, {}),
        (nearly(0.49), {}),
        (nearly(0.49), {"formulation": "displacement", "displacement": 1}),
        (VARYING, {"formulation": "displacement", "displacement": 1}),
    ],
    ids=["incompressible", "mixed", "linear displacements", "moduli that vary"],
)  # fmt: skip
def test_a_coarse_mesh_changes_volumes_that_cannot_change(
    material: Any, discretisation: dict[str, Any], comm: MPI.Intracomm
) -> None:
    """At single points J is far from 1, while the material can change its volume by 2 % at most."""
    line = unaccounted(sheared(material, 3, 0.5, discretisation=discretisation), comm)
    assert line is not None
    assert line.verdict is Verdict.WARN
    assert "too coarse" in line.note


@pytest.mark.release
def test_good_answers_pass(comm: MPI.Intracomm) -> None:
    for good in (sphere(2, hexahedra=True), sheared(INCOMPRESSIBLE, 3, 0.02), sheared(nearly(0.49), 3, 0.02)):
        line = unaccounted(good, comm)
        assert line is not None
        assert line.verdict is Verdict.PASS
        assert line.value is not None
        assert 0 < line.value < 0.02


def test_a_compressible_material_may_change_its_volume(comm: MPI.Intracomm) -> None:
    assert unaccounted(sheared(nearly(0.3), 2, 0.5), comm) is None


@pytest.mark.release
def test_growth_does_not_count_as_elastic_change_of_volume(comm: MPI.Intracomm) -> None:
    """A free cube that doubles its volume is free of stress."""
    grown = job(
        analysis="forward",
        mesh=box((2, 2, 2)),
        material=INCOMPRESSIBLE,
        effects=[{"effect": "growth", "stretch": 2 ** (1 / 3)}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        certificate=NO_CERTIFICATE,
    )
    line = unaccounted(grown, comm)
    assert line is not None
    assert line.value == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parallel([2, 1])
def test_only_nearly_incompressible_regions_count(comm: MPI.Intracomm) -> None:
    """The soft foam below changes its volume by tens of per cent; what lies on it hardly does."""
    line = unaccounted(
        job(
            analysis="forward",
            mesh=box((2, 2, 4)),
            regions={"below": "z < 0.501 m"},
            material={"below": nearly(0.0) | {"young": 0.3}, "elsewhere": nearly(0.49)},
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
            effects=[{"effect": "traction", "region": "z1", "area_in": "reference", "traction": [0, 0, -0.15]}],
            discretisation={"formulation": "displacement"},
            certificate=NO_CERTIFICATE,
        ),
        comm,
    )
    assert line is not None
    assert line.verdict is Verdict.PASS


def test_a_body_that_swells_too_far_says_where(comm: MPI.Intracomm) -> None:
    """A bar of Poisson's ratio 0, whose volume grows as its length F does: F - 1/F = 12."""
    certificate = hpcinv.run(
        job(
            analysis="forward",
            mesh=box((1, 1, 1)),
            material={"law": "neo-hookean", "young": 1.0, "poisson": 0.0},
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            effects=[{"effect": "traction", "region": "z1", "area_in": "reference", "traction": [0, 0, 6.0]}],
            certificate=NO_CERTIFICATE,
        ),
        comm,
    ).certificate
    (line,) = (line for line in certificate.lines if line.name == "largest volume ratio J")
    assert line.verdict is Verdict.WARN
    assert line.value == pytest.approx(6 + 37**0.5, rel=1e-9)
    assert line.note.startswith("beyond it in 100.00% of the volume, most at (")
