"""Compiled tangent moduli, which later processes find without UFL.

A record (`hpcinv.assembly.derivation_record`) names the kernel of a form, and the functions and constants of the form
that the kernel takes.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants

from hpcinv.assembly import tangent_moduli as derivation
from hpcinv.assembly.derivation_record import DerivationRecord
from hpcinv.assembly.tangent_moduli import Slot, Term, moduli_of, volume_parts
from hpcinv.kinematics import staged_derivatives
from hpcinv.mesh.cells import quadrature
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.jit import KernelExpression, compile_expression, load_expression
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.arrays import LocalIndices


@dataclass(frozen=True)
class CompiledModuli:
    """Moduli that are evaluated at the quadrature points of cells.

    Attributes:
        cells: the cells, ``None`` for the whole mesh.
        points, weights: quadrature rule on the reference cell, (points, 3) and (points,).
        pairs: slots of test and trial function, in the order of the values.
        expression: evaluates the moduli at these points, and perhaps at others.
        first: number that the first of these points has in the expression.
    """

    cells: LocalIndices | None
    points: Floats
    weights: Floats
    pairs: tuple[tuple[Slot, Slot], ...]
    expression: KernelExpression
    first: int = 0

    def values(self, mesh: Mesh, cells: LocalIndices) -> Floats:
        """Return the moduli at the present state, (cells, points, values)."""
        values: Floats = self.expression.eval(mesh, cells)
        return values[:, self.first : self.first + len(self.points)]


def compiled_moduli(
    form: Any, unknowns: Unknowns, jit_options: Mapping[str, Any], degree: int | None = None
) -> list[CompiledModuli]:
    """Return the moduli of a residual or of a `Term`, of a record or derived; collective; errors as of `moduli_of`.

    Args:
        degree: quadrature degree at whose points they are evaluated, if it is not the form's.
    """
    (moduli,) = _compiled(form, unknowns, jit_options, [degree])
    return moduli


def moduli_of_two_rules(
    form: Any, unknowns: Unknowns, jit_options: Mapping[str, Any], degree: int
) -> tuple[list[CompiledModuli], list[CompiledModuli]]:
    """Return the moduli at the points of the form, and at the points of another degree, as `compiled_moduli` does.

    Both are one kernel, which compiles in half the time of two, and always evaluates all points.
    """
    own, other = _compiled(form, unknowns, jit_options, [None, degree])
    return own, other


def _compiled(
    form: Any, unknowns: Unknowns, jit_options: Mapping[str, Any], degrees: Sequence[int | None]
) -> list[list[CompiledModuli]]:
    """Return the moduli for each of some degrees, ``None`` for the form's."""
    whole = ufl.replace(form.form, dict(form.factors)) if isinstance(form, Term) else form
    mesh, functions, constants = unknowns.mesh, whole.coefficients(), whole.constants()
    form_degree, parts = volume_parts(whole, unknowns)
    kind = mesh.basix_cell().name
    rules = [quadrature(kind, form_degree if degree is None else degree) for degree in degrees]
    points = np.concatenate([rule_points for rule_points, _ in rules])
    firsts = np.cumsum([0, *(len(weights) for _, weights in rules)])
    differentiated = None if isinstance(form, Term) else functions.index(unknowns.state)
    description = f"{whole.signature()} {differentiated}".encode() + points.tobytes()
    modules = derivation, staged_derivatives, sys.modules[__name__]
    record = DerivationRecord(mesh.comm, "moduli", description, modules, jit_options)
    kernels, directory = (
        [_RecordedKernel.from_data(data) for data in record.read() or ()],
        Path(jit_options["cache_dir"]),
    )
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
            kernels.append(_RecordedKernel(expression.file, expression.symbol, *places, tangent_moduli.pairs))
            loaded.append(expression)
        record.write([astuple(kernel) for kernel in kernels])
    return [
        [
            CompiledModuli(part.cells, *rule, kernel.pairs, expression, int(first))
            for part, kernel, expression in zip(parts, kernels, loaded, strict=True)
        ]
        for rule, first in zip(rules, firsts, strict=False)
    ]


@dataclass(frozen=True)
class _RecordedKernel:
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
    def from_data(cls, data: Any) -> _RecordedKernel:
        file, symbol, functions, constants, pairs = data
        return cls(file, symbol, functions, constants, tuple((Slot(*test), Slot(*trial)) for test, trial in pairs))


def _loaded(
    kernel: _RecordedKernel, functions: Sequence[Any], constants: Sequence[Any], directory: Path
) -> KernelExpression | None:
    used = [functions[i] for i in kernel.functions], [constants[i] for i in kernel.constants]
    return load_expression(kernel.file, kernel.symbol, *used, directory)
