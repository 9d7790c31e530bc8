"""Programs at points: their derivatives, their interpreter, and what is refused."""

from __future__ import annotations

import gc
import tempfile
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from helpers.reference_kernels import kernels_of_ffcx
from helpers.without_compiler import without_compiler

from hpcinv.base.parallel import cache_files
from hpcinv.base.parallel.code_cache import kept_in
from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.kinematics.ufl_formulas import UFL_FUNCTIONS
from hpcinv.physics.points import array_interpreter, form_programs, interpreter, kernels
from hpcinv.physics.points.array_interpreter import ArrayKernel
from hpcinv.physics.points.integrands import Integrand, Sources
from hpcinv.physics.points.interpreter import PointKernel
from hpcinv.physics.points.point_scalars import PointScalars
from hpcinv.physics.points.program import Program
from hpcinv.physics.points.program_files import Programs, kept_programs
from hpcinv.physics.points.scalar_graph import NotAnalytic, ScalarGraph
from hpcinv.physics.points.slopes import coefficients, gradient, slopes
from hpcinv.physics.points.tables import Tables

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
    "erf": ufl.erf,
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
    value = fem.Expression(f(x), POINTS)
    slope = fem.Expression(ufl.derivative(f(u), u, du), POINTS)
    cells = np.arange(6, dtype=np.int32)
    values, slopes_there = value.eval(CUBE, cells), slope.eval(CUBE, cells)
    with without_compiler():
        arrays = [fem.Expression(g, POINTS).eval(CUBE, cells) for g in (f(x), slope.ufl_expression)]
    for numpy, c in zip(arrays, (values, slopes_there), strict=True):
        np.testing.assert_array_max_ulp(numpy, c, maxulp=8)
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


@pytest.mark.parametrize("count", [1, 3, 4, 5, 8, 9, 17])
def test_cells_that_are_evaluated_together_have_their_own_values(count: int) -> None:
    """Of 4 or 8 points blocks of the interpreter have several cells, the last of which may not fill one."""
    points = np.random.default_rng(count).dirichlet(np.ones(4), size=count)[:, :3]
    u, c = fem.Function(fem.functionspace(CUBE, ("P", 2, (3,)))), fem.Constant(CUBE, np.array([0.7, 1.3]))
    u.interpolate(lambda x: (x[0] * x[1], np.sin(x[2]), x[0] + x[1] ** 2))
    x = ufl.SpatialCoordinate(CUBE)
    expression = ufl.as_vector([c[1] * ufl.exp(u[0]) + x[2], ufl.grad(u)[1, 2] / c[0], ufl.det(ufl.grad(u)), 4.0])
    alone = fem.Expression(expression, points)
    sources = Sources([u], [c])
    program = Integrand(CUBE.ufl_domain(), Tables(points), sources).expression(expression)
    for cells in (
        np.array(chosen, dtype=np.int32) for chosen in ([], [2], [4, 0, 3], [0, 1, 2, 3, 4], [5, 4, 3, 2, 1, 0])
    ):
        expected = alone.eval(CUBE, cells)
        programs = Programs.of_expression(program, sources.used)
        assert np.array_equal(PointKernel(programs, [u], [c]).eval(CUBE, cells), expected)
        with without_compiler():
            np.testing.assert_allclose(PointKernel(programs, [u], [c]).eval(CUBE, cells), expected, 1e-12, 1e-13)


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


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_in_reverse_agree_with_those_along_each_leaf(name: str) -> None:
    """Of a number in which several leaves meet, some of them twice."""
    u = fem.Function(fem.functionspace(CUBE, ("Lagrange", 1, (3,))))
    u.x.array[:] = np.random.default_rng(3).uniform(-0.4, 0.4, len(u.x.array))
    expression = FUNCTIONS[name](u[0] * u[1]) * (u[0] - 2 * u[2]) + ufl.sqrt(u[1] ** 2 + 1) / (u[2] + 3)
    sources = Sources([u], ())
    scalars = PointScalars(graph := ScalarGraph(), (u,))
    (root,) = scalars.of(expression)
    leaves = [scalars.function(u, component, -1) for component in range(3)]
    forward = [slopes(graph, [root], {leaf: graph.number(1.0)})[0] for leaf in leaves]
    nodes = [node for node in (*forward, *gradient(graph, root, leaves)) if node is not None]
    integrand = Integrand(CUBE.ufl_domain(), Tables(POINTS), sources, graph)
    kernel = PointKernel(Programs.of_expression(integrand.values(nodes), sources.used), [u], [])
    along, found = np.split(kernel.eval(CUBE, np.arange(6, dtype=np.int32)).reshape(-1, 6), 2, axis=1)
    np.testing.assert_allclose(found, along, 1e-12, 1e-13)


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
    values = fem.Expression(x, points).eval(CUBE, np.arange(6, dtype=np.int32))
    weights = np.column_stack([1 - points.sum(axis=1), points])
    assert values == pytest.approx(
        np.einsum("qn,cni->cqi", weights, CUBE.geometry.x[CUBE.geometry.dofmaps[0]]), abs=1e-15
    )


