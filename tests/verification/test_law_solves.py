"""Every registered law on a mesh: Taylor test of the tangent, homogeneous patch, round trips, on 1 and 2 ranks.

All use the same forms (the law alone, moved by its supports), so that each law is compiled once for a kind of cell.
"""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import LinearProblem
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.physics.materials import laws
from hpcinv.physics.materials.isochoric import IsochoricLaw

DIRECTIONS = [[2 / 3, -1 / 3, 2 / 3], [2 / 3, 2 / 3, -1 / 3], [-1 / 3, 2 / 3, 2 / 3]]
"""Orthonormal directions for as many families of fibres; none that a box would leave at its length by chance."""
F = np.array([[1.1, 0.15, 0.0], [0.05, 0.95, 0.1], [-0.1, 0.0, 1.05]])
PULL = {"region": "z1", "displacement": ["0.1*s*z", "-0.05*s*x", "0.08*s*z"], "constants": {"s": 1}}
HELD = {"region": "z0", "fix": ["x", "y", "z"]}
KINDS = [False, True]  # hexahedra?
# What a law is on hexahedra, the effects and other tests share; each law has kernels of its own there.
on_both_cells = pytest.mark.parametrize(
    "hexahedra", [False, pytest.param(True, marks=pytest.mark.release)], ids=["tetrahedra", "hexahedra"]
)

OFTEN = ("mooney-rivlin", "guccione", "formula")
"""One law of invariants, one with fibres, and one as text; all others take the same path."""
ROUND_TRIPS = [law if law in OFTEN else pytest.param(law, marks=pytest.mark.release) for law in laws()]


def case(law: str, hexahedra: bool, **data: Any) -> Job:
    """The law's example on a box, with the fibres that it names."""
    kind = laws()[law]
    families = kind.model_validate(kind.example).families
    fibres = {
        name: {"direction": direction, "given_on": "reference"}
        for name, direction in zip(families, DIRECTIONS, strict=False)
    }
    return job(
        mesh=box((2, 2, 2), hexahedra=hexahedra),
        fibres=fibres,
        **{
            "material": kind.example,
            "supports": [HELD, PULL],
            "discretisation": {"displacement": 1, "formulation": "displacement"},
        }
        | data,
    )


def linear(h: np.ndarray) -> list[str]:
    """Formulas of ``h x``."""
    return [" + ".join(f"({h[i, j]:.17g})*{x}" for j, x in enumerate("xyz")) for i in range(3)]


def there_and_back(law: str, hexahedra: bool, first: str, comm: MPI.Intracomm) -> tuple[float, float]:
    """Size of the displacement, and of what the second solution does not bring back, relative to it."""
    solved = Solved(case(law, hexahedra, analysis="round_trip", first=first), comm)
    there = solved.model.unknowns.geometry_values(solved.model.unknowns.displacement())
    back = solved.again()
    size, gap = (comm.allreduce(float(abs(d).max()), op=MPI.MAX) for d in (there, back - there))
    return size, gap / size


@pytest.mark.everyday("mooney-rivlin")
@on_both_cells
@pytest.mark.parametrize("law", ROUND_TRIPS)
def test_round_trips_close(law: str, hexahedra: bool, comm: MPI.Intracomm) -> None:
    for first in ("forward", "inverse"):
        size, gap = there_and_back(law, hexahedra, first, comm)
        print(f"{law}, {first} first: gap {gap:.1e}")
        assert size > 0.04  # of the body's diagonal, or nearly so
        assert gap < 1e-10


@pytest.mark.release
@pytest.mark.parallel(2)
@pytest.mark.parametrize("law", laws())
def test_round_trips_close_on_two_ranks(law: str, comm: MPI.Intracomm) -> None:
    for hexahedra in KINDS:
        for first in ("forward", "inverse"):
            _, gap = there_and_back(law, hexahedra, first, comm)
            assert gap < 1e-10


@pytest.mark.everyday("mooney-rivlin-tetrahedra", "st-venant-kirchhoff-tetrahedra")
@on_both_cells
@pytest.mark.parametrize("law", laws())
def test_homogeneous_patch(law: str, hexahedra: bool, comm: MPI.Intracomm) -> None:
    h = np.eye(3) - np.linalg.inv(F)  # u = x - X = h x
    solved = Solved(case(law, hexahedra, supports=[{"region": "boundary", "displacement": linear(h)}]), comm)
    error = solved.relative_error(solved.displacement, solved.constant(h) * solved.x)
    print(f"{law}: {error:.1e}")
    assert error < 1e-12


