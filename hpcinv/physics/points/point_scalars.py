"""Components of UFL expressions at points of a cell as nodes of a graph, down to nodal values and constants.

The components of a part of an expression are an array of nodes: first the axes of its shape, then the axes of its
free indices, in UFL's order.

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
from collections.abc import Callable, Collection, Sequence
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl import classes
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.corealg.traversal import unique_post_traversal

from hpcinv.physics.points.scalar_graph import Node, NotAnalytic, ScalarGraph

type Nodes = npt.NDArray[np.int64]

_DIM = 3


class PointScalars:
    """Components of UFL expressions on cells of a three-dimensional mesh.

    Args:
        unknowns: functions that vary; their components are leaves of the graph.
        entries: constants that vary, each with the number of its component.

    Raises:
        NotAnalytic: by `of`, on a part that graphs do not have; the message names it.
    """

    def __init__(
        self, graph: ScalarGraph, unknowns: Collection[Any] = (), entries: Collection[tuple[Any, int]] = ()
    ) -> None:
        self._graph = graph
        self._unknowns, self._entries = frozenset(unknowns), frozenset(entries)
        self._known: dict[Any, Nodes] = {}

    def of(self, expression: Any) -> list[Node]:
        """Return the nodes of all components of an expression without free indices, the last index fastest."""
        lowered = apply_derivatives(apply_algebra_lowering(expression))
        for part in unique_post_traversal(lowered):
            if part not in self._known and not isinstance(part, classes.MultiIndex | classes.Label):
                self._known[part] = self._new(part)
        return [int(node) for node in self._known[lowered].flat]

    @property
    def volume(self) -> Node:
        """Volume of the cell per volume of the reference cell."""
        return self._graph.absolute(self._determinant)

    @property
    def area(self) -> Node:
        """Area of the facet per area of the facet of the reference cell."""
        return self._graph.multiply(self.volume, self._length())

    def function(self, f: Any, component: int, direction: int = -1) -> Node:
        """Return the value of a component, or its derivative by a reference coordinate."""
        key = "function", f, component, direction
        return self._graph.leaf(key) if f in self._unknowns else self._graph.input(key)

    def _new(self, e: Any) -> Nodes:
        """Return the components of an expression whose operands are known."""
        for kind in type(e).__mro__:
            if kind in _STRUCTURES:
                return _STRUCTURES[kind](self, e)
            if kind in _OPERATIONS:
                return self._elementwise(_OPERATIONS[kind], e)
            if kind in _COMPONENTS:
                nodes = [_COMPONENTS[kind](self, e, c) for c in product(*map(range, e.ufl_shape))]
                return np.array(nodes, dtype=np.int64).reshape(e.ufl_shape)
        raise NotAnalytic(f"it has '{type(e).__name__}'")

    def _elementwise(self, operation: Callable[..., Node], e: Any) -> Nodes:
        """Return an operation on the components of operands, each of which has the shape of the result or none."""
        free = e.ufl_free_indices
        rank = len(e.ufl_shape)
        arrays = []
        for operand in e.ufl_operands:
            array, own = self._known[operand], operand.ufl_free_indices
            missing = 0 if operand.ufl_shape else rank
            axes = [slice(None)] * (rank - missing) + [None] * missing
            arrays.append(array[(*axes, *(slice(None) if i in own else None for i in free))])
        nodes = [operation(self._graph, *map(int, entries)) for entries in np.broadcast(*arrays)]
        return np.array(nodes, dtype=np.int64).reshape(np.broadcast_shapes(*(a.shape for a in arrays)))

    def _zero(self, e: Any) -> Nodes:
        return np.full((*e.ufl_shape, *e.ufl_index_dimensions), self._graph.number(0.0))

    def _operand(self, e: Any) -> Nodes:
        return self._known[e.ufl_operands[0]]

    def _indexed(self, e: Any) -> Nodes:
        whole, indices = e.ufl_operands
        fixed = [int(i) if isinstance(i, classes.FixedIndex) else slice(None) for i in indices]
        counts = [*(i.count() for i in indices if not isinstance(i, classes.FixedIndex)), *whole.ufl_free_indices]
        return _permuted(self._known[whole][tuple(fixed)], counts, e.ufl_free_indices)

    def _tensor(self, e: Any) -> Nodes:
        entry, indices = e.ufl_operands
        return _permuted(
            self._known[entry], entry.ufl_free_indices, [*(i.count() for i in indices), *e.ufl_free_indices]
        )

    def _list(self, e: Any) -> Nodes:
        return np.stack([self._known[operand] for operand in e.ufl_operands])

    def _index_sum(self, e: Any) -> Nodes:
        terms, (index,) = e.ufl_operands
        axis = len(terms.ufl_shape) + terms.ufl_free_indices.index(index.count())
        parts = np.moveaxis(self._known[terms], axis, 0)
        totals = [self._sum(map(int, entries)) for entries in zip(*(part.flat for part in parts), strict=True)]
        return np.array(totals, dtype=np.int64).reshape(parts.shape[1:])

    def _conditional(self, e: Any) -> Nodes:
        condition, *branches = e.ufl_operands
        choose = partial(self._graph.select, int(self._known[condition]))
        if (sizes := _by_size(condition)) is not None:
            choose = partial(self._graph.by_size, *(int(self._known[scalar]) for scalar in sizes))
        entries = zip(*(self._known[branch].flat for branch in branches), strict=True)
        nodes = [choose(int(a), int(b)) for a, b in entries]
        return np.array(nodes, dtype=np.int64).reshape(self._known[branches[0]].shape)

    def _value(self, f: Any, c: tuple[int, ...]) -> Node:
        return self.function(f, _flat(c, f.ufl_shape))

    def _gradient(self, e: Any, c: tuple[int, ...]) -> Node:
        (f,) = e.ufl_operands
        if not isinstance(f, classes.Coefficient | classes.Argument):
            raise NotAnalytic("it has second derivatives of a function")
        directions = (self.function(f, _flat(c[:-1], f.ufl_shape), b) for b in range(_DIM))
        return self._sum(self._graph.multiply(d, self._inverse[b][c[-1]]) for b, d in enumerate(directions))

    def _constant(self, e: Any, c: tuple[int, ...]) -> Node:
        entry = e, _flat(c, e.ufl_shape)
        key = "constant", *entry
        return self._graph.leaf(key) if entry in self._entries else self._graph.input(key)

    def _number(self, e: Any, _: tuple[int, ...]) -> Node:
        return self._graph.number(float(e))

    def _identity(self, _: Any, c: tuple[int, ...]) -> Node:
        return self._graph.number(float(c[0] == c[1]))

    def _position(self, _: Any, c: tuple[int, ...]) -> Node:
        return self._graph.input(("position", *c, -1))

    def _unit_normal(self, _: Any, c: tuple[int, ...]) -> Node:
        return self._graph.divide(self._normal(*c), self._length())

    def _elementary(self, e: Any, _: tuple[int, ...]) -> Node:
        return self._graph.function(e._name, int(self._operand(e)))

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
        return graph.add(first, graph.minus(graph.multiply(self._jacobian(i1, b2), self._jacobian(i2, b1))))

    @cached_property
    def _determinant(self) -> Node:
        return self._sum(self._graph.multiply(self._jacobian(0, b), self._cofactor(0, b)) for b in range(_DIM))

    @cached_property
    def _inverse(self) -> list[list[Node]]:
        """Derivatives of reference coordinates by positions."""
        return [[self._graph.divide(self._cofactor(i, b), self._determinant) for i in range(_DIM)] for b in range(_DIM)]

    def _normal(self, i: int) -> Node:
        """Return a component of the normal. Its length is the facet's area by `volume` and by the reference area."""
        return self._sum(
            self._graph.multiply(self._inverse[b][i], self._graph.input(("normal", b))) for b in range(_DIM)
        )

    def _length(self) -> Node:
        squares = (self._graph.multiply(n, n) for n in map(self._normal, range(_DIM)))
        return self._graph.function("sqrt", self._sum(squares))


