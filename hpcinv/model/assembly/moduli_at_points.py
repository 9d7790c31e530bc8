"""Tangent moduli at the quadrature points of cells (`hpcinv.model.assembly.tangent_moduli`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import ufl

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.cells import quadrature
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.tangent_moduli import Slot, Term, UnsupportedForm, VolumePart, slots_of, volume_parts
from hpcinv.model.spaces import Unknowns
from hpcinv.physics.points.integrands import Integrand, Sources
from hpcinv.physics.points.interpreter import PointKernel
from hpcinv.physics.points.program_files import Programs, kept_programs
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.physics.points.tables import Tables


@dataclass(frozen=True)
class ModuliAtPoints:
    """Moduli that are evaluated at the quadrature points of cells.

    Attributes:
        cells: the cells, ``None`` for the whole mesh.
        points, weights: quadrature rule on the reference cell, (points, 3) and (points,).
        pairs: slots of test and trial function, in the order of the values.
        kernel: evaluates the moduli at these points, and perhaps at others.
        first: number that the first of these points has in the kernel.
    """

    cells: LocalIndices | None
    points: Floats
    weights: Floats
    pairs: tuple[tuple[Slot, Slot], ...]
    kernel: PointKernel
    first: int = 0

    def values(self, mesh: Mesh, cells: LocalIndices) -> Floats:
        """Return the moduli at the present state, (cells, points, values)."""
        values: Floats = self.kernel.eval(mesh, cells)
        return values[:, self.first : self.first + len(self.points)]


def moduli_at_points(form: Any, unknowns: Unknowns, degree: int | None = None) -> list[ModuliAtPoints]:
    """Return the moduli of a residual or of a `Term`, part by part as `volume_parts`; collective.

    Args:
        degree: quadrature degree at whose points they are evaluated, if it is not the form's.

    Raises:
        UnsupportedForm: if the form is not as `tangent_moduli` says, for example by an effect of a plugin.
    """
    (moduli,) = _at_points(form, unknowns, [degree])
    return moduli


def moduli_of_two_rules(
    form: Any, unknowns: Unknowns, degree: int
) -> tuple[list[ModuliAtPoints], list[ModuliAtPoints]]:
    """Return the moduli at the points of the form, and at the points of another degree, as `moduli_at_points` does.

    Both are one kernel, which always evaluates all points.
    """
    own, other = _at_points(form, unknowns, [None, degree])
    return own, other


def _at_points(form: Any, unknowns: Unknowns, degrees: Sequence[int | None]) -> list[list[ModuliAtPoints]]:
    """Return the moduli for each of some degrees, ``None`` for the form's."""
    whole = ufl.replace(form.form, dict(form.factors)) if isinstance(form, Term) else form
    mesh, functions, constants = unknowns.mesh, whole.coefficients(), whole.constants()
    form_degree, parts = volume_parts(whole, unknowns)
    kind = mesh.basix_cell().name
    rules = [quadrature(kind, form_degree if degree is None else degree) for degree in degrees]
    points = np.concatenate([rule_points for rule_points, _ in rules])
    firsts = np.cumsum([0, *(len(weights) for _, weights in rules)])
    trial = form.trial if isinstance(form, Term) else unknowns.state
    differentiated = None if isinstance(form, Term) else functions.index(trial)
    description = f"moduli {whole.signature()} {differentiated}".encode() + points.tobytes()

    def make(part: VolumePart) -> Programs:
        sources = Sources(functions, constants)
        maker = Integrand(mesh.ufl_domain(), Tables(points), sources)
        program, pairs = maker.moduli(part.integrand, unknowns.test, trial, [slot.members for slot in slots])
        return Programs.of_expression(program, sources.used, pairs)

    slots = slots_of(unknowns.parts)
    found = []
    for number, part in enumerate(parts):
        try:
            kept = kept_programs(mesh.comm, description + b" %d" % number, partial(make, part))
        except NotAnalytic as reason:
            raise UnsupportedForm(str(reason)) from None
        pairs = tuple((slots[i], slots[j]) for i, j in kept.notes)
        found.append((part.cells, pairs, PointKernel(kept, functions, constants)))
    return [
        [ModuliAtPoints(cells, *rule, pairs, kernel, int(first)) for cells, pairs, kernel in found]
        for rule, first in zip(rules, firsts, strict=False)
    ]
