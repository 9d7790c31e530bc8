"""Programs at points: their derivatives, their interpreter, and what is refused."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh

from hpcinv.parallel import kernel_files
from hpcinv.parallel.runtime import MPI
from hpcinv.points import kernels
from hpcinv.points.integrands import Integrand, Sources
from hpcinv.points.kernels import JIT_OPTIONS
from hpcinv.points.program import Program
from hpcinv.points.program_files import Programs, kept_programs
from hpcinv.points.scalar_graph import NotAnalytic, ScalarGraph
from hpcinv.points.slopes import coefficients, slopes
from hpcinv.points.tables import Tables

CUBE = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
POINTS = np.array([[0.1, 0.2, 0.3], [0.5, 0.1, 0.2], [0.25, 0.25, 0.25], [0.2, 0.6, 0.1], [0.7, 0.1, 0.1]])
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "abs": abs,
    "sqrt": lambda x: ufl.sqrt(x + 1),
    "power": lambda x: (x + 1) ** 1.7,
    "integer power": lambda x: (x + 1) ** -3,
    "varying exponent": lambda x: (x + 2) ** (x / 2),
    **{
        f.__name__: f
        for f in (ufl.exp, ufl.sin, ufl.cos, ufl.tan, ufl.sinh, ufl.cosh, ufl.tanh, ufl.asin, ufl.acos, ufl.atan)
    },
    "ln": lambda x: ufl.ln(x + 2),
    "division": lambda x: (x - 1) / (x + 3),
    "conditional": lambda x: ufl.conditional(ufl.lt(x, 0.3), x**2, 1 - x),
    "nested conditions": lambda x: ufl.conditional(ufl.And(ufl.ge(x, 0.1), ufl.Not(ufl.le(x, 0.2))), 2 * x, x**3),
    "either condition": lambda x: ufl.conditional(ufl.Or(ufl.gt(x, 0.5), ufl.eq(x, 0.1)), 1.0, ufl.exp(x)),
    "smallest": lambda x: ufl.min_value(x, 0.3) * x,
    "largest": lambda x: ufl.max_value(0.3, x) * x,
}


def _scaled(position: Any) -> Any:
    return 0.9 * position[0] - 0.1


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_and_their_slopes_are_those_of_ufl(name: str) -> None:
    """UFL evaluates values itself; slopes are compared with differences of them."""
    x = _scaled(ufl.SpatialCoordinate(CUBE))
    space = fem.functionspace(CUBE, ("P", 1))
    u, du = fem.Function(space), fem.Function(space)
    u.interpolate(_scaled)
    du.x.array[:] = 1.0
    f = FUNCTIONS[name]
    value = fem.Expression(f(x), POINTS, jit_options=JIT_OPTIONS)
    slope = fem.Expression(ufl.derivative(f(u), u, du), POINTS, jit_options=JIT_OPTIONS)
    cells = np.arange(6, dtype=np.int32)
    values, slopes_there = value.eval(CUBE, cells), slope.eval(CUBE, cells)
    nodes = CUBE.geometry.x[CUBE.geometry.dofmaps[0]]
    weights = np.column_stack([1 - POINTS.sum(axis=1), POINTS])
    places = np.einsum("qn,cni->cqi", weights, nodes)

    def exact(at: float) -> float:
        return float(ufl.as_ufl(f(ufl.as_ufl(at)))(()))  # UFL evaluates some at once

    for c, q in np.ndindex(values.shape[:2]):
        at, step = _scaled(places[c, q]), 1e-6
        assert values[c, q] == pytest.approx(exact(at), rel=1e-13, abs=1e-13)
        assert slopes_there[c, q] == pytest.approx(
            (exact(at + step) - exact(at - step)) / (2 * step), rel=1e-7, abs=1e-7
        )


def test_coefficients_are_refused_of_what_is_not_linear() -> None:
    graph = ScalarGraph()
    v, x = graph.input("v"), graph.input("x")
    (coefficient,) = coefficients(graph, graph.multiply(graph.number(3.0), graph.multiply(x, v)), x, [v])
    assert coefficient == graph.multiply(x, graph.multiply(graph.number(3.0), x))
    assert coefficients(graph, x, x, [v]) == [None]
    with pytest.raises(NotAnalytic, match="linear"):
        coefficients(graph, graph.multiply(v, v), x, [v])


def test_slopes_vanish_of_what_does_not_depend_on_the_leaf() -> None:
    graph = ScalarGraph()
    u, x = graph.leaf("u"), graph.input("x")
    outputs = [graph.multiply(x, x), graph.add(u, x), graph.compare("<", u, x)]
    assert slopes(graph, outputs, {u: graph.number(1.0)}) == [None, graph.number(1.0), None]


def program_of(expression: Any, points: np.ndarray = POINTS) -> tuple[Program, Sources]:
    sources = Sources(ufl.algorithms.extract_coefficients(expression), ())
    return Integrand(CUBE.ufl_domain(), Tables(points), sources).expression(expression), sources


@pytest.mark.parametrize("change", ["operation", "slot", "gather", "table", "result"])
def test_a_program_that_would_read_elsewhere_is_refused(change: str) -> None:
    program, _ = program_of(ufl.SpatialCoordinate(CUBE)[0] ** 2 + 1)
    program.check()
    field, column = {"operation": ("rows", 0), "slot": ("rows", 4), "gather": ("rows", 1)}.get(change, ("", 0))
    if change == "table":
        field, column = "gathers", 4
    if change == "result":
        field, column = "results", 0
    for wrong in (-1, 10_000):
        table = getattr(program, field).copy()
        table[0, column] = wrong
        with pytest.raises(ValueError, match="does not have"):
            replace(program, **{field: table}).check()


@pytest.mark.parametrize("count", [1, 4, 5, 8, 9, 16, 17, 40])
def test_any_number_of_points_fills_blocks(count: int) -> None:
    points = np.random.default_rng(count).dirichlet(np.ones(4), size=count)[:, :3]
    x = ufl.SpatialCoordinate(CUBE)
    values = fem.Expression(x, points, jit_options=JIT_OPTIONS).eval(CUBE, np.arange(6, dtype=np.int32))
    weights = np.column_stack([1 - points.sum(axis=1), points])
    assert values == pytest.approx(
        np.einsum("qn,cni->cqi", weights, CUBE.geometry.x[CUBE.geometry.dofmaps[0]]), abs=1e-15
    )


def test_programs_are_kept_and_read_again() -> None:
    program, sources = program_of(ufl.exp(ufl.SpatialCoordinate(CUBE)[1]))
    programs = Programs.of_expression(program, sources.used, ["a note", 3])
    again = Programs.from_bytes(programs.to_bytes())
    assert (again.functions, again.notes) == (programs.functions, programs.notes)
    made = []

    def make() -> Programs:
        made.append(1)
        return programs

    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        for expected in (1, 1):
            kept_programs(MPI.COMM_SELF, b"a text", make, directory)
            assert len(made) == expected
        (file,) = directory.glob("points_*.npz")
        file.write_bytes(file.read_bytes()[:-80] + bytes(80))  # damaged: made again
        kept_programs(MPI.COMM_SELF, b"a text", make, directory)
        assert len(made) == 2
        other = Programs.of_expression(replace(program, slots=0), sources.used)  # complete, but of no use
        kernel_files.publish(file, other.to_bytes())
        kept_programs(MPI.COMM_SELF, b"a text", make, directory)
        assert len(made) == 3


def test_what_programs_do_not_have_is_named() -> None:
    space = fem.functionspace(CUBE, ("N1curl", 1))
    for expression, reason in (
        (fem.Function(space)[0], "element"),
        (ufl.CellVolume(CUBE), "cellvolume"),
        (ufl.FacetNormal(CUBE)[0], "normal"),
        (ufl.bessel_J(1, ufl.SpatialCoordinate(CUBE)[0]), "bessel"),
    ):
        with pytest.raises(NotAnalytic, match=reason):
            kernels._expression_programs(expression, POINTS)