_STRUCTURES: dict[type, Callable[[PointScalars, Any], Nodes]] = {
    classes.Zero: PointScalars._zero,
    classes.Variable: PointScalars._operand,
    classes.Conj: PointScalars._operand,
    classes.Real: PointScalars._operand,
    classes.Indexed: PointScalars._indexed,
    classes.ComponentTensor: PointScalars._tensor,
    classes.ListTensor: PointScalars._list,
    classes.IndexSum: PointScalars._index_sum,
    classes.Conditional: PointScalars._conditional,
}
"""how the arrays of operands become the array of an expression"""

_COMPONENTS: dict[type, Callable[[PointScalars, Any, tuple[int, ...]], Node]] = {
    classes.Coefficient: PointScalars._value,
    classes.Argument: PointScalars._value,
    classes.Grad: PointScalars._gradient,
    classes.Constant: PointScalars._constant,
    classes.IntValue: PointScalars._number,
    classes.FloatValue: PointScalars._number,
    classes.Identity: PointScalars._identity,
    classes.SpatialCoordinate: PointScalars._position,
    classes.Jacobian: lambda scalars, _, c: scalars._jacobian(*c),
    classes.JacobianInverse: lambda scalars, _, c: scalars._inverse[c[0]][c[1]],
    classes.JacobianDeterminant: lambda scalars, _, __: scalars._determinant,
    classes.FacetJacobianDeterminant: lambda scalars, _, __: scalars.area,
    classes.FacetNormal: PointScalars._unit_normal,
    classes.MathFunction: PointScalars._elementary,
}
"""how each component of an expression is made"""

