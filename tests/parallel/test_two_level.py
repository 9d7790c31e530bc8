"""The correction in finer spaces by Krylov iterations, against the one by a factorization."""

from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_cube
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.assembly.moduli_at_points import moduli_of_two_rules
from hpcinv.model.assembly.tangent_moduli import UnsupportedForm
from hpcinv.model.spaces import Unknowns
from hpcinv.trust.discretisation import two_level
from hpcinv.trust.discretisation.estimate import Estimate
from hpcinv.trust.discretisation.transfer import Transfer

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
        "mesh": box((2, 2, 2)),
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
    "factors in single precision": standing(solver={"linear": "direct", "petsc": {"pc_precision": "single"}}),
    "kept factors": sphere(
        hexahedra=False, geometry=2, solver={"linear": "direct", "petsc": {"pc_precision": "single"}}
    ),
    "two layers of curved cells": sphere(
        hexahedra=False,
        geometry=2,
        regions={"core": "x*x + y*y + z*z < 1.6", "shell": "x*x + y*y + z*z > 1.5"},
        material={"core": RUBBER, "shell": RUBBER | {"c1": 0.6}},
    ),
    "multigrid": standing(solver={"linear": "iterative"}),
    "prescribed motion": pushed(),
    "follower load": sphere(hexahedra=False, geometry=2, analysis="forward"),
}


def estimate(data: dict[str, Any], comm: MPI.Intracomm) -> Estimate:
    estimated = hpcinv.run(job(certificate=ONLY, **data), comm).estimate
    assert estimated is not None
    return estimated


@pytest.mark.everyday("follower load")
@pytest.mark.parametrize("name", CASES)
def test_the_iterations_find_the_correction(name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(name, comm, monkeypatch)


@pytest.mark.everyday("multigrid")
@pytest.mark.parallel([3, 2])
@pytest.mark.parametrize(
    "name",
    ["sphere of straight tetrahedra", "cubic tetrahedra", "kept factors", "multigrid", "prescribed motion"],
)
def test_iterations_find_the_correction_on_more_ranks(
    name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    estimated = estimate(CASES[name], comm)
    print(name, outcomes, estimated.shape / exact.shape, estimated.quantities["q"], exact.quantities["q"])  # type: ignore[operator]
    assert outcomes == [True]
    assert estimated.shape == pytest.approx(exact.shape, rel=0.2)
    assert estimated.quantities["q"] == pytest.approx(exact.quantities["q"], rel=0.2, abs=0.05 * exact.shape)
    assert estimated.unknowns == exact.unknowns


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_moduli_of_slightly_curved_cells_may_be_extended(
    hexahedra: bool, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """About half of the cells of this sphere are curved, but not by more than the bound."""
    size = {"inner": 1.0, "outer": 1.5, "radial": 1, "along": 3, "hexahedra": hexahedra}
    data = sphere(hexahedra=hexahedra, geometry=2)
    data["mesh"] |= {"parameters": size}
    monkeypatch.setattr(two_level, "MANY", 0.0)
    extended = estimate(data, comm)
    monkeypatch.setattr(two_level, "_STRAIGHT", 0.0)
    together = Mock(wraps=moduli_of_two_rules)
    monkeypatch.setattr(two_level, "moduli_of_two_rules", together)
    evaluated = estimate(data, comm)
    together.assert_called_once()
    monkeypatch.setattr(two_level, "_FEW", 0)
    assert np.array_equal(nodes(estimate(data, comm)), nodes(evaluated))  # by a kernel for each quadrature
    change = np.linalg.norm(nodes(extended) - nodes(evaluated)) / np.linalg.norm(nodes(evaluated))
    assert 0 < change < 0.01  # 0.0018 and 0.0025


def nodes(estimated: Estimate) -> np.ndarray:
    assert estimated.correction is not None
    return estimated.correction.nodes


def test_residuals_without_moduli_are_differentiated(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects of plugins may have no moduli."""

    def none(*_: Any) -> Any:
        raise UnsupportedForm("it has other derivatives")

    monkeypatch.setattr(two_level, "moduli_at_points", none)
    compare("incompressible", comm, monkeypatch)


@pytest.mark.parallel([2, 1])
def test_iterations_that_do_not_converge_are_followed_by_a_factorization(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(two_level, "MANY", np.inf)
    exact = estimate(standing(), comm)
    monkeypatch.setattr(two_level, "MANY", 0.0)
    monkeypatch.setattr(two_level, "_CYCLES", 1)
    estimated = estimate(standing(), comm)
    assert estimated.shape == pytest.approx(exact.shape, rel=1e-6)


STIFF: dict[str, dict[str, Any]] = {
    "fibres": {
        "material": {"law": "transversely-isotropic", "mu": "5 kPa", "k": "200 kPa", "kappa": "30 kPa"},
        "fibres": {"fibre": {"direction": [2 / 3, -1 / 3, 2 / 3], "given_on": "reference"}},
    },
    "nearly incompressible displacements": {
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "490 kPa*z/(1 m)"},
        "discretisation": {"formulation": "displacement"},
    },
}


@pytest.mark.everyday("fibres")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("name", STIFF)
def test_corrections_of_stiff_bodies_are_found_by_a_factorization(
    name: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The iterations would end with half of the correction, or less, in slender bodies."""
    data = standing(**STIFF[name])
    monkeypatch.setattr(two_level, "MANY", np.inf)
    exact = estimate(data, comm)
    monkeypatch.setattr(two_level, "MANY", 0.0)
    assert estimate(data, comm).shape == pytest.approx(exact.shape, rel=1e-6)
    monkeypatch.setattr(two_level, "_STIFFEST", np.inf)
    assert estimate(data, comm).shape != pytest.approx(exact.shape, rel=1e-3)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(
    ("cell", "degrees"), [("tetrahedron", (2, 1)), ("tetrahedron", (3, 2)), ("hexahedron", (1, None))]
)
def test_transfer_interpolates_and_its_transpose_is_one(
    cell: str, degrees: tuple[int, int | None], comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hpcinv.trust.discretisation.transfer._CELLS", 5)
    mesh = create_unit_cube(comm, 3, 2, 2, CellType[cell])
    u, p = degrees
    given, finer = Unknowns(mesh, u, p), Unknowns(mesh, u + 1, None if p is None else p + 1)
    transfer, random = Transfer(given, finer), np.random.default_rng(comm.rank)
    x, r = (level.state.x.petsc_vec.duplicate() for level in (given, finer))
    x.array[:], r.array[:] = random.normal(size=x.local_size), random.normal(size=r.local_size)
    x.copy(given.state.x.petsc_vec)
    given.state.x.scatter_forward()
    for part, of_given in (("displacement", given.displacement()), ("pressure", given.pressure())):
        if of_given is not None:
            of_finer = fem.Function(getattr(finer, f"{part}_space"))
            of_finer.interpolate(of_given)
            getattr(finer, f"set_{part}")(of_finer.x.array)
    expected = finer.state.x.petsc_vec
    assert transfer.interpolate(x.array) == pytest.approx(expected.array, abs=1e-12)
    x_with_transpose = comm.allreduce(float(transfer.restrict(r.array) @ x.array))
    assert x_with_transpose == pytest.approx(expected.dot(r), rel=1e-10)