def test_angles_are_those_of_numpy_in_all_quadrants_and_on_the_axes() -> None:
    """With slopes ``(x dy - y dx)/(x² + y²)``, here of a turn about the origin, which is 1."""
    for y, x in [(1.0, 2.0), (2.0, 1.0), (2.0, -1.0), (1.0, -2.0), (-1.0, -2.0), (-2.0, 1.0), (0, 3), (0, -3), (3, 0)]:
        place, turn = fem.Constant(CUBE, np.array([x, y, 0.0])), ufl.variable(fem.Constant(CUBE, 0.0))
        turned = ufl.as_vector([place[0] - turn * place[1], place[1] + turn * place[0]])
        angle = ufl.atan2(turned[1], turned[0])
        both = ufl.as_vector([angle, ufl.diff(angle, turn)])
        values = fem.Expression(both, POINTS[:1]).eval(CUBE, np.zeros(1, dtype=np.int32)).ravel()
        np.testing.assert_allclose(values, [np.arctan2(y, x), 1.0], rtol=1e-14)
    origin = fem.Expression(ufl.atan2(fem.Constant(CUBE, 0.0), fem.Constant(CUBE, 0.0)), POINTS[:1])
    assert origin.eval(CUBE, np.zeros(1, dtype=np.int32)).item() == 0.0


@pytest.mark.parametrize("name", UFL_FUNCTIONS)
def test_programs_have_every_function_of_formulas(name: str) -> None:
    x, y, _ = ufl.SpatialCoordinate(CUBE)
    arguments = (x, y) if name in ("atan2", "min", "max") else (x,)
    assert kernels.missing_in_programs(ufl.as_ufl(UFL_FUNCTIONS[name](*arguments))) == ""


def test_programs_are_kept_and_read_again() -> None:
    program, sources = program_of(ufl.exp(ufl.SpatialCoordinate(CUBE)[1]))
    programs = Programs.of_expression(program, sources.used, ["a note", 3])
    again = Programs.from_bytes(programs.to_bytes())
    assert (again.functions, again.notes) == (programs.functions, programs.notes)
    made = []

    def make() -> Programs:
        made.append(1)
        return programs

    with tempfile.TemporaryDirectory() as name, kept_in(directory := Path(name)):
        for expected in (1, 1):
            kept_programs(MPI.COMM_SELF, b"a text", make)
            assert len(made) == expected
        (file,) = directory.glob("points_*.npz")
        file.write_bytes(file.read_bytes()[:-80] + bytes(80))  # damaged: made again
        kept_programs(MPI.COMM_SELF, b"a text", make)
        assert len(made) == 2
        other = Programs.of_expression(replace(program, slots=0), sources.used)  # complete, but of no use
        cache_files.publish(file, other.to_bytes())
        kept_programs(MPI.COMM_SELF, b"a text", make)
        assert len(made) == 3


