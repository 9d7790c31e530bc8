"""Gradients that are derived once in a process and inserted for each further body."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube
from ufl.algorithms import expand_derivatives

from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.kinematics import kept_gradients, staged_derivatives
from hpcinv.physics.kinematics.kept_gradients import kept_gradient
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages


def strain(H: Any) -> Any:
    """Return a stage of a stage, whose derivatives have equal formulas with equal indices."""
    for _ in range(2):
        H = ufl.variable(ufl.sym(H) + H.T * H / 2)
    return H


class Energy:
    """A scalar of ``H`` with a constant, a function's gradient and a coordinate of a body of its own."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
        self.at = fem.Constant(self.mesh, random.normal(scale=0.3, size=(3, 3)))
        self.H = ufl.variable(self.at)
        c = fem.Constant(self.mesh, random.uniform(1, 2, size=2))
        f = fem.Function(fem.functionspace(self.mesh, ("P", 1)))
        f.x.array[:] = random.normal(size=len(f.x.array))
        a, x = ufl.grad(f), ufl.SpatialCoordinate(self.mesh)
        E = strain(self.H)
        stretch = ufl.variable(ufl.inner(a, E * a))
        self.psi = c[0] * ufl.exp(stretch) + x[1] * ufl.inner(E, E) ** (3 / 2) + c[1] * ufl.det(self.H) * ufl.tr(E)

    def values(self, expression: Any) -> Any:
        entries = ufl.as_vector([expression[at] for at in np.ndindex(3, 3)])
        compiled = fem.Expression(remove_stages(entries), np.full((1, 3), 0.25))
        return compiled.eval(self.mesh, np.zeros(1, dtype=np.int32)).reshape(3, 3)

    def expected(self) -> Any:
        symbol = ufl.variable(self.at)
        plain = ufl.replace(remove_stages(self.psi), {self.at: symbol})
        return self.values(expand_derivatives(ufl.diff(plain, symbol)))


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> OrderedDict[Any, Any]:
    """The gradients that are kept, none at first."""
    empty = OrderedDict[Any, Any]()
    monkeypatch.setattr(kept_gradients, "_kept", empty)
    return empty


@pytest.mark.release
@pytest.mark.usefixtures("kept")
def test_bodies_of_one_law_share_a_derivation() -> None:
    derived = []

    def derive(scalar: Any, variable: Any) -> Any:
        derived.append(scalar)
        return staged_derivatives._derived(scalar, variable)

    for seed in (1, 2):
        energy = Energy(seed)
        expected = energy.expected()
        values = energy.values(kept_gradient(energy.psi, energy.H, derive))
        assert np.abs(values - expected).max() < 1e-13 * np.abs(expected).max()
    assert len(derived) == 1
    assert not {part for scalar in derived for part in ufl.domain.extract_domains(scalar)} & {energy.mesh.ufl_domain()}


def test_gradients_of_other_formulas_are_derived(kept: OrderedDict[Any, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Exponents and the tensors that are contracted are part of a formula, not data of a body."""
    energy = Energy(3)
    E, a = strain(energy.H), fem.Constant(energy.mesh, np.eye(3))
    scalars = [
        *(ufl.tr(E) ** n for n in (2, 3)),
        *(ufl.inner(E, t) for t in (ufl.Identity(3), a, a.T)),
        ufl.inner(E * a, a * E),
        ufl.inner(E * a, E * a),
    ]
    for scalar in scalars:
        gradient(scalar, energy.H)
    assert len(kept) == len(scalars)
    monkeypatch.setattr(kept_gradients, "_MOST", 3)
    gradient(ufl.tr(E), energy.H)
    assert len(kept) == 3
