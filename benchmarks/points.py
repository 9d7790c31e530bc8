"""Programs at points against the kernels that FFCx compiles: seconds to make them, and microseconds a point.

A cube of 3,072 quadratic tetrahedra, 14 points each; processor time, the best of five.

Command: python benchmarks/points.py
"""

import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# isort: split
import basix.ufl
import dolfinx.jit
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from hpcinv.base.parallel.code_cache import kept_in
from hpcinv.output.console import table_console, table_of_numbers
from hpcinv.physics.points.ffcx_fallback import FLAGS, jit_of_dolfinx

LAWS = "neo-Hooke", "Mooney-Rivlin", "Holzapfel-Ogden"


def energy(law: str, F: Any) -> Any:
    """Return a strain energy; fibres of the last are constant."""
    J, C = ufl.det(F), F.T * F
    I1 = ufl.tr(C) * J ** (-2 / 3)
    bulk = 25 * (J**2 - 1 - 2 * ufl.ln(J))
    if law == "neo-Hooke":
        return (I1 - 3) / 2 + bulk
    if law == "Mooney-Rivlin":
        I2 = (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2 * J ** (-4 / 3)
        return 0.3 * (I1 - 3) + 0.2 * (I2 - 3) + bulk
    a, b = (ufl.as_vector([math.cos(t), math.sin(t), 0.0]) for t in (0.3, 0.3 + math.pi / 2))
    terms = (18.472, 16.026, ufl.inner(a, C * a) - 1), (2.481, 11.12, ufl.inner(b, C * b) - 1)
    sheets = *terms, (0.216, 11.436, ufl.inner(a, C * b))
    fibres = sum(k / (2 * m) * (ufl.exp(m * e**2) - 1) for k, m, e in sheets)
    return 0.059 / (2 * 8.023) * (ufl.exp(8.023 * (I1 - 3)) - 1) + fibres + bulk


def residual(law: str, direction: str, u: fem.Function) -> Any:
    h, v = ufl.grad(u), ufl.TestFunction(u.function_space)
    F = ufl.variable(ufl.inv(ufl.Identity(3) - h) if direction == "inverse" else ufl.Identity(3) + h)
    P = ufl.diff(energy(law, F), F)
    stress = P * F.T / ufl.det(F) if direction == "inverse" else P
    return ufl.inner(stress, ufl.grad(v)) * ufl.dx(metadata={"quadrature_degree": 4})


def best(action: Callable[[], object]) -> float:
    seconds = []
    for _ in range(5):
        start = time.process_time()
        action()
        seconds.append(time.process_time() - start)
    return min(seconds)


def measured(form: Any, jit: Any) -> tuple[float, float]:
    """Return the seconds to make a kernel, and for one assembly."""
    dolfinx.jit.ffcx_jit = jit
    with tempfile.TemporaryDirectory() as directory:
        options = {"cffi_extra_compile_args": list(FLAGS), "cache_dir": Path(directory)}
        with kept_in(Path(directory)):
            start = time.perf_counter()
            compiled = fem.form(form, jit_options=options)
            made = time.perf_counter() - start
    if compiled.rank == 1:
        return made, best(lambda: fem.assemble_vector(compiled))
    matrix = fem.create_matrix(compiled)
    return made, best(lambda: fem.assemble_matrix(matrix, compiled))


def main() -> None:
    body = mesh.create_unit_cube(MPI.COMM_SELF, 8, 8, 8)
    u = fem.Function(fem.functionspace(body, basix.ufl.element("Lagrange", "tetrahedron", 2, shape=(3,))))
    u.x.array[:] = 0.003 * np.random.default_rng(0).normal(size=u.x.array.size)
    points, interpreted = 14 * body.topology.index_map(3).size_local, dolfinx.jit.ffcx_jit
    measured(u[0] * ufl.TestFunction(u.function_space)[0] * ufl.dx(degree=2), interpreted)  # compiles the interpreter
    table = table_of_numbers("law", "made, s", "FFCx, s", "µs a point", "FFCx, µs")
    for law in LAWS:
        for direction in ("forward", "inverse"):
            R = residual(law, direction, u)
            for name, form in (("residual", R), ("tangent", ufl.derivative(R, u))):
                rows = [measured(form, jit) for jit in (interpreted, jit_of_dolfinx)]
                numbers = *(made for made, _ in rows), *(1e6 * seconds / points for _, seconds in rows)
                table.add_row(f"{law}, {direction}, {name}", *(f"{number:.2f}" for number in numbers))
    table_console().print(table)


if __name__ == "__main__":
    main()
