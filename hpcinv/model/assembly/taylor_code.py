"""C code of truncated Taylor arithmetic for a graph of scalar operations.

With ``x(a) = Σ xₖ aᵏ`` of the unknowns, the coefficients of each node follow order by order:

==================  ====================================================
``y = u v``         ``yₖ = Σⱼ uⱼ vₖ₋ⱼ``,  j = 0 … k
``y = u / v``       ``v₀ yₖ = uₖ - Σⱼ vⱼ yₖ₋ⱼ``,  j = 1 … k
``y = uⁿ``          ``k u₀ yₖ = Σⱼ (n j - (k - j)) uⱼ yₖ₋ⱼ``,  j = 1 … k
``y' = g u'``       ``k yₖ = Σⱼ j uⱼ gₖ₋ⱼ``,  j = 1 … k (elementary functions)
==================  ====================================================

All orders are computed anew for each one, four points at a time, one in each lane of the processor's vector
instructions. Their coefficients stay in the cache: memory for coefficients of all points would take longer to use.

Source: Griewank & Walther, *Evaluating Derivatives*, 2008, ch. 13, doi:10.1137/1.9780898717761.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hpcinv.physics.points.scalar_graph import Node, ScalarGraph

LANES = 4
"""Points of a block: doubles of an AVX register. With eight, the compiler keeps sums in memory: 4 times as slow."""

_HEAD = """#include <math.h>
#include <stdint.h>

enum { LANES = %(lanes)d, LEAVES = %(leaves)d, INPUTS = %(inputs)d, KEPT = %(kept)d, CHOICES = %(choices)d,
       OUTPUTS = %(outputs)d };
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef int64_t masks __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

static inline lanes all(double x) { return x - (lanes){0}; }
static inline lanes chosen(masks m, lanes a, lanes b) { return (lanes)((m & (masks)a) | (~m & (masks)b)); }
static inline lanes absolute(lanes x) { return (lanes)((masks)x & INT64_MAX); }
static lanes mapped(double (*f)(double), lanes x) {
  for (int i = 0; i < LANES; i++) x[i] = f(x[i]);
  return x;
}
static lanes raised(lanes x, lanes n) {
  for (int i = 0; i < LANES; i++) x[i] = pow(x[i], n[i]);
  return x;
}
/* Return the sum of f[j] u[j] v[k - j], j = first … k. Two sums, since each addition waits for the one before. */
#define SUM(factor, first)                                                                                          \\
  lanes even = {0}, odd = {0};                                                                                      \\
  int j = first;                                                                                                    \\
  for (; j < k; j += 2) {                                                                                           \\
    even += factor(j) u[j] * v[k - j];                                                                              \\
    odd += factor(j + 1) u[j + 1] * v[k - j - 1];                                                                   \\
  }                                                                                                                 \\
  if (j == k) even += factor(k) u[k] * v[0];                                                                        \\
  return even + odd
#define ONE(j)
#define NUMBER(j) (double)(j) *
#define POWER(j) (n * (double)(j) - (double)(k - (j))) *
static __attribute__((noinline)) lanes product(const lanes *u, const lanes *v, int k) { SUM(ONE, 0); }
static __attribute__((noinline)) lanes quotient(const lanes *u, const lanes *v, int k) { SUM(ONE, 1); }
static __attribute__((noinline)) lanes integral(const lanes *u, const lanes *v, int k) { SUM(NUMBER, 1); }
static __attribute__((noinline)) lanes power(const lanes *u, const lanes *v, lanes n, int k) { SUM(POWER, 1); }
"""

_SWEEP = """
/* Compute the coefficients up to an order of the outputs; the last ones are returned.

   blocks   number of blocks of LANES points
   stored   number of coefficients for which there is room
   leaves   (blocks, LEAVES, stored, LANES)
   inputs   (blocks, INPUTS, LANES)
   kept     (KEPT, stored, LANES) and choices (CHOICES, LANES): room that all blocks use
   outputs  (blocks, OUTPUTS, LANES) */
