"""Checks of the volume ratio, and of the part of it that the pressure does not explain.

The volumetric strain ``θ`` of a law follows its pressure, ``θ = -p/Λ``, and is zero where the law is incompressible. A
discrete solution in the mixed form has this in the mean only: ``|θ + p/Λ|`` is its local error.
In the displacement form the pressure follows from the displacement, and oscillates where nearly incompressible cells
lock; there ``|θ - θ̄|`` is used, with means ``θ̄`` over the cells around each vertex, interpolated between vertices.

Only elastic strains count; growth and thermal expansion may change the volume. The value judged is the one exceeded in
1 % of the volume: where stress is singular, as at the edge of a clamped face, the largest value has no limit on fine
meshes, but the share of the volume with large values vanishes.

Source: Hughes, *The Finite Element Method*, 1987, ch. 4 (locking, and pressures that oscillate).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import jacobians, quadrature, scalar_element
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.materials import MaterialLaw
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, lower_bound_line, topic, upper_bound_line

type Reals = npt.NDArray[np.floating[Any]]

SMALLEST_RATIO = topic(
    "smallest volume ratio J",
    "Strongest compression of the material anywhere; at zero an element is inverted.",
    "Check load and moduli, or refine the mesh where J is small ('hpcinv show --colour J').",
    computed="least J = det F",
    thresholds="below 0.1; ≤ 0",
)
LARGEST_RATIO = topic(
    "largest volume ratio J",
    "Strongest swelling of the material anywhere.",
    "Check load and moduli, or refine the mesh where J is large ('hpcinv show --colour J').",
    computed="largest J",
    thresholds="above 10; never",
)
UNACCOUNTED = topic(
    "volume ratio not explained by the pressure, exceeded in 1 % of the volume",
    "Volume change of nearly incompressible material that its pressure does not cause.",
    "Use smaller cells, or in solids 'discretisation: {displacement: 3}'.",
    computed="volumetric strain of nearly incompressible material without the strain of its pressure",
    thresholds="above 0.05; never",
    judges_mesh=True,
)
SHARE = 0.01
SMALLEST, LARGEST = 0.1, 10.0
"""Volume ratios beyond which no elastic law of a solid was measured; farther apart, fewer runs warn"""
WARN = 0.05  # volumetric strain without its pressure; the discretisation error of the shape has the same threshold
STIFF = 10.0  # bulk over shear modulus (Poisson's ratio 0.45) from which linear displacements lock noticeably


class VolumeCheck(Check):
    """Check the volume ratio."""

    name, order = "volume", 50

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution = run.equations, run.solution
        smallest, largest = solution.J_range
        squeezed = _where(equations, solution, -1) if 0.0 < smallest < SMALLEST else ""
        swollen = _where(equations, solution, 1) if LARGEST < largest < np.inf else ""
        yield lower_bound_line(SMALLEST_RATIO, smallest, warn=SMALLEST, fail=0.0, note=squeezed)
        yield upper_bound_line(LARGEST_RATIO, largest, warn=LARGEST, fail=float("inf"), note=swollen)
        strain = unexplained_strain(equations, solution)
        if strain is None:  # compressible: any volume ratio may be right
            return
        rule = f"warning above {WARN:g}"
        if strain <= WARN:
            yield Line(UNACCOUNTED, strain, "", rule, Verdict.PASS)
        else:
            mixed = equations.unknowns.p is not None
            what = "the mesh is too coarse" if mixed else "the mesh is too coarse, or locks in the displacement form"
            yield Line(UNACCOUNTED, strain, "", rule, Verdict.WARN, what)


def unexplained_strain(equations: Equations, solution: Solution) -> float | None:
    """Return the volumetric strain that the pressure does not explain, exceeded in `SHARE` of the volume; collective.

    ``None`` for compressible materials.
    """
    equations.put(solution)
    return _unaccounted(equations, equations.weak_form(solution.direction))


def _where(equations: Equations, solution: Solution, sign: int) -> str:
    """Return in what share of the undeformed volume cells swell (``sign`` 1) or shrink so far, and where; collective.

    Where stress is singular, as at the edge of a clamped face, this share vanishes on fine meshes.
    """
    mesh, kind, degree = equations.body.mesh, equations.body.source.kind, equations.body.degree
    owned = mesh.topology.index_map(3).size_local
    nodes = solution.reference_nodes[mesh.geometry.dofmaps[0][:owned]]
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    volumes = np.abs(np.linalg.det(jacobians(kind, degree, nodes, middle)))[:, 0]
    logarithms = sign * np.log(np.maximum(solution.J.x.array[:owned], np.finfo(float).tiny))
    is_beyond = logarithms > np.log(LARGEST if sign > 0 else 1.0 / SMALLEST)
    part, whole = (mesh.comm.allreduce(float(v.sum())) for v in (volumes[is_beyond], volumes))
    if not part:
        return "at single points; the mean over no cell is so far from 1"
    worst = int(np.argmax(logarithms)) if owned else 0
    best = (float(logarithms[worst]), nodes[worst].mean(axis=0).tolist()) if owned else (-np.inf, [0.0] * 3)
    place = ", ".join(f"{c:.4g}" for c in max(mesh.comm.allgather(best))[1])
    text = f"beyond it in {part / whole:.2%} of the volume, most at ({place}) m of the undeformed body"
    return text if part < SHARE * whole else f"{text}: no elastic law of a solid was measured so far"


def _is_stiff(law: MaterialLaw, par: Any) -> Any:
    """Return 1 where a law is nearly incompressible, else 0."""
    ratio = law.stiffness_ratio
    if ratio is not None:
        return float(ratio >= STIFF)
    stiff = ufl.ge(law.bulk_modulus(par), STIFF * law.shear_modulus(par))  # moduli vary in the body
    return ufl.conditional(stiff, ufl.as_ufl(1.0), ufl.as_ufl(0.0))


def _unaccounted(equations: Equations, weak_form: WeakForm) -> float | None:
    """Return the strain exceeded in `SHARE` of the nearly incompressible volume; ``None`` if there is none."""
    laws, mesh = list(equations.job.laws.values()), equations.body.mesh
    ratios = [law.stiffness_ratio for law in laws]
    if all(ratio is not None and ratio < STIFF for ratio in ratios):
        return None
    p, comm = equations.unknowns.p, mesh.comm
    _, weights = quadrature(mesh.basix_cell().name, weak_form.quadrature_degree)
    cells = [np.zeros(0, dtype=np.int32)]
    points = [np.zeros((0, len(weights), 2), dtype=np.float32)]  # strain, and the volume that counts
    for number, law in enumerate(laws):
        for some, samples in _strain_and_volume(weak_form, number, law):
            samples[..., 1] *= weights
            cells.append(some)
            points.append(samples.astype(np.float32))
    strains, counted = np.moveaxis(np.concatenate(points), -1, 0)
    if comm.allreduce(float(counted.sum())) <= 0.0:
        return None
    if p is None:
        strains = strains - _smoothed(equations, weak_form, np.concatenate(cells), strains, counted)
    return _exceeded(comm, np.abs(strains), counted)


def _strain_and_volume(weak_form: WeakForm, number: int, law: MaterialLaw) -> QuadratureValues:
    """Return the strain in a part of the body and the density of the volume that counts; kept with the form."""
    ratio, unknowns = law.stiffness_ratio, weak_form.unknowns
    key = f"unexplained strain of part {number}, stiff: {ratio is None or ratio >= STIFF}"
    if key not in weak_form.derived:
        part, par = weak_form.parts[number], weak_form.parameters.quantities(number)
        strain = part.dilatation
        if unknowns.p is not None and not law.is_incompressible:
            strain = strain + unknowns.p / law.volumetric_modulus(par)
        counted = _is_stiff(law, par) * abs(ufl.JacobianDeterminant(unknowns.mesh))
        weak_form.derived[key] = QuadratureValues(
            ufl.as_vector([strain, counted]), unknowns.mesh, weak_form.quadrature_degree, part.cells
        )
    values: QuadratureValues = weak_form.derived[key]
    return values


def _smoothed(
    equations: Equations, weak_form: WeakForm, cells: npt.NDArray[np.int32], strains: Reals, volumes: Reals
) -> Reals:
    """Return means of the strains (cells, points) over the volume around each vertex, interpolated to the points."""
    mesh = equations.body.mesh
    dofmap = fem.functionspace(mesh, ("Lagrange", 1)).dofmap
    dofs = dofmap.list[cells]
    sums = la.vector(dofmap.index_map, 2)
    totals = sums.array.reshape(-1, 2)
    np.add.at(totals, dofs, np.stack([(strains * volumes).sum(axis=1), volumes.sum(axis=1)], axis=1)[:, None])
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    points, _ = quadrature(mesh.basix_cell().name, weak_form.quadrature_degree)
    shapes = scalar_element(equations.body.source.kind, 1).tabulate(0, points)[0, :, :, 0]
    means = totals[:, 0] / np.where(totals[:, 1] > 0, totals[:, 1], 1.0)
    return np.asarray(means[dofs] @ shapes.T)


def _exceeded(comm: MPI.Intracomm, values: Reals, volumes: Reals) -> float:
    """Return the value exceeded in `SHARE` of the volume; not finite if any value is not; collective."""
    if not comm.allreduce(bool(np.isfinite(values).all()), op=MPI.LAND):
        return float("inf")
    limit = SHARE * comm.allreduce(float(volumes.sum()))
    low, high = 0.0, float(comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))
    for _ in range(50):  # values of all ranks need not be gathered
        middle = (low + high) / 2
        if comm.allreduce(float(volumes[values > middle].sum())) > limit:
            low = middle
        else:
            high = middle
    return high
