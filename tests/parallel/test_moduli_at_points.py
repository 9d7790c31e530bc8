"""Moduli of tangents: files of their programs, and products with vectors."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import ufl
from helpers.verification import box, deform, job
from helpers.without_compiler import without_compiler
from petsc4py import PETSc

from hpcinv.base.parallel import code_cache
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.mesh.cells import quadrature
from hpcinv.model.assembly import tangent_product
from hpcinv.model.assembly.moduli_at_points import moduli_at_points
from hpcinv.model.assembly.system import System
from hpcinv.model.assembly.tangent_moduli import UnsupportedForm
from hpcinv.model.assembly.tangent_product import TangentProduct, extension
from hpcinv.physics.points.integrands import Integrand
from hpcinv.solver.equations import Equations
from hpcinv.trust.discretisation.finer_solid import one_degree_more

MIXED: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": box((3, 2, 2)),
    "material": {"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "1 MPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1000, "density_in": "reference"}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
TWO_REGIONS: dict[str, Any] = MIXED | {
    "regions": {"left": "x < 0.34 m", "right": "x > 0.33 m"},
    "material": {
        "left": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "right": {"law": "neo-hookean", "mu": "20 kPa", "lam": "50 kPa"},
    },
}
CUBES: dict[str, Any] = MIXED | {
    "analysis": "forward",
    "mesh": box((2, 2, 2), hexahedra=True),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
}
ONE_CELL: dict[str, Any] = MIXED | {"mesh": box((1, 1, 1), hexahedra=True)}  # other ranks have none
CUBIC: dict[str, Any] = MIXED | {"mesh": box((2, 1, 1)), "discretisation": {"displacement": 3, "pressure": 2}}


def model_of(data: dict[str, Any], comm: MPI.Intracomm) -> Equations:
    given = job(**data)
    model = Equations(given, build_body(given.mesh, given.regions, comm, resolve=given.resolve), Timings())
    deform(model.unknowns)
    model.weak_form(given.directions[0])
    model.put_load(0.7)
    return model


@pytest.mark.everyday("hexahedra")
@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize(
    "data",
    [MIXED, TWO_REGIONS, CUBES, CUBIC, ONE_CELL],
    ids=["mixed", "regions", "hexahedra", "cubic", "one cell"],
)
def test_products_agree_with_the_matrix(data: dict[str, Any], comm: MPI.Intracomm) -> None:
    """To digits of single precision, in the rows of unknowns that are free."""
    model = model_of(data, comm)
    weak_form, unknowns = model.weak_form(model.job.directions[0]), model.unknowns
    system = System(weak_form, model.supports, Timings())
    system.linearise(0.7)
    x = system.matrix.createVecRight()
    x.array[:] = np.random.default_rng(comm.rank).normal(size=x.local_size)
    held = np.zeros(len(unknowns.state.x.array), dtype=bool)
    for condition in model.supports.conditions:
        held[condition.dof_indices()[0]] = True
    x.array[held[: x.local_size]] = 0.0
    expected = x.duplicate()
    system.matrix.mult(x, expected)
    moduli = moduli_at_points(weak_form.residual, unknowns)
    for compiler in (nullcontext(), without_compiler()):
        with compiler:
            product = TangentProduct(moduli, unknowns, unknowns, model.quadrature_degree)
        products = expected.duplicate()
        products.array[:] = product(np.array(x.array, dtype=np.float32))
        products.array[held[: x.local_size]] = 0.0
        products.axpy(-1.0, expected)
        error = products.norm(PETSc.NormType.INFINITY) / expected.norm(PETSc.NormType.INFINITY)
        print(f"{error:.1e}")
        assert error < 1e-5


@pytest.mark.everyday("mixed-in each product", "hexahedra-beforehand")
@pytest.mark.parallel([1, 3, 2])
@pytest.mark.parametrize("few", [8, 0], ids=["in each product", "beforehand"])
@pytest.mark.parametrize("data", [MIXED, TWO_REGIONS, CUBES], ids=["mixed", "regions", "hexahedra"])
def test_moduli_of_straight_cells_at_rest_serve_finer_spaces(
    data: dict[str, Any], few: int, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are constant in a cell: products agree with the matrix in these spaces, to digits of single precision."""
    monkeypatch.setattr(tangent_product, "_FEW", few)
    model = model_of(data, comm)
    finer = Equations(one_degree_more(model.job), model.body, Timings())
    direction = model.job.directions[0]
    for equations in (model, finer):
        equations.unknowns.state.x.array[:] = 0.0
        equations.weak_form(direction)
        equations.put_load(0.7)
    system = System(finer.weak_form(direction), finer.supports, Timings())
    system.linearise(0.7)
    x, y = system.matrix.createVecs()
    x.array[:] = np.random.default_rng(comm.rank).normal(size=x.local_size)
    held = np.zeros(len(finer.unknowns.state.x.array), dtype=bool)
    for condition in finer.supports.conditions:
        held[condition.dof_indices()[0]] = True
    free = ~held[: x.local_size]
    x.array[~free] = 0.0
    system.matrix.mult(x, y)
    moduli = moduli_at_points(model.weak_form(direction).residual, model.unknowns)
    for compiler in (nullcontext(), without_compiler()):
        with compiler:
            product = TangentProduct(moduli, model.unknowns, finer.unknowns, finer.quadrature_degree)
        products = product(np.array(x.array, dtype=np.float32))
        errors = comm.allgather((np.abs(products - y.array)[free].max(initial=0.0), np.abs(y.array).max(initial=0.0)))
        worst, size = np.max(errors, axis=0)
        print(f"{worst / size:.1e}")
        assert worst < 1e-5 * size


