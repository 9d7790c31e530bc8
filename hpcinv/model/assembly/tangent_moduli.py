"""Tangent moduli: derivatives of the integrand of a residual by displacement, pressure and their gradients.

A volume integral of the residual is ``∫ Σ_a s_a(…) · δ_a dx``, where ``δ`` runs over the test functions and their
gradients, and ``s`` over their duals, such as stresses. Its tangent is ``∫ Σ_ab δ_a · ∂s_a/∂e_b · Δ_b dx``,
where ``e`` are the unknowns and their gradients. The moduli ``∂s_a/∂e_b`` depend on the residual; the rest of the
tangent is the same for all laws (`hpcinv.model.assembly.element_matrices`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import quadrature_metadata
from hpcinv.model.spaces import Unknowns


class UnsupportedForm(Exception):
    """Raised for a residual whose form has no tangent moduli; the message gives the reason."""


@dataclass(frozen=True)
class Slot:
    """A test function or its gradient, and the corresponding unknown.

    Attributes:
        part: 0 for the displacement, 1 for the pressure.
        components: 3 or 1.
        is_gradient: whether it is the gradient, with respect to the reference cell.
    """

    part: int
    components: int
    is_gradient: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of its dual: components, then directions of the gradient."""
        return (self.components, 3) if self.is_gradient else (self.components,)

    @property
    def members(self) -> list[tuple[int, int]]:
        """Number of each component among all unknowns of a point, and direction of its derivative, -1 for its value."""
        directions = range(3) if self.is_gradient else (-1,)
        return [(3 * self.part + i, b) for i in range(self.components) for b in directions]


@dataclass(frozen=True)
class Term:
    """A bilinear form over the volume, which is added to a tangent.

    Attributes:
        form: the form, with symbols for its factors that are neither test nor trial function.
        trial: its trial function.
        factors: UFL expressions of the symbols.
    """

    form: Any
    trial: Any
    factors: Mapping[Any, Any]


@dataclass(frozen=True)
class VolumePart:
    """Integrand of the volume integrals of a form over the same cells.

    Attributes:
        cells: the cells, ``None`` for the whole mesh.
        integrand: the sum of the integrands.
    """

    cells: npt.NDArray[np.int32] | None
    integrand: Any


def volume_parts(form: Any, unknowns: Unknowns) -> tuple[int, list[VolumePart]]:
    """Return the quadrature degree of the volume integrals of a form, and their parts; collective.

    Raises:
        UnsupportedForm: if quadratures differ, or the regions of the integrals do not cover all cells once.
    """
    integrals = [integral for integral in form.integrals() if integral.integral_type() == "cell"]
    degree = _quadrature_degree(integrals, unknowns.mesh.basix_cell().name)
    regions: dict[Any, list[Any]] = {}
    for integral in integrals:
        regions.setdefault(integral.subdomain_id(), []).append(integral.integrand())
    common = regions.pop("everywhere", []) + regions.pop("otherwise", [])
    if not regions:
        return degree, [VolumePart(None, sum(common[1:], common[0]))]
    if not all(isinstance(number, int) for number in regions):
        raise UnsupportedForm("a volume integral is over several regions at once")
    given = [integral.subdomain_data() for integral in integrals if integral.subdomain_id() in regions]
    if any(data is not given[0] for data in given):
        raise UnsupportedForm("its volume integrals are over regions of different measures")
    cells = dict(given[0])
    _check_cover(unknowns, [cells[number] for number in regions])
    return degree, [VolumePart(cells[number], sum((*own[1:], *common), own[0])) for number, own in regions.items()]


def _quadrature_degree(integrals: Sequence[Any], kind: str) -> int:
    """Return the one degree of volume integrals on cells of some kind."""
    degree = integrals[0].metadata().get("quadrature_degree") if integrals else None
    if isinstance(degree, int):
        metadata = quadrature_metadata(kind, degree)
        if all(integral.metadata() == metadata for integral in integrals):
            return degree
    raise UnsupportedForm("its volume integrals do not have the quadrature of hpcinv")


def _check_cover(unknowns: Unknowns, regions: list[npt.NDArray[np.int32]]) -> None:
    """Check that regions contain each owned cell of the mesh once; collective."""
    mesh = unknowns.mesh
    owned = mesh.topology.index_map(3).size_local
    here = np.sort(np.concatenate([cells[cells < owned] for cells in regions]))
    if not mesh.comm.allreduce(np.array_equal(here, np.arange(owned)), op=MPI.LAND):
        raise UnsupportedForm("its volume integrals over regions leave cells out, or count some twice")


def slots_of(parts: Sequence[int]) -> list[Slot]:
    """Return the slots of parts with numbers of components, the gradient of each part before its value."""
    return [Slot(part, count, is_gradient) for part, count in enumerate(parts) for is_gradient in (True, False)]
