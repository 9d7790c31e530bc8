"""Components of UFL expressions at points of a cell as nodes of a graph, down to nodal values and constants.

Inputs of the graph are tuples:

==================================  ========================================================================
``("function", f, i, b)``           component ``i`` of a function or argument; its derivative by the reference
                                    coordinate ``b``, or its value for ``b = -1``
``("position", i, b)``              the same of the position
``("constant", c, i)``              component ``i`` of a constant
``("normal", i)``                   normal of the facet of the reference cell, times its area
``("weight",)``                     weight of the quadrature point
==================================  ========================================================================
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import (
    EQ,
    GE,
    GT,
    LE,
    LT,
    NE,
    Abs,
    AndCondition,
    Argument,
    Coefficient,
    Condition,
    Conditional,
    Constant,
    FacetNormal,
    FloatValue,
    Grad,
    Jacobian,
    JacobianDeterminant,
    JacobianInverse,
    Label,
    MaxValue,
    MinValue,
    MultiIndex,
    NotCondition,
    OrCondition,
    SpatialCoordinate,
)
from ufl.corealg.traversal import unique_post_traversal

from hpcinv.points.scalar_graph import Node, NotAnalytic, ScalarGraph, Scalars

_DIM = 3


class PointScalars(Scalars):
    """Components of UFL expressions on cells of a three-dimensional mesh.

    Args:
        unknowns: functions that vary; their components are leaves of the graph.
        entries: constants that vary, each with the number of its component.
    """

    def __init__(
        self, graph: ScalarGraph, unknowns: Collection[Any] = (), entries: Collection[tuple[Any, int]] = ()
    ) -> None:
        super().__init__(graph, {})
        self._unknowns, self._entries = frozenset(unknowns), frozenset(entries)

    def of(self, expression: Any) -> list[Node]:
        lowered = apply_derivatives(apply_algebra_lowering(expression))
        for part in unique_post_traversal(lowered):
            self._varies[part], self._is_number[part] = True, False
            is_left_out = isinstance(part, Condition | MultiIndex | Label | Coefficient | Argument)
            if not is_left_out and not part.ufl_free_indices:
                self._components(part)  # operands first, which keeps the recursion short
        return self._components(lowered)

    @property
    def volume(self) -> Node:
        """Volume of the cell per volume of the reference cell."""
        return self._graph.absolute(self._determinant())

    @property
    def area(self) -> Node:
        """Area of the facet per area of the facet of the reference cell."""
        return self._graph.multiply(self.volume, self._length())

    def function(self, f: Any, component: int, direction: int = -1) -> Node:
        """Return the value of a component, or its derivative by a reference coordinate."""
        key = "function", f, component, direction
        return self._graph.leaf(key) if f in self._unknowns else self._graph.input(key)

    def _new(self, e: Any, c: tuple[int, ...], indices: Mapping[int, int]) -> Node:
        graph, operands = self._graph, e.ufl_operands
        match e:
            case Coefficient() | Argument():
                return self.function(e, _flat(c, e.ufl_shape))
            case Grad() if isinstance(operands[0], Coefficient | Argument):
                component, f = _flat(c[:-1], e.ufl_shape[:-1]), operands[0]
                directions = (self.function(f, component, b) for b in range(_DIM))
                return self._sum(graph.multiply(d, self._inverse(b, c[-1])) for b, d in enumerate(directions))
            case Grad():
                raise NotAnalytic("it has derivatives of functions other than their gradients")
            case Constant():
                entry = e, _flat(c, e.ufl_shape)
                return graph.leaf(("constant", *entry)) if entry in self._entries else graph.input(("constant", *entry))
            case SpatialCoordinate():
                return graph.input(("position", *c, -1))
            case Jacobian():
                return self._jacobian(*c)
            case JacobianInverse():
                return self._inverse(*c)
            case JacobianDeterminant():
                return self._determinant()
            case FacetNormal():
                return graph.divide(self._normal(*c), self._length())
            case Abs():
                return graph.absolute(self._node(operands[0], (), indices))
            case MinValue() | MaxValue():
                a, b = (self._node(o, (), indices) for o in operands)
                return graph.select(graph.compare("<", a, b), *((a, b) if isinstance(e, MinValue) else (b, a)))
            case Conditional():
                branches = (self._node(branch, c, indices) for branch in operands[1:])
                if (sizes := _by_size(operands[0])) is not None:
                    return graph.by_size(*(self._node(scalar, (), indices) for scalar in sizes), *branches)
                return graph.select(self._condition(operands[0], indices), *branches)
        return super()._new(e, c, indices)

    def _condition(self, e: Any, indices: Mapping[int, int]) -> Node:
        graph, unity = self._graph, self._graph.number(1.0)

        def negated(condition: Node) -> Node:
            return graph.add(unity, graph.multiply(graph.number(-1.0), condition))

        match e:
            case AndCondition():
                return graph.multiply(*(self._condition(o, indices) for o in e.ufl_operands))
            case OrCondition():
                return negated(graph.multiply(*(negated(self._condition(o, indices)) for o in e.ufl_operands)))
            case NotCondition():
                return negated(self._condition(e.ufl_operands[0], indices))
        a, b = (self._node(o, (), indices) for o in e.ufl_operands)
        match e:
            case LT() | GT():
                return graph.compare("<", *((a, b) if isinstance(e, LT) else (b, a)))
            case LE() | GE():
                return graph.compare("<=", *((a, b) if isinstance(e, LE) else (b, a)))
            case EQ() | NE():
                equal = graph.compare("==", a, b)
                return equal if isinstance(e, EQ) else negated(equal)
        raise NotAnalytic(f"it has the condition '{type(e).__name__}'")

    def _sum(self, nodes: Any) -> Node:
        total = self._graph.number(0.0)
        for node in nodes:
            total = self._graph.add(total, node)
        return total

    def _jacobian(self, i: int, b: int) -> Node:
        return self._graph.input(("position", i, b))

    def _cofactor(self, i: int, b: int) -> Node:
        """Return the cofactor of an entry of the Jacobian."""
        graph = self._graph
        (i1, i2), (b1, b2) = (((k + 1) % _DIM, (k + 2) % _DIM) for k in (i, b))
        first = graph.multiply(self._jacobian(i1, b1), self._jacobian(i2, b2))
        second = graph.multiply(self._jacobian(i1, b2), self._jacobian(i2, b1))
        return graph.add(first, graph.multiply(graph.number(-1.0), second))

    def _determinant(self) -> Node:
        return self._sum(self._graph.multiply(self._jacobian(0, b), self._cofactor(0, b)) for b in range(_DIM))

    def _inverse(self, b: int, i: int) -> Node:
        return self._graph.divide(self._cofactor(i, b), self._determinant())

    def _normal(self, i: int) -> Node:
        """Return a component of the normal; its length is the area by the `volume`, per area of the reference facet."""
        return self._sum(
            self._graph.multiply(self._inverse(b, i), self._graph.input(("normal", b))) for b in range(_DIM)
        )

    def _length(self) -> Node:
        squares = (self._graph.multiply(n, n) for n in map(self._normal, range(_DIM)))
        return self._graph.function("sqrt", self._sum(squares))


def _by_size(condition: Any) -> tuple[Any, Any] | None:
    """Return ``x`` and ``c`` of a condition ``|x| < c`` with a number ``c`` (`hpcinv.kinematics.stable_functions`)."""
    if isinstance(condition, LT):
        size, bound = condition.ufl_operands
        if isinstance(size, Abs) and isinstance(bound, FloatValue):
            return size.ufl_operands[0], bound
    return None


def _flat(c: tuple[int, ...], shape: tuple[int, ...]) -> int:
    """Return the number of a component, the last index fastest."""
    return sum(i * math.prod(shape[k + 1 :]) for k, i in enumerate(c))


def is_supported(mesh: Any) -> bool:
    """Return whether the geometry of a UFL mesh is one of solids."""
    return bool(mesh.geometric_dimension == mesh.topological_dimension == _DIM) and isinstance(mesh, ufl.Mesh)
