"""Derivatives of UFL expressions in stages, which keeps kernels small.

UFL differentiates in forward mode: by each of the nine entries of ``H`` through the whole energy. Here the intermediate
strains and invariants are variables (`stage`), and each of them is differentiated by its direct arguments only. A
gradient of a scalar is then accumulated in reverse, from the energy to ``H``, at a few times the cost of the energy.

Source: Griewank & Walther, *Evaluating Derivatives*, 2008, ch. 3 and 9, doi:10.1137/1.9780898717761.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.map_integrands import map_integrands
from ufl.classes import Variable, Zero
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_post_traversal

from hpcinv.physics.kinematics.kept_gradients import kept_gradient


def stage(expression: Callable[[Any], Any]) -> cached_property[Any]:
    """Return a cached property that is a stage of derivatives."""
    return cached_property(lambda owner: ufl.variable(expression(owner)))


def gradient(scalar: Any, variable: Variable) -> Any:
    """Return ``∂scalar/∂variable``, of the shape of ``variable``, with all other variables fixed."""
    return kept_gradient(scalar, variable, _derived)


def _derived(scalar: Any, variable: Variable) -> Any:
    whole = ufl.variable(scalar)
    stages = [e for e in unique_post_traversal(whole) if isinstance(e, Variable)]  # from ``by`` to the scalar
    adjoints: dict[Any, Any] = {whole: None}
    local = Local(ufl.domain.extract_unique_domain(variable))
    for stage in reversed(stages):
        if stage == variable or stage not in adjoints:
            continue
        adjoint = adjoints[stage]
        if adjoint is not None and not stage.ufl_shape:
            adjoint = ufl.variable(adjoint)
        for part, slope in local.derivatives(stage.ufl_operands[0]):
            share = slope if adjoint is None else _contracted(adjoint, len(stage.ufl_shape), slope)
            adjoints[part] = adjoints[part] + share if part in adjoints else share
    return adjoints.get(variable, ufl.zero(variable.ufl_shape))


class Local:
    """Derivatives of expressions by the stages that are their direct arguments, taken as independent."""

    def __init__(self, domain: Any) -> None:
        self._domain = domain
        self._symbols: dict[Variable, Variable] = {}
        self._known: dict[Any, list[tuple[Variable, Any]]] = {}

    def derivatives(self, expression: Any) -> list[tuple[Variable, Any]]:
        """Return these stages with the derivatives by them, without zeros."""
        if expression not in self._known:
            self._known[expression] = self._derivatives(expression)
        return self._known[expression]

    def _derivatives(self, expression: Any) -> list[tuple[Variable, Any]]:
        parts = _outermost(expression)
        for part in parts:
            if part not in self._symbols:
                self._symbols[part] = Variable(ufl.Constant(self._domain, part.ufl_shape))
        symbols = {part: self._symbols[part] for part in parts}
        hidden = apply_algebra_lowering(map_expr_dag(_Exchanged(symbols), expression))
        slopes = {part: apply_derivatives(ufl.diff(hidden, symbol)) for part, symbol in symbols.items()}
        back = _Exchanged({symbol: part for part, symbol in symbols.items()})
        return [(part, map_expr_dag(back, slope)) for part, slope in slopes.items() if not isinstance(slope, Zero)]


def _outermost(expression: Any) -> list[Variable]:
    stages, seen, left = [], set(), [expression]
    while left:
        node = left.pop()
        if node in seen:
            continue
        seen.add(node)
        if isinstance(node, Variable):
            stages.append(node)
        else:
            left.extend(node.ufl_operands)
    return stages


def _contracted(a: Any, rank: int, b: Any) -> Any:
    """Return the contraction of the last ``rank`` indices of ``a`` with the first of ``b``."""
    i, k = ufl.indices(len(a.ufl_shape) - rank), ufl.indices(rank)
    j = ufl.indices(len(b.ufl_shape) - rank)
    product = (a[(*i, *k)] if i or k else a) * (b[(*k, *j)] if k or j else b)
    return ufl.as_tensor(product, (*i, *j)) if i or j else product


class _Exchanged(MultiFunction):  # type: ignore[misc]  # UFL has no types
    """Expressions with other variables. Unlike `ufl.replace`, this does not look at what variables consist of."""

    expr = MultiFunction.reuse_if_untouched

    def __init__(self, others: Mapping[Variable, Variable]) -> None:
        super().__init__()
        self._others = others

    def variable(self, node: Variable) -> Variable:
        return self._others[node]


class _Plain(MultiFunction):  # type: ignore[misc]  # UFL has no types
    expr = MultiFunction.reuse_if_untouched

    def variable(self, _one: Any, operand: Any, _label: Any) -> Any:
        return operand


def remove_stages(expression: Any) -> Any:
    """Return an expression or form without variables, whose running numbers would change the hash of each kernel."""
    rules = _Plain()
    return map_integrands(lambda e: map_expr_dag(rules, e), expression)
