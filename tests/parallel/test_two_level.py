"""The correction in finer spaces by Krylov iterations, against the one by a factorization."""

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.certificate import two_level
from hpcinv.certificate.estimate import Estimate
from hpcinv.parallel.runtime import MPI

ONLY = {"level": "off", "estimate": True}
RUBBER = {"law": "mooney-rivlin", "c1": 0.3, "c2": 0.2, "d1": "incompressible"}
SPHERE = {
    "material": RUBBER,
    "effects": [{"effect": "pressure", "region": "inner", "pressure": 0.2}],
    "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
    "quantities": [{"name": "q", "of": "norm(X, Y, Z)", "on": "inner", "reduce": "mean"}],
}


def sphere(*, hexahedra: bool, geometry: int, **changes: Any) -> dict[str, Any]:
    size = {"inner": 1.0, "outer": 1.5, "radial": 2, "along": 2, "hexahedra": hexahedra}
    mesh = {"file": "../meshes/thick_sphere.py", "parameters": size, "geometry_degree": geometry}
    return {"mesh": mesh, **SPHERE, **changes}


def standing(**changes: Any) -> dict[str, Any]:
    """A block on a clamped bottom, whose edges are singular."""
    return {
        "mesh": box((3, 3, 3)),
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 500}],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "quantities": [{"name": "q", "of": "uz", "on": "z1", "reduce": "mean"}],
        **changes,
    }


def pushed() -> dict[str, Any]:
    top = {"region": "z1", "displacement": ["0.05*x*x*x", "0", "-0.1"]}
    return standing(supports=[{"region": "z0", "fix": ["x", "y", "z"]}, top], analysis="forward") | {
        "quantities": [{"name": "q", "of": "uz", "on": "boundary", "reduce": "mean"}]
    }


CASES = {
    "sphere of tetrahedra": sphere(hexahedra=False, geometry=2),
    "sphere of straight tetrahedra": sphere(hexahedra=False, geometry=1),
    "sphere of hexahedra": sphere(hexahedra=True, geometry=2),
    "cubic tetrahedra": sphere(hexahedra=False, geometry=2, discretisation={"displacement": 3, "pressure": 2}),
    "displacement form": standing(),
    "forward": standing(analysis="forward"),
    "linear elements": standing(discretisation={"displacement": 1}),
    "incompressible": standing(material=RUBBER | {"c1": "3 kPa", "c2": "2 kPa"}),
    "multigrid": standing(solver={"linear": "iterative"}),
    "prescribed motion": pushed(),
}


def estimate(data: dict[str, Any], comm: MPI.Intracomm) -> Estimate:
    found = hpcinv.run(job(certificate=ONLY, **data), comm).estimate
    assert found is not None
    return found


@pytest.mark.everyday("sphere of tetrahedra", "incompressible")
@pytest.mark.parametrize("name", CASES)
def test_the_iterations_find_the_correction(name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(name, comm, monkeypatch)


@pytest.mark.parallel([2, 3])
@pytest.mark.parametrize(
    "name", ["sphere of straight tetrahedra", "cubic tetrahedra", "multigrid", "prescribed motion"]
)
def test_they_find_it_on_more_ranks(name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(name, comm, monkeypatch)


def compare(name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two_level, "MANY", np.inf)
    exact = estimate(CASES[name], comm)
    outcomes = []
    correct = two_level.correct

    def recorded(*arguments: Any) -> bool:
        outcomes.append(correct(*arguments))
        return outcomes[-1]

    monkeypatch.setattr(two_level, "MANY", 0.0)
    monkeypatch.setattr(two_level, "correct", recorded)
    found = estimate(CASES[name], comm)
    print(name, outcomes, found.shape / exact.shape, found.quantities["q"], exact.quantities["q"])  # type: ignore[operator]
    assert outcomes == [True]
    assert found.shape == pytest.approx(exact.shape, rel=0.2)
    assert found.quantities["q"] == pytest.approx(exact.quantities["q"], rel=0.2, abs=0.05 * exact.shape)
    assert found.unknowns == exact.unknowns


@pytest.mark.parallel([1, 2])
def test_iterations_that_do_not_converge_are_followed_by_a_factorization(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(two_level, "MANY", np.inf)
    exact = estimate(standing(), comm)
    monkeypatch.setattr(two_level, "MANY", 0.0)
    monkeypatch.setattr(two_level, "_CYCLES", 1)
    found = estimate(standing(), comm)
    assert found.shape == pytest.approx(exact.shape, rel=1e-6)