@pytest.mark.parametrize(("kind", "of", "to"), [("tetrahedron", 2, 4), ("tetrahedron", 1, 4), ("hexahedron", 4, 6)])
def test_moduli_are_extended_to_more_points(kind: str, of: int, to: int) -> None:
    """Constants are exact, and so is what fewer points can represent: linear functions, on hexahedra quadratic ones."""
    given, points = (quadrature(kind, degree)[0] for degree in (of, to))
    matrix = extension(kind, given, points)
    assert matrix.sum(axis=1) == pytest.approx(1.0, abs=1e-13)
    if len(given) > 1:
        assert matrix @ given == pytest.approx(points, abs=1e-13)
    if kind == "hexahedron":
        assert matrix @ given**2 == pytest.approx(points**2, abs=1e-13)


def test_moduli_are_refused_for_other_points_than_those_of_the_form(comm: MPI.Intracomm) -> None:
    """As a form of a plugin may have: its tangent would not be the derivative of its residual."""
    unknowns = model_of(CUBIC, comm).unknowns
    u, _ = ufl.split(unknowns.state)
    dx = ufl.Measure("dx", unknowns.mesh, metadata={"quadrature_degree": 4})
    with pytest.raises(UnsupportedForm, match="quadrature"):
        moduli_at_points(ufl.inner(ufl.grad(u), ufl.grad(unknowns.v)) * dx, unknowns)


def damage(directory: Path) -> None:
    for path in directory.glob("points_*.npz"):
        path.write_bytes(path.read_bytes()[:-60] + bytes(60))


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_moduli_are_derived_once(comm: MPI.Intracomm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On rank 0, by region; and again, where their file is damaged or not there any more, or for other points."""
    directory = Path(comm.bcast(str(tmp_path)))
    monkeypatch.setattr(code_cache, "_places", (directory,))
    derive = Mock(side_effect=Integrand.moduli, autospec=True)
    monkeypatch.setattr(Integrand, "moduli", lambda *arguments: derive(*arguments))

    def values(degree: int = 2) -> tuple[int, Any]:
        """How often moduli are derived in a new model, and their values."""
        data = TWO_REGIONS | {"discretisation": {"displacement": 2, "quadrature": degree}}
        before, model = derive.call_count, model_of(data, comm)
        moduli = moduli_at_points(model.weak_form("inverse").residual, model.unknowns)
        count = comm.allreduce(derive.call_count - before)
        return count, [part.kernel.eval(model.unknowns.mesh, part.cells) for part in moduli]

    count, first = values()
    assert count == 2
    changes: list[tuple[int, Callable[[], object]]] = [
        (0, lambda: None),
        (2, lambda: [path.unlink() for path in directory.glob("points_*.npz")]),
        (2, lambda: damage(directory)),
        (0, lambda: None),
    ]
    for expected, change in changes:
        comm.barrier()
        if comm.rank == 0:
            change()
        comm.barrier()
        count, again = values()
        assert count == expected
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    count, finer = values(degree=4)
    assert count == 2
    assert [v.shape[1] for v in finer] == [14, 14]