_OPERATIONS: dict[type, Callable[..., Node]] = {
    classes.Sum: ScalarGraph.add,
    classes.Product: ScalarGraph.multiply,
    classes.Division: ScalarGraph.divide,
    classes.Power: ScalarGraph.power,
    classes.Abs: ScalarGraph.absolute,
    classes.Atan2: ScalarGraph.angle,
    classes.MinValue: lambda graph, a, b: graph.select(graph.compare("<", a, b), a, b),
    classes.MaxValue: lambda graph, a, b: graph.select(graph.compare("<", a, b), b, a),
    classes.LT: lambda graph, a, b: graph.compare("<", a, b),
    classes.GT: lambda graph, a, b: graph.compare("<", b, a),
    classes.LE: lambda graph, a, b: graph.compare("<=", a, b),
    classes.GE: lambda graph, a, b: graph.compare("<=", b, a),
    classes.EQ: lambda graph, a, b: graph.compare("==", a, b),
    classes.NE: lambda graph, a, b: graph.negated(graph.compare("==", a, b)),
    classes.AndCondition: ScalarGraph.multiply,
    classes.OrCondition: lambda graph, a, b: graph.negated(graph.multiply(graph.negated(a), graph.negated(b))),
    classes.NotCondition: ScalarGraph.negated,
}
"""operations on single components; conditions are 1 where they hold, else 0"""


def _permuted(nodes: Nodes, axes: Sequence[int], wanted: Sequence[int]) -> Nodes:
    """Return an array whose axes have labels with them in a wanted order; axes with equal labels are their diagonal."""
    number = {label: n for n, label in enumerate(dict.fromkeys(axes))}
    permuted: Nodes = np.einsum(nodes, [number[a] for a in axes], [number[w] for w in wanted])
    return permuted


def _by_size(condition: Any) -> tuple[Any, Any] | None:
    """Return ``x`` and ``c`` of a condition ``|x| < c`` with a number ``c`` (`physics.kinematics.stable_functions`)."""
    if isinstance(condition, classes.LT):
        size, bound = condition.ufl_operands
        if isinstance(size, classes.Abs) and isinstance(bound, classes.FloatValue):
            return size.ufl_operands[0], bound
    return None


def _flat(c: tuple[int, ...], shape: tuple[int, ...]) -> int:
    """Return the number of a component, the last index fastest."""
    return sum(i * math.prod(shape[k + 1 :]) for k, i in enumerate(c))


def is_supported(mesh: Any) -> bool:
    """Return whether the geometry of a UFL mesh is one of solids."""
    return bool(mesh.geometric_dimension == mesh.topological_dimension == _DIM) and isinstance(mesh, ufl.Mesh)
