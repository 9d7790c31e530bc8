"""Symbols in FFCx's graph of a form, which `hpcinv.parallel.jit` finds by another way."""

import hpcinv.parallel.jit  # noqa: F401  (replaces the function)

# isort: split
import basix.ufl
import ufl
from ffcx.ir.analysis.graph import build_graph_vertices
from ffcx.ir.analysis.valuenumbering import ValueNumberer


class Numberer(ValueNumberer):  # type: ignore[misc]  # without types
    """Numberer that compares an expression with all others in turn, as FFCx does."""

    def get_node_symbols(self, expr: object) -> object:
        return self.V_symbols[next(i for i, v in self.G.nodes.items() if v["expression"] == expr)]


def test_symbols_agree_with_a_search_through_all_expressions() -> None:
    mesh = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
    H = ufl.Constant(mesh, (3, 3))
    F = ufl.Identity(3) + H
    stress = ufl.det(F) * ufl.inv(F).T + F * ufl.dot(H.T, H) + ufl.as_tensor([H[0, :], H[:, 1], F[2, :]])
    graph = build_graph_vertices([ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(stress)], False)
    symbols = ValueNumberer(graph).compute_symbols()
    assert len(symbols) > 50
    assert symbols == Numberer(graph).compute_symbols()
