"""Graphs of scalar operations, as programs and Taylor arithmetic take them.

Each node is an operation on earlier nodes. Equal operations are one node, and operations on numbers are carried out.

Conditionals ``|x| < c`` choose between a series and the closed form of one analytic function
(`hpcinv.physics.kinematics.stable_functions`). All others are switches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

type Node = int

_LARGEST_PRODUCT = 4  # integer powers up to this are products, which need no division by the base


class NotAnalytic(Exception):
    """Raised for an expression that has no Taylor series; the message names the reason."""


class ScalarGraph:
    """Operations of scalars.

    Attributes:
        operations: operation and arguments of each node; see `hpcinv.model.assembly.taylor_code` for their meaning.
        varies: whether each node depends on the unknowns.
        inputs: names of what does not depend on the unknowns.
        conditions: by nodes that are a series or a closed form, the node that is 1 where they are the series.
    """

    def __init__(self) -> None:
        self.operations: list[tuple[Any, ...]] = []
        self.varies: list[bool] = []
        self.inputs: list[Any] = []
        self.conditions: dict[Node, Node] = {}
        self._numbers: dict[tuple[Any, ...], Node] = {}

    def leaf(self, key: Any) -> Node:
        """Return an unknown: a number, or whatever names it."""
        return self._node("leaf", key, varies=True)

    def input(self, name: Any) -> Node:
        """Return a value that does not depend on the unknowns."""
        key = "input", name
        if key not in self._numbers:
            self._numbers[key] = self._append(("input", len(self.inputs)), varies=False)
            self.inputs.append(name)
        return self._numbers[key]

    def number(self, value: float) -> Node:
        return self._node("number", float(value), varies=False)

    def add(self, a: Node, b: Node) -> Node:
        x, y = self._value(a), self._value(b)
        if x is not None and y is not None:
            return self.number(x + y)
        if x == 0:
            return b
        return a if y == 0 else self._node("add", *sorted((a, b)))

    def multiply(self, a: Node, b: Node) -> Node:
        x, y = self._value(a), self._value(b)
        if x is not None and y is not None:
            return self.number(x * y)
        if x == 0 or y == 0:
            return self.number(0.0)
        if x == 1:
            return b
        if y == 1:
            return a
        (c, u), (d, v) = self._factored(a), self._factored(b)
        if (self.varies[a] and u != a) or (self.varies[b] and v != b):  # fewer nodes whose coefficients enter sums
            return self.multiply(self.multiply(c, d), self.multiply(u, v))
        return self._node("multiply", *sorted((a, b)))

    def minus(self, a: Node) -> Node:
        return self.multiply(self.number(-1.0), a)

    def negated(self, condition: Node) -> Node:
        """Return 1 where a condition is 0, and 0 where it is 1."""
        return self.add(self.number(1.0), self.minus(condition))

    def divide(self, a: Node, b: Node) -> Node:
        if (y := self._value(b)) is not None:
            return self.multiply(a, self.number(1 / y))
        if self._value(a) == 0:
            return self.number(0.0)
        (c, u), (d, v) = self._factored(a), self._factored(b)
        if self.varies[b] and (v != b or (self.varies[a] and u != a)):
            return self.multiply(self.divide(c, d), self.divide(u, v))
        return self._node("divide", a, b)

    def _factored(self, node: Node) -> tuple[Node, Node]:
        """Return the factor of a node that does not depend on the unknowns, and the rest."""
        unity, operation = self.number(1.0), self.operations[node]
        if not self.varies[node]:
            return node, unity
        if operation[0] == "multiply":
            fixed = [argument for argument in operation[1:] if not self.varies[argument]]
            if fixed:
                (rest,) = (argument for argument in operation[1:] if argument != fixed[0])
                return fixed[0], rest
        return unity, node

    def power(self, a: Node, n: Node) -> Node:
        if self.varies[n]:
            return self.function("exp", self.multiply(n, self.function("ln", a)))
        exponent = self._value(n)
        if exponent is not None and exponent == round(exponent) and abs(exponent) <= _LARGEST_PRODUCT:
            product = self.number(1.0)
            for _ in range(round(abs(exponent))):
                product = self.multiply(product, a)
            return product if exponent >= 0 else self.divide(self.number(1.0), product)
        return self._node("power", a, n)

    def function(self, name: str, x: Node) -> Node:
        """Return an elementary function, by its derivative where it depends on the unknowns."""
        if not self.varies[x]:
            return self._node("function", name, x)
        if name == "sqrt":
            return self.power(x, self.number(0.5))
        key = "integral", name, x
        if key in self._numbers:
            return self._numbers[key]
        node = self._numbers[key] = self._append((*key, 0), varies=True)  # before its derivative, which may contain it
        self.operations[node] = (*key, self._derivative(name, x, node))
        return node

    def angle(self, y: Node, x: Node) -> Node:
        """Return ``atan2(y, x)``: by the smaller quotient of both, so that neither it nor its derivative overflows."""

        def nonzero(value: Node) -> Node:
            return self.select(self.compare("==", value, zero), self.number(1.0), value)

        def signed(size: float) -> Node:
            return self.select(self.compare("<", y, zero), self.number(-size), self.number(size))

        zero = self.number(0.0)
        half_turn = self.select(self.compare("<", x, zero), signed(math.pi), zero)
        flat = self.add(half_turn, self.function("atan", self.divide(y, nonzero(x))))
        steep = self.add(signed(math.pi / 2), self.minus(self.function("atan", self.divide(x, nonzero(y)))))
        return self.select(self.compare("<", self.absolute(x), self.absolute(y)), steep, flat)

    def absolute(self, x: Node) -> Node:
        return self._node("abs", x)

    def sign(self, x: Node) -> Node:
        """Return -1, 0 or 1; constant between the switches."""
        return self._node("sign", x)

    def compare(self, relation: str, a: Node, b: Node) -> Node:
        """Return 1 where ``a < b``, ``a <= b`` or ``a == b``, else 0; ``relation`` is one of these signs."""
        return self._node("compare", relation, a, b)

    def select(self, condition: Node, a: Node, b: Node) -> Node:
        """Return ``a`` where the condition is not 0, else ``b``."""
        return a if a == b else self._node("select", condition, a, b)

    def by_size(self, x: Node, bound: Node, series: Node, closed: Node) -> Node:
        """Return a function that is computed by a series where ``|x|`` is below a bound, else in closed form.

        A closed form loses digits of its value at small ``x``, but not of its higher coefficients, unless it divides by
        ``x``; the series is too short for these.
        """
        if series == closed:
            return closed
        condition = self.compare("<", self.absolute(x), bound)  # before the node, as all that its value takes
        node = self._node("choose", x, bound, series, closed, self._divides(closed, x))
        self.conditions[node] = condition
        return node

    def _divides(self, node: Node, x: Node) -> bool:
        """Return whether a node has a quotient by ``x``, or by a multiple of it."""

        def is_multiple(y: Node) -> bool:
            return y == x or (self.operations[y][0] == "multiply" and any(map(is_multiple, self.arguments(y))))

        operations = (self.operations[y] for y in self.needed([node]) if y > x)
        return any(operation[0] == "divide" and is_multiple(operation[2]) for operation in operations)

    def needed(self, outputs: Sequence[Node]) -> list[Node]:
        """Return the nodes on which some depend, in order."""
        return _reached(outputs, self.arguments)

    def value_arguments(self, node: Node) -> tuple[Node, ...]:
        """Return the nodes from which the value of one is computed: not the derivative of an elementary function."""
        match self.operations[node]:
            case ("integral", _, x, _):
                return (x,)
            case ("choose", _, _, series, closed, _):
                return self.conditions[node], series, closed
        return self.arguments(node)

    def cut(self, outputs: Sequence[Node], leaves: Mapping[Any, int]) -> tuple[ScalarGraph, list[Node]]:
        """Return a graph with the same nodes whose inputs are all that varying nodes take of the others, and these.

        Args:
            leaves: numbers of the leaves in it.

        Raises:
            NotAnalytic: a varying node is a switch.
        """
        reduced, inputs = ScalarGraph(), list[Node]()
        reduced.operations, reduced.varies = list(self.operations), list(self.varies)
        needed = self.needed(outputs)
        varying = [node for node in needed if self.varies[node]]
        taken = {*outputs, *(argument for node in varying for argument in self.arguments(node))}
        for node in needed:
            operation = self.operations[node]
            if operation[0] == "leaf":
                reduced.operations[node] = "leaf", leaves[operation[1]]
            elif not self.varies[node] and node in taken and operation[0] != "number":
                reduced.operations[node] = "input", len(inputs)
                inputs.append(node)
            elif self.varies[node] and operation[0] in ("select", "compare", "abs", "sign"):
                raise NotAnalytic("it has a switch that depends on the displacement")
        reduced.inputs = list(inputs)
        return reduced, inputs

    def needed_values(self, outputs: Sequence[Node]) -> list[Node]:
        """Return the nodes from which the values of some are computed, in order."""
        return _reached(outputs, self.value_arguments)

    def arguments(self, node: Node) -> tuple[Node, ...]:
        """Return the nodes on which one depends directly."""
        match self.operations[node]:
            case ("add" | "multiply" | "divide" | "power", a, b):
                return a, b
            case ("function", _, x) | ("abs" | "sign", x):
                return (x,)
            case ("compare", _, a, b):
                return a, b
            case ("integral", _, x, derivative):
                return x, derivative
            case ("choose", *arguments, _) | ("select", *arguments):
                return tuple(arguments)
        return ()

    def _derivative(self, name: str, x: Node, y: Node) -> Node:
        unity, minus = self.number(1.0), self.number(-1.0)

        def less(a: Node, b: Node) -> Node:
            return self.add(a, self.multiply(minus, b))

        squares = {"tan": self.add(unity, self.multiply(y, y)), "tanh": less(unity, self.multiply(y, y))}
        match name:
            case "exp":
                return y
            case "ln":
                return self.divide(unity, x)
            case "sin" | "sinh" | "cosh":
                return self.function({"sin": "cos", "sinh": "cosh", "cosh": "sinh"}[name], x)
            case "cos":
                return self.multiply(minus, self.function("sin", x))
            case "tan" | "tanh":
                return squares[name]
            case "atan":
                return self.divide(unity, self.add(unity, self.multiply(x, x)))
            case "asin" | "acos":
                root = self.power(less(unity, self.multiply(x, x)), self.number(-0.5))
                return root if name == "asin" else self.multiply(minus, root)
            case "erf":
                bell = self.function("exp", self.multiply(minus, self.multiply(x, x)))
                return self.multiply(self.number(2 / math.sqrt(math.pi)), bell)
        raise NotAnalytic(f"it has the function '{name}'")

    def _value(self, node: Node) -> float | None:
        operation = self.operations[node]
        return operation[1] if operation[0] == "number" else None

    def _node(self, *operation: Any, varies: bool | None = None) -> Node:
        if operation not in self._numbers:
            self._numbers[operation] = self._append(operation, varies=varies)
        return self._numbers[operation]

    def _append(self, operation: tuple[Any, ...], *, varies: bool | None) -> Node:
        self.operations.append(operation)
        node = len(self.operations) - 1
        self.varies.append(False)
        self.varies[node] = any(self.varies[a] for a in self.arguments(node)) if varies is None else varies
        return node


def _reached(outputs: Sequence[Node], arguments: Callable[[Node], Sequence[Node]]) -> list[Node]:
    """Return some nodes and all from which they are reached by arguments, in order."""
    nodes, left = set[Node](), list(outputs)
    while left:
        node = left.pop()
        if node not in nodes:
            nodes.add(node)
            left += arguments(node)
    return sorted(nodes)
