"""Forms and expressions as DOLFINx' kernels, which the interpreter runs; what programs do not have is compiled by FFCx."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha1
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import basix
import dolfinx.jit
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.fem import IntegralType
from ufl.algorithms.analysis import extract_coefficients, extract_constants

from hpcinv.parallel import jit
from hpcinv.parallel.runtime import MPI
from hpcinv.points import point_scalars
from hpcinv.points.integrands import Integrand, Sources
from hpcinv.points.interpreter import Kernel
from hpcinv.points.program import Program
from hpcinv.points.scalar_graph import NotAnalytic
from hpcinv.points.tables import Tables, cell_rule, facet_rule

JIT_OPTIONS = jit.JIT_OPTIONS
_TYPES = tuple(IntegralType.__members__)


@dataclass(frozen=True)
class _Integral:
    """Programs of one domain of integration, and which functions they take."""

    kind: str
    number: int
    cell: int
    enabled: tuple[bool, ...]
    programs: tuple[Program, ...]


def _form_programs(form: Any) -> tuple[list[int], list[_Integral]]:
    """Return the functions that a form takes, and its programs."""
    (mesh,) = form.ufl_domains()
    if not point_scalars.is_supported(mesh):
        raise NotAnalytic("its mesh is not one of solids")
    kind, rank = mesh.ufl_coordinate_element().cell_type.name, len(form.arguments())
    sources = Sources(form.coefficients(), form.constants())
    groups: dict[tuple[int, int], dict[str, tuple[Any, list[Any]]]] = {}
    for integral in form.integrals():
        if integral.integral_type() not in ("cell", "exterior_facet"):
            raise NotAnalytic(f"it has integrals over {integral.integral_type()}s")
        identity = integral.subdomain_id()
        for number in identity if isinstance(identity, tuple) else (identity,):
            place = _TYPES.index(integral.integral_type()), -1 if isinstance(number, str) else int(number)
            rules = groups.setdefault(place, {})
            rules.setdefault(repr(integral.metadata()), (integral.metadata(), []))[1].append(integral.integrand())
    integrals = []
    for (type_number, number), rules in sorted(groups.items()):
        is_cell = _TYPES[type_number] == "cell"
        programs, functions = [], set[Any]()
        for metadata, integrands in rules.values():
            for integrand in _joined(integrands):
                tables = Tables(*(cell_rule if is_cell else facet_rule)(kind, metadata))
                maker = Integrand(mesh, tables, sources)
                programs.append(maker.form(integrand, "volume" if is_cell else "area", rank))
                functions |= maker.functions
        cell = basix.CellType[kind]
        domain = cell if is_cell else basix.cell.subentity_types(cell)[2][0]
        integrals.append((_TYPES[type_number], number, int(domain), functions, tuple(programs)))
    order = range(len(sources.used))
    return sources.used, [
        _Integral(kind, number, cell, tuple(i in {sources.number(f) for f in functions} for i in order), programs)
        for kind, number, cell, functions, programs in integrals
    ]


def _joined(integrands: Sequence[Any]) -> list[Any]:
    """Return integrands of which those that are not derivatives are one sum."""
    derivatives = [i for i in integrands if isinstance(i, ufl.classes.CoefficientDerivative)]
    others = [i for i in integrands if not isinstance(i, ufl.classes.CoefficientDerivative)]
    return [*derivatives, *([sum(others[1:], others[0])] if others else [])]


def _expression_programs(expression: Any, points: npt.NDArray[np.float64]) -> tuple[list[int], list[_Integral]]:
    domains = ufl.domain.extract_domains(expression)
    if len(domains) != 1 or not point_scalars.is_supported(domains[0]) or points.shape[1] != 3:
        raise NotAnalytic("its mesh is not one of solids, or its points are on facets")
    sources = Sources(extract_coefficients(expression), extract_constants(expression))
    program = Integrand(domains[0], Tables(points), sources).expression(expression)
    return sources.used, [_Integral("expression", 0, 0, (True,) * len(sources.used), (program,))]


def _packed(used: Sequence[int], integrals: Sequence[_Integral]) -> bytes:
    """Return programs as the bytes of a file."""
    head = [(i.kind, i.number, i.cell, list(map(int, i.enabled)), len(i.programs)) for i in integrals]
    arrays = {"head": np.array(json.dumps([list(used), head]))}
    for n, integral in enumerate(integrals):
        for k, program in enumerate(integral.programs):
            arrays |= program.to_arrays(f"{n}_{k}_")
    with io.BytesIO() as file:
        np.savez(file, **arrays)
        return file.getvalue()


def _unpacked(content: bytes) -> tuple[list[int], list[_Integral]]:
    """Return the programs of a file; raise ``ValueError`` or ``KeyError`` for one that is damaged."""
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        used, head = json.loads(str(arrays["head"]))
        integrals = []
        for n, (kind, number, cell, enabled, count) in enumerate(head):
            programs = tuple(Program.from_arrays(arrays, f"{n}_{k}_") for k in range(count))
            integrals.append(_Integral(kind, number, cell, tuple(map(bool, enabled)), programs))
    return used, integrals


def _programs(comm: MPI.Intracomm, item: Any, directory: Path) -> tuple[list[int], list[_Integral]]:
    """Return the programs of a form or expression, from the cache or made on rank 0; collective."""
    content, fault = b"", ""
    if comm.rank == 0:
        name = f"points_{sha1(_SOURCE + _signature(item)).hexdigest()}"
        kept = jit.read_data(name, directory)
        if kept is not None:
            content = kept
        else:
            try:
                content = _packed(
                    *(_form_programs(item) if isinstance(item, ufl.Form) else _expression_programs(*item))
                )
            except NotAnalytic as reason:
                fault = str(reason)
            else:
                jit.write_data(name, content, directory)
    content, fault = comm.bcast((content, fault))
    if fault:
        raise NotAnalytic(fault)
    return _unpacked(content)


def _signature(item: Any) -> bytes:
    if isinstance(item, ufl.Form):
        return str(item.signature()).encode()
    expression, points = item
    renumbering = {f: i for i, f in enumerate([*ufl.domain.extract_domains(expression)])}
    for functions in (extract_coefficients(expression), extract_constants(expression)):
        renumbering |= {f: i for i, f in enumerate(functions)}
    signature = ufl.algorithms.signature.compute_expression_signature(expression, renumbering)
    return str(signature).encode() + points.tobytes() + repr(points.shape).encode()


_SOURCE = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
"""programs depend on the modules that make them"""


class _Made:
    """Structures of UFCx; they keep what they refer to."""

    def __init__(self) -> None:
        self.ffi = jit.interface()
        self.kept: list[Any] = []

    def array(self, kind: str, values: Sequence[Any]) -> Any:
        made = self.ffi.new(f"{kind}[]", list(values)) if values else self.ffi.NULL
        self.kept.append(made)
        return made

    def kernel(self, programs: Sequence[Program]) -> Any:
        kernel = Kernel(programs)
        self.kept.append(kernel)
        return self.ffi.cast("ufcx_tabulate_tensor_float64 *", kernel.address)

    def form(self, form: Any, used: Sequence[int], integrals: Sequence[_Integral]) -> Any:
        ffi, mesh = self.ffi, form.ufl_domains()[0]
        parts = []
        for integral in integrals:
            part = ffi.new("ufcx_integral *")
            part.enabled_coefficients = self.array("bool", integral.enabled)
            part.tabulate_tensor_float64 = self.kernel(integral.programs)
            part.needs_facet_permutations = False
            part.coordinate_element_hash = mesh.ufl_coordinate_element().basix_hash()
            part.domain = integral.cell
            parts.append(part)
        self.kept += parts
        made = ffi.new("ufcx_form *")
        made.signature = self.array("char", [b"\0"])
        made.rank = len(form.arguments())
        made.num_coefficients = len(used)
        made.original_coefficient_positions = self.array("int", used)
        constants = form.constants()
        made.num_constants = len(constants)
        made.constant_ranks = self.array("int", [len(c.ufl_shape) for c in constants])
        made.constant_shapes = self.array("int *", [self.array("int", c.ufl_shape) for c in constants])
        made.finite_element_hashes = self.array("uint64_t", [0] * (made.rank + len(used)))
        made.form_integrals = self.array("ufcx_integral *", parts)
        made.form_integral_ids = self.array("int", [integral.number for integral in integrals])
        counts = [sum(integral.kind == kind for integral in integrals) for kind in _TYPES]
        made.form_integral_offsets = self.array("int", np.cumsum([0, *counts]).tolist())
        self.kept.append(made)
        return made[0]

    def expression(
        self, expression: Any, points: npt.NDArray[np.float64], used: Sequence[int], integral: _Integral
    ) -> Any:
        made = self.ffi.new("ufcx_expression *")
        made.tabulate_tensor_float64 = self.kernel(integral.programs)
        made.num_coefficients = len(used)
        made.original_coefficient_positions = self.array("int", used)
        constants = extract_constants(expression)
        made.num_constants = len(constants)
        made.num_points, made.entity_dimension = points.shape
        made.points = self.array("double", points.ravel().tolist())
        made.value_shape = self.array("int", expression.ufl_shape)
        made.num_components = len(expression.ufl_shape)
        made.rank = 0
        (mesh,) = ufl.domain.extract_domains(expression)
        made.coordinate_element_hash = mesh.ufl_coordinate_element().basix_hash()
        self.kept.append(made)
        return made[0]


def kernels_of(comm: MPI.Intracomm, item: Any, directory: Path) -> tuple[Any, Any, tuple[str, _Made]]:
    """Return what DOLFINx' just-in-time compiler returns for a form, or for an expression and points; collective.

    In place of the code, which DOLFINx keeps, are the structures.

    Raises:
        NotAnalytic: it has what programs do not have.
    """
    used, integrals = _programs(comm, item, directory)
    made = _Made()
    structure = (
        made.form(item, used, integrals) if isinstance(item, ufl.Form) else made.expression(*item, used, integrals[0])
    )
    return structure, SimpleNamespace(ffi=made.ffi, file="", symbols=("",)), ("", made)


def _jit(comm: MPI.Intracomm, item: Any, form_compiler_options: Any = None, jit_options: Any = None) -> Any:
    """Interpret a form or expression; compile what programs do not have."""
    directory = Path((jit_options or {}).get("cache_dir", jit.DIRECTORY))
    options: Mapping[str, Any] = form_compiler_options or {}
    if np.dtype(options.get("scalar_type", np.float64)) == np.float64:
        try:
            return kernels_of(comm, item, directory)
        except NotAnalytic:
            pass
    return _compiled(comm, item, form_compiler_options=form_compiler_options, jit_options=jit_options)


_compiled = dolfinx.jit.ffcx_jit
dolfinx.jit.ffcx_jit = _jit
