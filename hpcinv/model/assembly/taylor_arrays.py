"""Truncated Taylor arithmetic of a graph in NumPy, by the recursions of `hpcinv.model.assembly.taylor_code`.

It serves machines without a C compiler. Coefficients that later orders need are kept for all points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.physics.points.array_interpreter import ELEMENTARY
from hpcinv.physics.points.scalar_graph import Node, ScalarGraph


class TaylorArrays:
    """Arithmetic for the coefficients of some nodes of a graph.

    Attributes:
        kept: nodes whose coefficients later orders need.
    """

    def __init__(self, graph: ScalarGraph, outputs: Sequence[Node]) -> None:
        self._graph, self._outputs = graph, outputs
        self._nodes = graph.needed(outputs)
        varying = [node for node in self._nodes if graph.varies[node]]
        self.kept = sorted({factor for node in varying for factor in self._factors(node)})

    def _factors(self, node: Node) -> tuple[Node, ...]:
        """Return the nodes whose coefficients of all orders enter one of a node."""
        varies = self._graph.varies
        match self._graph.operations[node]:
            case ("multiply", a, b) if varies[a] and varies[b]:
                return a, b
            case ("divide", _, b) if varies[b]:
                return node, b
            case ("power", a, _):
                return node, a
            case ("integral", _, x, derivative):
                return (x, derivative) if varies[derivative] else (x,)
        return ()

    def begin(self, blocks: int, stored: int) -> TaylorSeries:
        """Return series with room for a number of coefficients at blocks of points."""
        return TaylorSeries(self._graph, self._nodes, self._outputs, self.kept, (blocks, stored))


class TaylorSeries:
    """Coefficients of nodes, order by order."""

    def __init__(
        self,
        graph: ScalarGraph,
        nodes: Sequence[Node],
        outputs: Sequence[Node],
        kept: Sequence[Node],
        room: tuple[int, int],
    ) -> None:
        self._graph, self._nodes, self._outputs, self._room = graph, nodes, outputs, room
        self._kept: dict[Node, Any] = dict.fromkeys(kept)
        self._values: dict[Node, Any] = {}  # of order 0
        self._now: dict[Node, Any] = {}  # of the order that is computed

    def sweep(self, order: int, leaves: Floats, inputs: Floats) -> Floats:
        """Return the coefficients of an order of the outputs, (blocks, outputs, lanes).

        Lower orders were computed before; the last of them is computed again, since its unknowns may have changed.

        Args:
            leaves: (blocks, leaves, stored, lanes).
            inputs: (blocks, inputs, lanes).
        """
        with np.errstate(all="ignore"):
            for k in range(max(order - 1, 0), order + 1):
                self._advance(k, leaves, inputs)
        results = np.zeros((len(leaves), len(self._outputs), leaves.shape[-1]))
        for place, node in enumerate(self._outputs):
            if order == 0 or self._graph.varies[node]:
                results[:, place] = self._now[node]
        return results

    def _advance(self, k: int, leaves: Floats, inputs: Floats) -> None:
        self._now = {}
        for node in self._nodes:
            if k == 0:
                self._now[node] = self._value(node, leaves, inputs)
            elif self._graph.varies[node]:
                self._now[node] = self._coefficient(node, k, leaves)
            if node in self._kept and node in self._now:
                self._keep(node, k, leaves)
        if k == 0:
            operations = self._graph.operations
            compared = {operations[node][1] for node in self._nodes if operations[node][0] == "choose"}
            kept = {node for node in self._nodes if node in compared or not self._graph.varies[node]}
            self._values = {node: self._now[node] for node in kept}

    def _keep(self, node: Node, k: int, leaves: Floats) -> None:
        if self._kept[node] is None:
            blocks, stored = self._room
            self._kept[node] = np.zeros((stored, blocks, leaves.shape[-1]))
        self._kept[node][k] = self._now[node]

    def _value(self, node: Node, leaves: Floats, inputs: Floats) -> Any:
        now = self._now
        match self._graph.operations[node]:
            case ("leaf", number):
                return leaves[:, number, 0]
            case ("input", number):
                return inputs[:, number]
            case ("number", value):
                return np.float64(value)
            case ("function" | "integral", name, x, *_):
                return ELEMENTARY[name][1](now[x])
            case ("choose", x, bound, series, closed, _):
                return np.where(np.abs(now[x]) < now[bound], now[series], now[closed])
            case (name, a, b):
                return ELEMENTARY[name][1](now[a], now[b])
        raise AssertionError(self._graph.operations[node])

    def _coefficient(self, node: Node, k: int, leaves: Floats) -> Any:
        varies, now, kept = self._graph.varies, self._now, self._kept
        j = np.arange(1.0, k + 1)
        match self._graph.operations[node]:
            case ("leaf", number):
                return leaves[:, number, k]
            case ("add", a, b):
                return sum(now[x] for x in (a, b) if varies[x])
            case ("multiply", a, b) if varies[a] and varies[b]:
                return _sum(np.ones(k + 1), kept[a][: k + 1], kept[b][k::-1])
            case ("multiply", a, b):
                changing, fixed = (a, b) if varies[a] else (b, a)
                return now[changing] * self._values[fixed]
            case ("divide", a, b) if varies[b]:
                sums = _sum(np.ones(k), kept[b][1 : k + 1], kept[node][:k][::-1])
                return ((now[a] if varies[a] else 0.0) - sums) / kept[b][0]
            case ("divide", a, b):
                return now[a] / self._values[b]
            case ("power", a, n):
                u, y, exponent = kept[a][1 : k + 1], kept[node][:k][::-1], self._values[n]
                return (exponent * _sum(j, u, y) - _sum(k - j, u, y)) / (kept[a][0] * k)
            case ("integral", _, x, derivative) if varies[derivative]:
                return _sum(j, kept[x][1 : k + 1], kept[derivative][:k][::-1]) / k
            case ("choose", x, bound, *branches, divides):
                series, closed = (now[branch] if varies[branch] else 0.0 for branch in branches)
                return np.where(np.abs(self._values[x]) < self._values[bound], series, closed) if divides else closed
        raise AssertionError(self._graph.operations[node])


def _sum(factors: Floats, u: Floats, v: Floats) -> Floats:
    """Return the sum of factors times products, over the first axis."""
    return np.asarray(np.einsum("j,jbl,jbl->bl", factors, u, v))
