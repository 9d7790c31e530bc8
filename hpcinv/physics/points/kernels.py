"""Forms and expressions as kernels of DOLFINx that the interpreter runs; FFCx compiles what programs do not have.

Only plugins have such terms: messages name their file and line.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import cffi
import dolfinx.jit
import ffcx.codegeneration.jit as ffcx_jit
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.fem import IntegralType
from ufl.algorithms.analysis import extract_coefficients, extract_constants

from hpcinv.base.parallel.runtime import MPI
from hpcinv.on_demand import on_demand
from hpcinv.physics.points.ffcx_fallback import compiled_by_ffcx, term_places
from hpcinv.physics.points.interpreter import kernel_of
from hpcinv.physics.points.program import EXPRESSION, Place, Program
from hpcinv.physics.points.program_files import Programs, kept_programs
from hpcinv.physics.points.scalar_graph import NotAnalytic

_TYPES = tuple(IntegralType.__members__)


@cache
def _interface() -> Any:
    """Return CFFI's description of the C types of kernels."""
    interface = cffi.FFI()
    interface.cdef(ffcx_jit.UFC_HEADER_DECL.format("float64"))
    for declarations in (ffcx_jit.UFC_INTEGRAL_DECL, ffcx_jit.UFC_FORM_DECL, ffcx_jit.UFC_EXPRESSION_DECL):
        interface.cdef(declarations)
    return interface


def _signature(item: Any) -> bytes:
    """Return a text that is the same for equal forms, or for equal expressions at equal points."""
    if isinstance(item, ufl.Form):
        return str(item.signature()).encode()
    expression, points = item
    numbers = {f: i for i, f in enumerate(ufl.domain.extract_domains(expression))}
    for functions in (extract_coefficients(expression), extract_constants(expression)):
        numbers |= {f: i for i, f in enumerate(functions)}
    text = ufl.algorithms.signature.compute_expression_signature(expression, numbers)
    return bytes(f"{text} {points.shape}".encode() + points.tobytes())


class Structures:
    """Structures of UFCx, which keep what they refer to."""

    def __init__(self) -> None:
        self.ffi = _interface()
        self._kept: list[Any] = []

    def form(self, form: Any, programs: Programs) -> Any:
        """Return the structure of a form."""
        ffi, integrals = self.ffi, programs.integrals
        mesh_hash = form.ufl_domains()[0].ufl_coordinate_element().basix_hash()
        parts = []
        counts = Counter[str]()
        for integral in integrals:
            part = ffi.new("ufcx_integral *")
            part.enabled_coefficients = self._array("bool", integral.enabled)
            part.tabulate_tensor_float64 = self._kernel(integral.programs, (integral.kind, counts[integral.kind]))
            counts[integral.kind] += 1
            part.coordinate_element_hash = mesh_hash
            part.domain = integral.cell
            parts.append(part)
        made = ffi.new("ufcx_form *")
        made.signature = self._array("char", [b"\0"])
        made.rank = len(form.arguments())
        made.num_coefficients = len(programs.functions)
        made.original_coefficient_positions = self._array("int", programs.functions)
        constants = form.constants()
        made.num_constants = len(constants)
        made.constant_ranks = self._array("int", [len(c.ufl_shape) for c in constants])
        made.constant_shapes = self._array("int *", [self._array("int", c.ufl_shape) for c in constants])
        made.coefficient_name_map = self._names("w", len(programs.functions))
        made.constant_name_map = self._names("c", len(constants))
        made.finite_element_hashes = self._array("uint64_t", [0] * (made.rank + len(programs.functions)))
        made.form_integrals = self._array("ufcx_integral *", parts)
        made.form_integral_ids = self._array("int", [integral.number for integral in integrals])
        made.form_integral_offsets = self._array("int", np.cumsum([0, *(counts[kind] for kind in _TYPES)]).tolist())
        self._kept += [*parts, made]
        return made[0]

    def expression(
        self, programs: Programs, points: npt.NDArray[np.float64], shape: Sequence[int], constants: int, mesh: Any
    ) -> Any:
        """Return the structure of an expression with a number of constants, on cells of a UFL mesh."""
        made = self.ffi.new("ufcx_expression *")
        made.tabulate_tensor_float64 = self._kernel(programs.integrals[0].programs, EXPRESSION)
        made.num_coefficients = len(programs.functions)
        made.original_coefficient_positions = self._array("int", programs.functions)
        made.num_constants = constants
        made.num_points, made.entity_dimension = points.shape
        made.points = self._array("double", points.ravel().tolist())
        made.value_shape = self._array("int", shape)
        made.num_components = len(shape)
        made.coordinate_element_hash = mesh.ufl_coordinate_element().basix_hash()
        self._kept.append(made)
        return made[0]

    def _array(self, kind: str, values: Sequence[Any]) -> Any:
        made = self.ffi.new(f"{kind}[]", list(values)) if values else self.ffi.NULL
        self._kept.append(made)
        return made

    def _names(self, letter: str, count: int) -> Any:
        """Return the names by which DOLFINx finds functions and constants of a form that was compiled without them."""
        texts = [[c.encode("ascii") for c in f"{letter}{i}\0"] for i in range(count)]
        return self._array("char *", [self._array("char", text) for text in texts])

    def _kernel(self, programs: Sequence[Program], place: Place) -> Any:
        kernel = kernel_of(programs, place)
        self._kept.append(kernel)
        return self.ffi.cast("ufcx_tabulate_tensor_float64 *", kernel.address)


