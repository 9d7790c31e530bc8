"""Gradients of UFL scalars that are derived once in a process, and inserted for each further body.

Before a scalar is differentiated, the data of its body (constants, functions, geometry) become symbols, and running
numbers of indices and labels are counted anew. Equal laws on different bodies are then equal expressions.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import basix
import basix.ufl
import ufl
from ufl.classes import BaseFormOperator, ConstantValue, Derivative, Label, MultiIndex, Terminal, Variable, Zero
from ufl.core.multiindex import FixedIndex, Index
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_post_traversal

type _Derive = Callable[[Any, Variable], Any]

_MOST = 32
"""scalars whose gradients are kept, about 0.5 MB each; each collection of garbage takes 1 ms longer for each of them"""
_FIRST = -1_000_000_000
"""first number of a symbol, index or label in a kept scalar: UFL's running numbers are never negative"""
_kept: OrderedDict[tuple[Any, Variable], Any] = OrderedDict()
_symbols: list[dict[tuple[int, ...], Any]] = []
_mesh = ufl.Mesh(basix.ufl.element("P", basix.CellType.tetrahedron, 1, shape=(3,)))


def kept_gradient(scalar: Any, variable: Variable, derive: _Derive) -> Any:
    """Return ``derive(scalar, variable)``, from an earlier call for an equal scalar on any body if there was one."""
    if any(_has_own_rules(node) for node in unique_post_traversal(scalar)):
        return derive(scalar, variable)
    hidden = _Hidden(variable)
    key = hidden.of(scalar), hidden.variable(variable)
    if key in _kept:
        _kept.move_to_end(key)
    else:
        _kept[key] = derive(*key)
        while len(_kept) > _MOST:
            _kept.popitem(last=False)
    return _Shown(hidden).of(_kept[key])


def _has_own_rules(node: Any) -> bool:
    """True for what symbols cannot stand for: derivatives of stages, and operators that derive themselves."""
    if isinstance(node, Derivative):
        return any(isinstance(part, Variable) for part in unique_post_traversal(node.ufl_operands[0]))
    return isinstance(node, BaseFormOperator)


def _symbol(number: int, shape: tuple[int, ...]) -> Any:
    """Return a constant of a mesh that no body has; the same one for the same number and shape."""
    while len(_symbols) <= number:
        _symbols.append({})
    if shape not in _symbols[number]:
        _symbols[number][shape] = ufl.Constant(_mesh, shape, count=_FIRST + number)
    return _symbols[number][shape]


class _Renumbered(MultiFunction):  # type: ignore[misc]  # UFL has no types
    """Expressions with other free indices."""

    expr = MultiFunction.reuse_if_untouched

    def __init__(self) -> None:
        super().__init__()
        self._indices: dict[int, Index] = {}
        self._done: dict[Any, Any] = {}
        self._same: dict[Any, Any] = {}

    def of(self, expression: Any) -> Any:
        return map_expr_dag(self, expression, vcache=self._done, rcache=self._same)

    def new_index(self) -> Index:
        return Index()

    def _index(self, number: int) -> Index:
        if number not in self._indices:
            self._indices[number] = self.new_index()
        return self._indices[number]

    def multi_index(self, node: MultiIndex) -> MultiIndex:
        return MultiIndex(tuple(i if isinstance(i, FixedIndex) else self._index(i.count()) for i in node))

    def zero(self, node: Zero) -> Zero:
        if not node.ufl_free_indices:
            return node
        numbers = [self._index(number).count() for number in node.ufl_free_indices]
        pairs = sorted(zip(numbers, node.ufl_index_dimensions, strict=True))
        return Zero(node.ufl_shape, tuple(n for n, _ in pairs), tuple(d for _, d in pairs))


class _Hidden(_Renumbered):
    """Expressions with symbols for what belongs to a body.

    Attributes:
        shown: what each symbol, and each label of a stage, stands for.
    """

    def __init__(self, variable: Variable) -> None:
        super().__init__()
        self._variable = variable
        self._replaced: dict[Any, Any] = {}
        self.shown: dict[Any, Any] = {}

    def new_index(self) -> Index:
        return Index(_FIRST + len(self._indices))

    def terminal(self, node: Terminal) -> Any:
        if isinstance(node, ConstantValue | Label):
            return node
        return self._by_symbol(node)

    def derivative(self, node: Derivative) -> Any:
        return self._by_symbol(node)

    def variable(self, node: Variable) -> Variable:
        if node not in self._replaced:
            inside = self._by_symbol(node.ufl_operands[0]) if node == self._variable else self.of(node.ufl_operands[0])
            label = Label(_FIRST + len(self._replaced))
            self._replaced[node] = Variable(inside, label)
            self.shown[label] = node
        return self._replaced[node]

    def _by_symbol(self, node: Any) -> Any:
        if node not in self._replaced:
            symbol = _symbol(len(self._replaced), node.ufl_shape)
            self._replaced[node], self.shown[symbol] = symbol, node
        return self._replaced[node]


class _Shown(_Renumbered):
    """Expressions with what symbols and labels stand for, and with further labels for further stages."""

    def __init__(self, hidden: _Hidden) -> None:
        super().__init__()
        self._shown = hidden.shown

    def constant(self, node: Any) -> Any:
        return self._shown[node]

    def variable(self, node: Variable) -> Variable:
        label = node.ufl_operands[1]
        if label not in self._shown:
            self._shown[label] = ufl.variable(self.of(node.ufl_operands[0]))
        return self._shown[label]
