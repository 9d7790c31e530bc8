"""Tangent moduli: the derivative of a residual's integrand at a point, by displacement, pressure and their gradients.

A volume integral of the residual is ``∫ Σ_a s_a(…) · δ_a dx``, where ``δ`` runs over the test functions and their
gradients, and ``s`` over what is dual to them, such as stresses. Its tangent is ``∫ Σ_ab δ_a · ∂s_a/∂e_b · Δ_b dx``,
where ``e`` are the unknowns and their gradients. Moduli ``∂s_a/∂e_b`` follow from the residual alone; all else about
the tangent is the same for all laws (`hpcinv.contraction`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_arguments, extract_coefficients
from ufl.classes import ListTensor, Variable, Zero

from hpcinv.chainrule import Jacobian, Local, without_stages

if TYPE_CHECKING:
    from hpcinv.unknowns import Unknowns


@dataclass(frozen=True)
class Slot:
    """A test function or its gradient, and what belongs to it among the unknowns.

    Attributes:
        part: 0 for the displacement, 1 for the pressure.
        components: 3 or 1.
        is_gradient: whether it is the gradient, with respect to the reference cell.
    """

    part: int
    components: int
    is_gradient: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Of what is dual to it: components, then directions of the gradient."""
        return (self.components, 3) if self.is_gradient else (self.components,)


@dataclass(frozen=True)
class Moduli:
    """Moduli of the volume integrals over the same cells.

    Attributes:
        cells: what they hold in, ``None`` for the whole mesh.
        degree: of the quadrature.
        pairs: slots of test and trial function of the moduli that do not vanish.
        expression: UFL vector of them all, each in the order (component, direction) of test, then of trial function,
            times the volume of the cell per volume of the reference cell.
    """

    cells: npt.NDArray[np.int32] | None
    degree: int
    pairs: tuple[tuple[Slot, Slot], ...]
    expression: Any


def moduli_of(residual: Any, unknowns: Unknowns) -> list[Moduli]:
    """Those of a form's volume integrals; the cells of its regions must be all cells."""
    integrals = [one for one in residual.integrals() if one.integral_type() == "cell"]
    common = [one.integrand() for one in integrals if one.subdomain_id() in ("everywhere", "otherwise")]
    regions: dict[int, list[Any]] = {}
    for one in integrals:
        if one.subdomain_id() not in ("everywhere", "otherwise"):
            regions.setdefault(one.subdomain_id(), []).append(one.integrand())
    degree = integrals[0].metadata()["quadrature_degree"]
    if not regions:
        return [_moduli(sum(common[1:], common[0]), None, degree, unknowns)]
    cells = dict(integrals[0].subdomain_data())
    return [
        _moduli(sum((*own[1:], *common), own[0]), cells[number], degree, unknowns) for number, own in regions.items()
    ]


def _moduli(integrand: Any, cells: npt.NDArray[np.int32] | None, degree: int, unknowns: Unknowns) -> Moduli:
    mesh = unknowns.mesh
    pairs = [(unknowns.v, unknowns.u, 0, 3)]
    if unknowns.p is not None:
        pairs.append((unknowns.q, unknowns.p, 1, 1))
    tests: dict[Slot, tuple[Any, Variable]] = {}
    trials: dict[Slot, tuple[Any, Variable]] = {}
    for test, trial, part, components in pairs:
        for is_gradient, of in ((True, ufl.grad), (False, lambda f: f)):
            slot = Slot(part, components, is_gradient)
            for where, f in ((tests, of(test)), (trials, of(trial))):
                where[slot] = f, ufl.variable(ufl.Constant(mesh, f.ufl_shape))
    at_a_point = ufl.replace(integrand, _by_components(*tests.values(), *trials.values()))
    left = extract_arguments(at_a_point), [f for f in extract_coefficients(at_a_point) if f == unknowns.state]
    assert left == ([], []), "a residual has unknowns in other forms than their values and gradients"
    K, volume = ufl.JacobianInverse(mesh), abs(ufl.JacobianDeterminant(mesh))
    local = Local(mesh.ufl_domain())
    jacobians = {slot: Jacobian(symbol, local) for slot, (_, symbol) in trials.items()}
    there, entries = [], list[Any]()
    for test_slot, (_, symbol) in tests.items():
        dual = expand_derivatives(ufl.diff(at_a_point, symbol))
        if isinstance(dual, Zero):
            continue
        for trial_slot, jacobian in jacobians.items():
            moduli = jacobian.of(dual)
            if moduli is not None:
                there.append((test_slot, trial_slot))
                entries += _entries(moduli, test_slot, trial_slot, K)
    vector = ufl.replace(volume * ufl.as_vector(entries), {symbol: f for f, symbol in trials.values()})
    return Moduli(cells, degree, tuple(there), without_stages(vector))


def _by_components(*symbols: tuple[Any, Variable]) -> dict[Any, Any]:
    """What is replaced by what, where UFL may have taken components of functions apart."""
    found: dict[Any, Any] = {}
    for f, symbol in symbols:
        if isinstance(f, ListTensor):
            found |= {f[at]: symbol[at] for at in np.ndindex(f.ufl_shape)}
        else:
            found[f] = symbol
    return found


def _entries(moduli: Any, test: Slot, trial: Slot, K: Any) -> list[Any]:
    """Components of moduli, their gradients by coordinates of the reference cell: ``∂/∂x_l = K_bl ∂/∂ξ_b``."""
    axes = len(moduli.ufl_shape)
    of_gradients = [0 if test.part else 1] if test.is_gradient else []
    of_gradients += [axes - 1] if trial.is_gradient else []
    for axis in of_gradients:
        before, after, (b, l) = ufl.indices(axis), ufl.indices(axes - 1 - axis), ufl.indices(2)
        moduli = ufl.as_tensor(moduli[(*before, l, *after)] * K[b, l], (*before, b, *after))
    return [moduli[at] for at in np.ndindex(moduli.ufl_shape)] if axes else [moduli]