void sweep(int64_t blocks, int stored, int order, const lanes *leaves, const lanes *inputs, lanes *kept,
           masks *choices, lanes *outputs) {
  for (; blocks--; leaves += LEAVES * stored, inputs += INPUTS, outputs += OUTPUTS) {
    values(stored, leaves, inputs, kept, choices, outputs);
    for (int k = 1; k <= order; k++) further(k, stored, leaves, inputs, kept, choices, outputs);
  }
}
"""
_ARGUMENTS = "int stored, const lanes *leaves, const lanes *inputs, lanes *kept, masks *choices, lanes *outputs"


@dataclass(frozen=True)
class TaylorCode:
    """C code of Taylor arithmetic, and the sizes of its arrays (`_SWEEP`)."""

    text: str
    kept: int
    choices: int


def taylor_code(graph: ScalarGraph, leaves: int, outputs: Sequence[Node]) -> TaylorCode:
    """Return the code for the coefficients of some nodes of a graph with a number of unknowns."""
    writer = _Writer(graph, outputs)
    sizes = {
        "lanes": LANES,
        "leaves": leaves,
        "inputs": len(graph.inputs),
        "kept": len(writer.kept),
        "choices": len(writer.choices),
        "outputs": len(outputs),
    }
    bodies = [
        f"static void {head}{_ARGUMENTS}) {{\n{body}\n}}\n"
        for head, body in (
            ("values(", "\n".join(writer.values())),
            ("further(int k, ", "\n".join(writer.further())),
        )
    ]
    return TaylorCode(_HEAD % sizes + "".join(bodies) + _SWEEP, len(writer.kept), len(writer.choices))


@dataclass(frozen=True)
class _Convolution:
    """A sum of products and of other nodes, each with its sign."""

    products: list[tuple[str, Node, Node]]
    others: list[tuple[str, Node]]


class _Writer:
    """Statements for the value and for a coefficient of higher order of each node.

    Attributes:
        kept: places of the nodes whose coefficients are kept.
        choices: places of the nodes that choose their higher coefficients too.
    """

    def __init__(self, graph: ScalarGraph, outputs: Sequence[Node]) -> None:
        self._graph, self._outputs = graph, outputs
        self._nodes = graph.needed(outputs)
        self._convolutions, self._absorbed = self._collected()
        kept = sorted({node for node in self._nodes for node in self._summed(node)})
        self.kept = {node: place for place, node in enumerate(n for n in kept if graph.operations[n][0] != "leaf")}
        choosing = [
            node for node in self._nodes if graph.operations[node][0] == "choose" and graph.operations[node][-1]
        ]
        self.choices = {node: place for place, node in enumerate(choosing)}

    def values(self) -> Iterator[str]:
        for node in self._nodes:
            yield f"  const lanes v{node} = {self._value(node)};"
            if node in self.choices:
                yield f"  choices[{self.choices[node]}] = {self._condition(node)};"
            yield from self._keep(node, "0")
        yield from self._return()

    def further(self) -> Iterator[str]:
        for node in self._nodes:
            if not self._graph.varies[node]:
                yield f"  const lanes v{node} = {self._value(node)};"
                continue
            if node in self._absorbed:
                continue
            yield from self._coefficient(node)
            yield from self._keep(node, "k")
        yield from self._return(constant="(lanes){0}")

    def _summed(self, node: Node) -> tuple[Node, ...]:
        """Return the nodes whose coefficients enter the sums of one."""
        varies = self._graph.varies
        if node in self._absorbed:
            return ()
        if node in self._convolutions:
            return tuple(factor for _, *factors in self._convolutions[node].products for factor in factors)
        match self._graph.operations[node]:
            case ("divide", _, b) if varies[b]:
                return node, b
            case ("power", a, _) if varies[a]:
                return node, a
            case ("integral", _, x, derivative):
                return (x, derivative) if varies[derivative] else (x,)
        return ()

    def _collected(self) -> tuple[dict[Node, _Convolution], set[Node]]:
        """Return sums of products, and the nodes that are only parts of them."""
        graph = self._graph
        uses = Counter([*self._outputs, *(a for node in self._nodes for a in graph.arguments(node))])
        convolutions, absorbed = dict[Node, _Convolution](), set[Node]()

        def collect(node: Node, sign: str, parts: _Convolution, *, is_root: bool = False) -> None:
            if not graph.varies[node]:
                return
            operation = graph.operations[node]
            minus = self._negated(node)
            is_product = operation[0] == "multiply" and all(graph.varies[a] for a in operation[1:])
            if not (is_root or uses[node] == 1) or not (is_product or operation[0] == "add" or minus is not None):
                parts.others.append((sign, node))
                return
            if not is_root:
                absorbed.add(node)
            if is_product:
                parts.products.append((sign, *operation[1:]))
            elif minus is not None:
                collect(minus, "+" if sign == "-" else "-", parts)
            else:
                for argument in operation[1:]:
                    collect(argument, sign, parts)

        for node in reversed(self._nodes):
            if node not in absorbed:
                before, parts = set(absorbed), _Convolution([], [])
                collect(node, "+", parts, is_root=True)
                if parts.products:
                    convolutions[node] = parts
                else:
                    absorbed = before
        return convolutions, absorbed

    def _negated(self, node: Node) -> Node | None:
        """Return the node whose negative this is, if it is any."""
        operation, *arguments = self._graph.operations[node]
        signs = [self._graph.operations[a] == ("number", -1.0) for a in arguments] if operation == "multiply" else []
        return arguments[signs.index(False)] if any(signs) else None

    def _convolution(self, node: Node) -> str:
        """Return a coefficient of a sum of products."""
        parts = self._convolutions[node]
        products = (f"{sign} product({self._series(a)}, {self._series(b)}, k)" for sign, a, b in parts.products)
        return " ".join([*products, *(f"{sign} v{other}" for sign, other in parts.others)])

    def _series(self, node: Node) -> str:
        """Return the place of the coefficients of a node."""
        operation = self._graph.operations[node]
        if operation[0] == "leaf":
            return f"leaves + {operation[1]} * stored"
        return f"kept + {self.kept[node]} * stored"

    def _keep(self, node: Node, k: str) -> Iterator[str]:
        if node in self.kept:
            yield f"  ({self._series(node)})[{k}] = v{node};"

    def _return(self, constant: str = "") -> Iterator[str]:
        for place, node in enumerate(self._outputs):
            yield f"  outputs[{place}] = {constant if constant and not self._graph.varies[node] else f'v{node}'};"

    def _value(self, node: Node) -> str:
        match self._graph.operations[node]:
            case ("leaf", number):
                return f"leaves[{number} * stored]"
            case ("input", number):
                return f"inputs[{number}]"
            case ("number", value):
                return f"all({value!r})"
            case ("add", a, b):
                return f"v{a} + v{b}"
            case ("multiply", a, b):
                return f"v{a} * v{b}"
            case ("divide", a, b):
                return f"v{a} / v{b}"
            case ("power", a, n):
                return f"raised(v{a}, v{n})"
            case ("function" | "integral", name, x, *_):
                return f"mapped({'log' if name == 'ln' else name}, v{x})"
            case ("choose", _, _, series, closed, _):
                return f"chosen({self._condition(node)}, v{series}, v{closed})"
        raise AssertionError(self._graph.operations[node])

    def _condition(self, node: Node) -> str:
        _, x, bound, *_ = self._graph.operations[node]
        return f"(masks)(absolute(v{x}) < v{bound})"

    def _coefficient(self, node: Node) -> Iterator[str]:
        varies = self._graph.varies
        into = f"  lanes v{node}"
        match self._graph.operations[node]:
            case ("leaf", number):
                yield f"{into} = leaves[{number} * stored + k];"
            case _ if node in self._convolutions:
                yield f"{into} = {self._convolution(node)};"
            case ("add", a, b):
                yield f"{into} = {' + '.join(f'v{x}' for x in (a, b) if varies[x])};"
            case ("multiply", a, b):
                yield f"{into} = v{a} * v{b};"
            case ("divide", a, b) if varies[b]:
                sums = f"quotient({self._series(b)}, {self._series(node)}, k)"
                yield f"{into} = ({f'v{a}' if varies[a] else ''} - {sums}) / ({self._series(b)})[0];"
            case ("divide", a, b):
                yield f"{into} = v{a} / v{b};"
            case ("power", a, n):
                sums = f"power({self._series(a)}, {self._series(node)}, v{n}, k)"
                yield f"{into} = {sums} / (({self._series(a)})[0] * (double)k);"
            case ("integral", _, x, derivative) if varies[derivative]:
                yield f"{into} = integral({self._series(x)}, {self._series(derivative)}, k) / (double)k;"
            case ("choose", _, _, *branches, divides):
                series, closed = (f"v{n}" if varies[n] else "(lanes){0}" for n in branches)
                mask = f"choices[{self.choices.get(node)}]"
                yield f"{into} = {f'chosen({mask}, {series}, {closed})' if divides else closed};"
            case operation:
                raise AssertionError(operation)