def test_operators_that_programs_lack_are_named() -> None:
    space = fem.functionspace(CUBE, ("N1curl", 1))
    for expression, reason in (
        (fem.Function(space)[0], "element"),
        (ufl.CellVolume(CUBE), "CellVolume"),
        (ufl.FacetNormal(CUBE)[0], "normal"),
        (ufl.bessel_J(1, ufl.SpatialCoordinate(CUBE)[0]), "BesselJ"),
    ):
        with pytest.raises(NotAnalytic, match=reason):
            form_programs._expression_programs(expression, POINTS)


def forms_of_every_rank() -> list[Any]:
    """Forms with regions of cells and of facets, and functions, constants and nodes; the last one has no functions."""
    space = fem.functionspace(CUBE, ("P", 2, (3,)))
    u, v, du = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)
    u.interpolate(lambda x: 0.05 * np.sin(x + x[::-1]))
    cells = mesh.meshtags(CUBE, 3, np.arange(6, dtype=np.int32), np.array([7, 3, 3, 7, 3, 7], dtype=np.int32))
    CUBE.topology.create_connectivity(2, 3)
    faces = mesh.exterior_facet_indices(CUBE.topology)
    facets = mesh.meshtags(CUBE, 2, faces, (4 + 5 * (np.arange(len(faces)) % 2)).astype(np.int32))
    dx = ufl.Measure("dx", CUBE, subdomain_data=cells, metadata={"quadrature_degree": 2})
    ds = ufl.Measure("ds", CUBE, subdomain_data=facets, metadata={"quadrature_degree": 3})
    F, c = ufl.Identity(3) + ufl.grad(u), fem.Constant(CUBE, 2.0)
    volume = ufl.det(F)
    stress = c * F + ufl.ln(volume) * ufl.inv(F).T
    load = ufl.dot(ufl.inv(F).T * ufl.FacetNormal(CUBE), v)
    work = ufl.inner(stress, ufl.grad(v))
    residual = work * dx(7) + 2 * work * dx(3) + u[0] * load * ds(9) - u[1] * load * ds(4)
    position = ufl.SpatialCoordinate(CUBE)
    constant_load = c * ufl.dot(position, v) * dx(7)
    return [volume * dx(3) + volume * ds(9), residual, ufl.derivative(residual, u, du), constant_load]


def assembled(form: Any) -> np.ndarray:
    compiled = fem.form(form)
    match len(form.arguments()):
        case 0:
            return np.array([fem.assemble_scalar(compiled)])
        case 1:
            return np.asarray(fem.assemble_vector(compiled).array)
    return np.asarray(fem.assemble_matrix(compiled).to_dense())