@pytest.mark.everyday("mooney-rivlin-inverse", "holzapfel-gasser-ogden-forward", "gent-inverse")
@pytest.mark.parametrize("direction", ["forward", "inverse"])
@pytest.mark.parametrize("law", laws())
def test_small_strains_keep_their_digits(law: str, direction: str, comm: MPI.Intracomm) -> None:
    """At strains of 1e-10 the displacement agrees with linear elasticity; with fibres, with the scaled one at 1e-7."""

    def solved(strain: float) -> Solved:
        return Solved(case(law, False, analysis=direction, supports=[HELD, PULL | {"constants": {"s": strain}}]), comm)

    tiny, small = solved(1e-10), solved(1e-7)
    shape, scaled = (s.model.unknowns.state.x.array / s.model.unknowns.state.x.array.max() for s in (tiny, small))
    error = np.linalg.norm(shape - scaled) / np.linalg.norm(scaled)
    print(f"{law}, {direction}: against larger strains {error:.1e}")
    assert error < 1e-6
    kind = laws()[law].model_validate(laws()[law].example)
    if not kind.families:
        u, v = ufl.TrialFunction(tiny.model.unknowns.space), tiny.model.unknowns.v
        (par,) = kind.cases()
        mu, kappa = (modulus(par) / tiny.model.scales.stress for modulus in (kind.shear_modulus, kind.bulk_modulus))
        strain, virtual = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
        form = (2 * mu * ufl.inner(ufl.dev(strain), virtual) + kappa * ufl.tr(strain) * ufl.tr(virtual)) * ufl.dx
        elastic = LinearProblem(
            form,
            ufl.inner(fem.Constant(tiny.body.mesh, np.zeros(3)), v) * ufl.dx,
            bcs=tiny.model.supports.conditions,
            petsc_options_prefix="linear_elasticity_",
            petsc_options={"ksp_type": "preonly", "pc_type": "lu"},
        ).solve()
        error = np.linalg.norm(tiny.model.unknowns.state.x.array - elastic.x.array) / np.linalg.norm(elastic.x.array)
        print(f"{law}, {direction}: against linear elasticity {error:.1e}")
        assert error < 1e-6


SPLIT = [name for name, kind in laws().items() if issubclass(kind, IsochoricLaw)]


@pytest.mark.everyday("guccione")
@pytest.mark.parametrize(
    "law", [law if law in (*OFTEN, "ogden") else pytest.param(law, marks=pytest.mark.release) for law in SPLIT]
)
def test_homogeneous_patch_of_the_nearly_incompressible_form(law: str, comm: MPI.Intracomm) -> None:
    kind = laws()[law].model_validate(laws()[law].example)
    h = np.eye(3) - np.linalg.inv(F / np.linalg.det(F) ** (1 / 3))
    stiff = laws()[law].example | {"kappa": 1e4 * max(kind.shear_modulus(par) for par in kind.cases())}
    solved = Solved(
        case(
            law,
            False,
            material=stiff,
            supports=[{"region": "boundary", "displacement": linear(h)}],
            discretisation={"displacement": 2, "formulation": "mixed"},
        ),
        comm,
    )
    pressure = solved.model.unknowns.pressure()
    assert pressure is not None
    error = solved.relative_error(solved.displacement, solved.constant(h) * solved.x)
    print(f"{law}: {error:.1e}, pressure {abs(pressure.x.array).max():.1e} of the shear modulus or so")
    assert error < 1e-12
    assert abs(pressure.x.array).max() < 1e-9


@pytest.mark.everyday("formula-inverse", "isochoric-neo-hookean-forward", "mooney-rivlin-inverse")
@pytest.mark.parametrize("direction", ["forward", "inverse"])
@pytest.mark.parametrize("law", laws())
def test_the_tangent_is_the_derivative_of_the_residual(law: str, direction: str, comm: MPI.Intracomm) -> None:
    solved = Solved(case(law, False, analysis=direction), comm)
    state, weak_form = solved.model.unknowns.state, solved.weak_form
    residual = fem.form(weak_form.residual)
    trial = ufl.TrialFunction(solved.model.unknowns.space)
    tangent = fem.form(ufl.derivative(weak_form.residual, state, trial))
    start = state.x.array.copy()
    towards = 0.02 * np.random.default_rng(1).uniform(-1, 1, start.size)

    def assembled(step: float) -> Any:
        state.x.array[:] = start + step * towards
        return fem_petsc.assemble_vector(residual).array.copy()

    A = fem_petsc.assemble_matrix(tangent)
    A.assemble()
    x = A.createVecRight()
    x.array[:] = towards
    slope = (A * x).array
    at_start = assembled(0.0)
    steps = [2.0**-n for n in range(3, 9)]
    remainders = [np.linalg.norm(assembled(s) - at_start - s * slope) for s in steps]
    rates = np.diff(np.log(remainders)) / np.diff(np.log(steps))
    print(f"{law}, {direction}: {np.round(rates, 2)}")
    assert rates[-1] == pytest.approx(2.0, abs=0.1)
