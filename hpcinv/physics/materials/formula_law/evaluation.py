"""Evaluation of energy formulas without loss of digits at small strain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hpcinv.base.quantity.expressions import Expression
from hpcinv.physics.materials.formula_law.algebras import Functions, ufl_functions
from hpcinv.physics.materials.formula_law.coefficients import Coefficient
from hpcinv.physics.materials.formula_law.invariants import PrincipalStretches, families_in, invariants
from hpcinv.physics.materials.formula_law.jet import JET_FUNCTIONS, Jet, Strains

if TYPE_CHECKING:
    from hpcinv.physics.kinematics.kinematics import Deformation


def evaluate(
    energy: Expression,
    constants: Mapping[str, Coefficient],
    k: Deformation | PrincipalStretches,
    functions: Functions,
    families: Mapping[str, str] | None = None,
) -> tuple[Jet, Strains]:
    """Return the energy as a jet, and its strains.

    Args:
        constants: parameters by name.
        functions: functions for the type of the strains of ``k``.
        families: families of fibres by their names in the formula; ``None`` if these are the names of the families.

    Raises:
        ValueError: if it has no value or no derivative at ``F = I``.
    """
    strains = Strains(functions)
    values = invariants(energy.names, k, strains, families)
    values |= {name: strains.constant(constant) for name, constant in constants.items()}
    return energy.apply(values, JET_FUNCTIONS, strains.number), strains


def evaluate_of_any_parameters(
    formula: str, par: Any, k: Deformation, families: Mapping[str, str]
) -> tuple[Any, tuple[Any, ...]]:
    """Return the energy of a law for any values of its parameters, and the scalars that must stay positive, in UFL.

    Args:
        par: namespace of the positive parameters of the formula.
    """
    energy = Expression(formula)
    names = sorted(name for name in energy.names if families_in(name) is None)
    # Generic numbers: a sum of them vanishes only if it vanishes for all values of the parameters.
    typical = {name: math.exp(1 / (3 + i)) for i, name in enumerate(names)}
    constants = {name: Coefficient.parameter(value, getattr(par, name)) for name, value in typical.items()}
    jet, strains = evaluate(energy, constants, k, ufl_functions(), families)
    if jet.constant or jet.slopes:
        raise ValueError(f"'{formula}' is not stress-free at F = I, or has an energy there")
    return jet.remainder, tuple(strains.positive)