@pytest.mark.parametrize("number", range(4))
def test_forms_are_the_same_without_a_compiler(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    form = forms_of_every_rank()[number]
    expected = assembled(form)
    calls: list[int] = []
    evaluate = ArrayKernel.evaluate

    def counted(kernel: ArrayKernel, w: Any, *others: Any) -> Any:
        calls.append(len(w))
        return evaluate(kernel, w, *others)

    monkeypatch.setattr(ArrayKernel, "evaluate", counted)
    with without_compiler():
        np.testing.assert_allclose(assembled(form), expected, rtol=0, atol=4e-16 * np.abs(expected).max())
    assert len(calls) == len(form.integrals())  # all cells of each at once
    assert sum(calls) > len(calls)


def test_cells_that_come_unexpectedly_are_computed_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    form = forms_of_every_rank()[1]
    expected = assembled(form)
    monkeypatch.setattr(array_interpreter, "_cells_of", lambda _arguments: (np.zeros(0), {}))
    with without_compiler():
        np.testing.assert_allclose(assembled(form), expected, rtol=0, atol=4e-16 * np.abs(expected).max())


def test_exceptions_in_a_kernel_are_raised_by_the_assembly(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(ArrayKernel, "evaluate", interrupted)
    with without_compiler(), pytest.raises(KeyboardInterrupt):
        assembled(forms_of_every_rank()[1])


def test_more_kernels_than_functions_take_another_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of an interpreter is full; forms that are gone leave their places."""
    monkeypatch.setattr(interpreter, "_MOST", 3)
    monkeypatch.setattr(interpreter, "_free", deque())
    monkeypatch.setattr(interpreter, "_copies", [interpreter._copy(0)])  # which has functions of other tests
    program, _ = program_of(ufl.SpatialCoordinate(CUBE)[0])
    kernels = [interpreter.Kernel([program]) for _ in range(7)]
    assert len({kernel.address for kernel in kernels}) == 7
    assert len(interpreter._copies) == 1 + 3
    assert len(interpreter._free) == 2
    del kernels
    gc.collect()
    assert len(interpreter._free) == 9
    values = fem.Expression(ufl.SpatialCoordinate(CUBE)[0], POINTS)
    assert values.eval(CUBE, np.array([0], dtype=np.int32)).shape == (1, 5)


def test_the_derivative_of_a_potential_is_its_virtual_work() -> None:
    """Also without a quadrature degree: UFL's estimate for products of quadratic functions is exact."""
    space = fem.functionspace(CUBE, ("P", 2, (3,)))
    u, v, du = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)
    u.interpolate(lambda x: 0.05 * np.sin(x + x[::-1]))
    energy = (ufl.inner(ufl.grad(u), ufl.grad(u)) / 2 + ufl.inner(u, u) * u[0] / 3) * ufl.dx(CUBE)
    work = ufl.inner(ufl.grad(u), ufl.grad(v)) + (2 * ufl.inner(u, v) * u[0] + ufl.inner(u, u) * v[0]) / 3
    forms = [ufl.derivative(energy, u, v), ufl.derivative(ufl.derivative(energy, u, v), u, du)]
    expected = work * ufl.dx(CUBE, degree=6)
    for form, other in zip(forms, (expected, ufl.derivative(expected, u, du)), strict=True):
        form_programs._form_programs(form)
        assert assembled(form) == pytest.approx(assembled(other), rel=0, abs=1e-14)


@pytest.mark.everyday("CellType.hexahedron")
@pytest.mark.parametrize("cell", [mesh.CellType.tetrahedron, mesh.CellType.hexahedron])
def test_expressions_on_facets_are_what_ffcx_compiles(cell: mesh.CellType) -> None:
    """At the middle of each facet: DOLFINx orders several points by the facet's vertices, and programs do not."""
    body = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1, cell)
    body.geometry.x[:] += 0.1 * np.sin(3 * body.geometry.x[:, ::-1])
    u = fem.Function(fem.functionspace(body, ("P", 2, (3,))))
    u.interpolate(lambda x: 0.1 * np.sin(x + 2 * x[::-1]))
    n, F = ufl.FacetNormal(body), ufl.Identity(3) + ufl.grad(u)
    ratio = abs(ufl.classes.FacetJacobianDeterminant(body)) * ufl.det(F)
    expression = ufl.as_vector([*ufl.SpatialCoordinate(body), *n, *ufl.dot(F, n), ratio])
    corners = 3 if cell == mesh.CellType.tetrahedron else 2
    entities = np.array([*np.ndindex(body.topology.index_map(3).size_local, 2 * (5 - corners))], dtype=np.int32)
    body.topology.create_connectivity(2, 3)
    body.topology.create_connectivity(3, 2)

    def values(points: np.ndarray) -> np.ndarray:
        return np.asarray(fem.Expression(expression, points).eval(body, entities))

    middle, more = np.full((1, 2), 1 / corners), np.array([[1 / corners, 1 / corners], [0.1, 0.2], [0.7, 0.1]])
    form_programs._expression_programs(expression, more)
    with kernels_of_ffcx():
        expected = values(middle)
    assert values(middle) == pytest.approx(expected, rel=0, abs=1e-15 * 8)
    several = values(more)
    assert several[:, :1] == pytest.approx(expected, rel=0, abs=1e-15 * 8)
    with without_compiler():
        assert values(more) == pytest.approx(several, rel=0, abs=1e-15 * 8)
