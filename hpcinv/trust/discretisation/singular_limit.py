"""Effect of singular edges on an error estimate: the share that it misses, and the order of convergence.

An estimate by one degree more finds a part of the error of a singular edge only: errors of quantities fall as
``(h/p²)^2λ`` with the size of cells and their degree, so that it finds ``1 - (p/(p + 1))^4λ`` in cells that touch the
edge: 0.59 and 0.47 at a re-entrant corner of 270°, for degrees 2 and 3. The rest is presumed, in proportion to the
estimate of these cells.

In the mixed form an error of the displacement raises an energy, and an error of the pressure lowers it. Where both are
of one size, they cancel in a quantity, on one mesh and not on the next. They are if the correction changes the volume
of cells nearly as much as their shape.

Around a singular point of fibres the deformation looks the same at every size, so that the cells there have errors of
the strains that neither a smaller cell nor a higher degree reduces: two degrees may agree on a wrong value.

Source: Babuška & Suri, SIAM Review 36, 578–632 (1994), doi:10.1137/1036141.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.solver.equations import Equations
from hpcinv.trust.discretisation.estimate import SingularLimit
from hpcinv.trust.discretisation.singular_edges import FIBRES, SingularEdges
from hpcinv.trust.discretisation.wedge_exponents import SMOOTH

SHARE = 0.3
"""Share of the error at singular edges from which errors may cancel; a larger one trusts more estimates."""
FIBRE_SHARE = 0.1
"""Share of the error at singular fibres from which an estimate is unreliable; a larger one trusts more estimates."""
VOLUME = 0.5
"""Ratio of `volume_share` from which they do; a larger one trusts more estimates. Measured: below it effectivities of
0.6 to 1.3, above it -4 to 3 (docs/theory/error-estimate.md)."""


def singular_limit(
    equations: Equations, edges: SingularEdges, indicators: Floats, correction: fem.Function
) -> SingularLimit | None:
    """Return the effect of singular edges; ``None`` if cells with an error touch none; collective.

    Args:
        indicators: share of the estimate of each owned cell, as in `Estimate.cells`.
        correction: of the displacement.
    """
    mesh, degree = equations.body.mesh, equations.job.discretisation.displacement
    touching = edges.exponents < SMOOTH
    missed = np.where(touching, 1 / (1 - (degree / (degree + 1)) ** (4 * edges.exponents)), 1.0)
    whole = indicators * missed
    kind_sums = np.bincount(edges.kinds[touching], whole[touching], minlength=len(edges.names))
    sums = np.array(
        [indicators.sum(), whole.sum(), whole[touching].sum(), (whole * 4.0**-edges.exponents)[touching].sum()]
    )
    totals, kind_sums = (mesh.comm.allreduce(values, op=MPI.SUM) for values in (sums, kind_sums))
    if not (np.isfinite(totals).all() and totals[2] > 0):
        return None
    shares = kind_sums / totals[1]
    fibre_kind = edges.names.index(FIBRES) if FIBRES in edges.names else -1
    has_fibres = fibre_kind >= 0 and bool(shares[fibre_kind] > FIBRE_SHARE)
    kind = fibre_kind if has_fibres else int(shares.argmax())
    here = np.where(edges.kinds == kind, whole, -1.0)
    position = _place_of_largest(equations.body, edges, here)
    order = -math.log2(totals[3] / totals[2])
    share, factor = float(totals[2] / totals[1]), float(totals[1] / totals[0])
    may_cancel = equations.unknowns.p is not None and share > SHARE
    is_reliable = not (has_fibres or (may_cancel and volume_share(correction, touching) > VOLUME))
    orders = np.where(touching, 2 * edges.exponents, np.inf)
    return SingularLimit(share, order, factor, is_reliable, edges.names[kind], position, missed, orders)


def _place_of_largest(body: Body, edges: SingularEdges, sizes: Floats) -> tuple[float, float, float]:
    """Return the middle (m) of the segment of an edge that is nearest to the cell of the largest value; collective."""
    mesh, middle = body.mesh, np.zeros(3)
    if len(sizes):
        nodes = mesh.geometry.dofmaps[0][int(sizes.argmax())][: mesh.ufl_cell().num_vertices]
        middle = mesh.geometry.x[nodes].mean(axis=0) * body.length_scale
    x, y, z = edges.segments[int(_distances(edges.segments, middle).argmin())].mean(axis=0).tolist()
    _, x, y, z = max(mesh.comm.allgather((float(sizes.max(initial=-1.0)), x, y, z)))
    return x, y, z


def volume_share(correction: fem.Function, cells: npt.NDArray[np.bool_]) -> float:
    """Return ``∫ (div δ)² dx / ∫ 2 |sym ∇δ|² dx`` of a displacement over some of the owned ``cells``; collective."""
    mesh = correction.function_space.mesh
    strain, is_volume = ufl.sym(ufl.grad(correction)), fem.Constant(mesh, 0.0)
    chosen = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    chosen.x.array[chosen.function_space.dofmap.list[: len(cells), 0]] = cells
    integrand = is_volume * ufl.tr(strain) ** 2 + (1 - is_volume) * 2 * ufl.inner(strain, strain)
    degree = 2 * correction.function_space.ufl_element().degree - 2
    form = fem.form(chosen * integrand * ufl.dx(mesh, metadata={"quadrature_degree": degree}))
    sums = []
    for is_volume.value in (1.0, 0.0):
        sums.append(mesh.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM))
    return float(sums[0] / sums[1]) if sums[1] > 0 else 0.0


def _distances(segments: Floats, point: Floats) -> Floats:
    """Return distances (n,) of a point from the segments (n, 2, 3)."""
    sides = segments[:, 1] - segments[:, 0]
    shares = np.einsum("ij,ij->i", point - segments[:, 0], sides) / np.einsum("ij,ij->i", sides, sides)
    nearest = segments[:, 0] + np.clip(shares, 0, 1)[:, None] * sides
    return np.asarray(np.linalg.norm(point - nearest, axis=1))
