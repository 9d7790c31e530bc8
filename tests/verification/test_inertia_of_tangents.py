"""Signs of eigenvalues that factors count, and stability that follows from them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.certificate_cases import line
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job
from petsc4py import PETSc

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.trust.stability import inertia
from hpcinv.trust.stability.inertia import factorize_symmetric


def filled(dense: np.ndarray, comm: MPI.Intracomm) -> PETSc.Mat:
    matrix = PETSc.Mat().createAIJ(dense.shape, comm=comm)
    matrix.setUp()
    begin, end = matrix.getOwnershipRange()
    matrix.setValues(range(begin, end), range(len(dense)), dense[begin:end])
    matrix.assemble()
    return matrix


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(
    "options", [{}, {"rounded": True}, {"rounded": True, "low_rank": True}, {"minimum_fill": True}]
)
def test_inertia_counts_signs_of_eigenvalues(options: dict[str, bool], comm: MPI.Intracomm) -> None:
    random = np.random.default_rng(3)
    dense = random.normal(size=(30, 30))
    dense = dense + dense.T + 1e-3 * random.normal(size=(30, 30))
    values = np.linalg.eigvalsh((dense + dense.T) / 2)
    factors = factorize_symmetric(filled(dense, comm), **options)
    assert factors is not None
    signs = factors.inertia
    assert (signs.negative, signs.zero, signs.positive) == ((values < 0).sum(), 0, (values > 0).sum())
    # Estimated by one random vector.
    assert signs.asymmetry == pytest.approx(np.linalg.norm(dense - dense.T) / 2 / np.linalg.norm(dense), rel=0.5)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("least", [1e-10, -1e-10])
@pytest.mark.parametrize("low_rank", [False, True])
def test_rounded_factors_do_not_change_the_sign_of_a_small_eigenvalue(
    low_rank: bool, least: float, comm: MPI.Intracomm
) -> None:
    directions, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(30, 30)))
    values = np.concatenate([[least], np.linspace(1.0, 2.0, 29)])
    factors = factorize_symmetric(filled(directions * values @ directions.T, comm), rounded=True, low_rank=low_rank)
    assert factors is not None
    assert factors.inertia.negative == (least < 0)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_factors_of_a_forward_solve_give_its_inertia(comm: MPI.Intracomm) -> None:
    """Of a block that is squeezed to half its height, and may then bulge to either side."""
    column_job = job(
        analysis="forward",
        mesh=box((2, 2, 6), lz=3.0),
        material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -1.5]}],
        solver={"linear": "direct"},
        certificate=NO_CERTIFICATE,
    )
    model = Equations(
        column_job, build_body(column_job.mesh, column_job.regions, comm, resolve=column_job.resolve), Timings()
    )
    equilibrium = model.equilibrium(model.weak_form("forward"))
    assert list(EquilibriumPath(equilibrium, 1e-8).follow(model.steps))[-1].outcome.accepted
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    kept = equilibrium.linear.symmetric_factors
    assert kept is not None
    again = factorize_symmetric(equilibrium.system.matrix)
    assert again is not None
    print(f"{comm.size} rank(s): {kept.getFactorMatrix().getInertia()}, {again.inertia}")
    assert kept.getFactorMatrix().getInertia() == (again.inertia.negative, again.inertia.zero, again.inertia.positive)
    assert again.inertia.negative > 0
    again.destroy()
    equilibrium.destroy()


@pytest.mark.everyday("inverse-pressure")
@pytest.mark.parallel([3, 2, 1])
@pytest.mark.parametrize(
    ("analysis", "load"), [("inverse", "gravity"), ("inverse", "pressure"), ("forward", "pressure")]
)
def test_factors_of_nearly_symmetric_tangents_serve_the_certificate(
    analysis: str, load: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inertia, round trip and solution agree with factors of the forward tangent."""
    loads: dict[str, dict[str, object]] = {
        "gravity": {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 30},
        "pressure": {"effect": "pressure", "region": "x1", "pressure": 300},
    }
    made = []
    factorized = inertia._factorized

    def recorded(*arguments: Any) -> PETSc.PC | None:
        made.append(arguments)
        return factorized(*arguments)

    def run(petsc: dict[str, object]) -> Result:
        made.clear()
        return hpcinv.run(
            job(
                analysis=analysis,
                mesh=box((3, 3, 3)) | {"geometry_degree": 2},
                material={"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "1 MPa"},
                effects=[loads[load]],
                supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
                solver={"linear": "direct", "petsc": petsc},
                certificate=NO_CERTIFICATE | {"stability": True, "round_trip": "near"},
            ),
            comm,
        )

    monkeypatch.setattr(inertia, "_factorized", recorded)
    exact = run({})
    single = run({"pc_precision": "single"})
    assert not made
    for result in (exact, single):
        assert line(result, "stability").value == 0
        assert line(result, "round trip").value == pytest.approx(0, abs=1e-9)
    assert single.solutions[0].u == pytest.approx(exact.solutions[0].u, abs=1e-9)