def kernels_of(comm: MPI.Intracomm, item: Any) -> tuple[Any, Any, tuple[str, Structures]]:
    """Return what DOLFINx' just-in-time compiler returns for a form, or for an expression and points; collective.

    DOLFINx keeps the structures, which it takes for the code.

    Raises:
        NotAnalytic: it has what programs do not have.
    """
    structures, description = Structures(), _signature(item)
    if isinstance(item, ufl.Form):
        made = structures.form(item, kept_programs(comm, description, lambda: on_demand("programs of a form")(item)))
    else:
        expression, points = item
        programs = kept_programs(comm, description, lambda: on_demand("programs of a form")(item))
        (mesh,) = ufl.domain.extract_domains(expression)
        constants = len(extract_constants(expression))
        made = structures.expression(programs, points, expression.ufl_shape, constants, mesh)
    return made, SimpleNamespace(ffi=structures.ffi), ("", structures)


def _jit(comm: MPI.Intracomm, item: Any, form_compiler_options: Any = None, jit_options: Any = None) -> Any:
    """Interpret a form or expression; compile what programs do not have.

    Raises:
        SystemPartMissing: on all ranks, if it has to be compiled, and there is no compiler.
    """
    options: Mapping[str, Any] = form_compiler_options or {}
    missing = "its numbers are not of double precision"
    if np.dtype(options.get("scalar_type", np.float64)) == np.float64:
        try:
            return kernels_of(comm, item)
        except NotAnalytic as reason:
            missing = str(reason)
    return compiled_by_ffcx(comm, item, missing, form_compiler_options, jit_options)


def missing_in_programs(item: Any) -> str:
    """Return what a form, or an expression, has and programs do not; "" if they have all."""
    try:
        on_demand("programs of a form")(item if isinstance(item, ufl.Form) else (item, np.full((1, 3), 0.25)))
    except NotAnalytic as reason:
        return str(reason)
    except Exception as error:  # UFL's errors have many types; whoever compiles the item reports it
        return f"{type(error).__name__}: {error}"
    return ""


def noted[T](where: str, method: Callable[..., Any], term: T) -> T:
    """Return a term; note its place if it is of a plugin, and has what programs do not have.

    Args:
        where: place of the law or effect in the job.
        method: of the law or effect, which made the term.
    """
    owner = type(getattr(method, "__self__", None))
    if term is None or owner.__module__.partition(".")[0] == "hpcinv":
        return term
    if missing := missing_in_programs(term):
        is_inherited = method.__module__.partition(".")[0] == "hpcinv"
        source: Any = owner if is_inherited else method
        term_places[missing] = f"{where}: {inspect.getsourcefile(owner)}, line {_line_of(source, missing)}"
    return term


def _line_of(source: Any, missing: str) -> int:
    """Return the line of a class or method that names what is missing, or its first one."""
    lines, first = inspect.getsourcelines(source)
    words = [word.lower() for word in missing.replace("'", " ").split() if word[:1].isupper()]
    words += ["grad(grad(", "grad("] if "derivatives" in missing else []
    found = (n for word in words for n, line in enumerate(lines) if word in line.replace("_", "").lower())
    return first + next(found, 0)


dolfinx.jit.ffcx_jit = _jit
