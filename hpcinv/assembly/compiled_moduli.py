"""Compiled tangent moduli, and records by which later processes find them without UFL.

UFL takes half a second or more to derive the moduli of a form, whether their kernel is compiled or not. A record beside
the kernels tells which kernel belongs to a form, and which of the form's functions and constants it takes. The name of
a record is a hash of all that the derivation depends on: the form, the function by which it is differentiated, the
quadrature points, the programs that derive and compile, and the compiler's flags.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cache
from hashlib import sha1
from pathlib import Path
from typing import Any

import ffcx
import ufl
from ffcx.codegeneration import get_signature
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants

from hpcinv.assembly import tangent_moduli as derivation
from hpcinv.assembly.tangent_moduli import Slot, Term, moduli_of, volume_parts
from hpcinv.kinematics import staged_derivatives
from hpcinv.mesh.cells import quadrature
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Integers, Unknowns
from hpcinv.parallel.jit import KernelExpression, compile_expression, load_expression, read_record, write_record
from hpcinv.parallel.runtime import MPI


@dataclass(frozen=True)
class CompiledModuli:
    """Moduli that are evaluated at the quadrature points of cells.

    Attributes:
        cells: the cells, ``None`` for the whole mesh.
        points, weights: quadrature rule on the reference cell, (points, 3) and (points,).
        pairs: slots of test and trial function, in the order of the values.
        expression: evaluates to (cells, points, values) at the present state.
    """

    cells: Integers | None
    points: Floats
    weights: Floats
    pairs: tuple[tuple[Slot, Slot], ...]
    expression: KernelExpression


def compiled_moduli(
    form: Any, unknowns: Unknowns, jit_options: Mapping[str, Any], degree: int | None = None
) -> list[CompiledModuli]:
    """Return the moduli of a residual or of a `Term`, of a record or derived; collective; errors as of `moduli_of`.

    Args:
        degree: quadrature degree at whose points they are evaluated, if it is not that of the form.
    """
    whole = ufl.replace(form.form, dict(form.factors)) if isinstance(form, Term) else form
    mesh, functions, constants = unknowns.mesh, whole.coefficients(), whole.constants()
    form_degree, parts = volume_parts(whole, unknowns)
    points, weights = quadrature(mesh.basix_cell().name, form_degree if degree is None else degree)
    differentiated = None if isinstance(form, Term) else functions.index(unknowns.state)
    name, directory = _name(whole.signature(), differentiated, points, jit_options), Path(jit_options["cache_dir"])
    recorded, record = mesh.comm.bcast((name, read_record(name, directory)) if mesh.comm.rank == 0 else None)
    # Flags depend on the processor: rank 0 may know of kernels that this one cannot run.
    is_known = record is not None and recorded == name
    kernels = [_Kernel.from_data(data) for data in json.loads(record)] if is_known else []
    candidates = [_loaded(kernel, functions, constants, directory) for kernel in kernels]
    loaded = [moduli for moduli in candidates if moduli is not None]
    if not mesh.comm.allreduce(len(loaded) == len(parts), op=MPI.LAND):
        kernels, loaded = [], []
        for tangent_moduli in moduli_of(form, unknowns):
            used = (
                list(extract_coefficients(tangent_moduli.expression)),
                list(extract_constants(tangent_moduli.expression)),
            )
            expression = compile_expression(mesh.comm, tangent_moduli.expression, points, *used, jit_options)
            places = [functions.index(f) for f in used[0]], [constants.index(c) for c in used[1]]
            kernels.append(_Kernel(expression.file, expression.symbol, *places, tangent_moduli.pairs))
            loaded.append(expression)
        if mesh.comm.rank == 0:
            write_record(name, json.dumps([astuple(kernel) for kernel in kernels]), directory)
    return [
        CompiledModuli(part.cells, points, weights, kernel.pairs, expression)
        for part, kernel, expression in zip(parts, kernels, loaded, strict=True)
    ]


@dataclass(frozen=True)
class _Kernel:
    """Entry of a record.

    Attributes:
        file, symbol: of the kernel.
        functions, constants: those it takes, by their numbers in the form.
    """

    file: str
    symbol: str
    functions: list[int]
    constants: list[int]
    pairs: tuple[tuple[Slot, Slot], ...]

    @classmethod
    def from_data(cls, data: Any) -> _Kernel:
        file, symbol, functions, constants, pairs = data
        return cls(file, symbol, functions, constants, tuple((Slot(*test), Slot(*trial)) for test, trial in pairs))


def _loaded(
    kernel: _Kernel, functions: Sequence[Any], constants: Sequence[Any], directory: Path
) -> KernelExpression | None:
    used = [functions[i] for i in kernel.functions], [constants[i] for i in kernel.constants]
    return load_expression(kernel.file, kernel.symbol, *used, directory)


def _name(signature: str, differentiated: int | None, points: Floats, jit_options: Mapping[str, Any]) -> str:
    flags = jit_options.get("cffi_extra_compile_args")
    description = f"{signature} {differentiated} {flags} {_programs()}".encode()
    return f"moduli_{sha1(description + points.tobytes()).hexdigest()}"


@cache
def _programs() -> str:
    """Return a hash of the programs that derive moduli, and the versions of those that compile them."""
    files = (str(derivation.__file__), str(staged_derivatives.__file__), __file__)
    ours = b"".join(Path(file).read_bytes() for file in files)
    return f"{sha1(ours).hexdigest()} {ufl.__version__} {ffcx.__version__} {get_signature()}"
