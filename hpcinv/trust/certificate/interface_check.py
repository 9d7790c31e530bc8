"""Bodies in contact: gaps at the nodes of both surfaces, searched anew, their least pressure, and their forces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.units import readable
from hpcinv.model.interfaces.node_gaps import NodeGaps
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Topic, Verdict, topic, upper_bound_line
from hpcinv.trust.certificate.shape import point_text

UNLOADED = topic(
    "overlap of the unloaded bodies at '…'",
    "Whether nodes of one unloaded body lie in the other one. A search of its own looks for them.",
    "Assume another closure: with this pressure no such unloaded bodies can exist.",
    computed="gaps at the nodes of both surfaces, searched anew",
    thresholds="above 1/256 of the body; never",
)
LOADED = topic(
    "overlap of the loaded bodies at '…'",
    "Whether nodes of one loaded body lie in the other one. Given surfaces may overlap or stand apart by segmentation.",
    "Refine the surfaces, or correct the segmentation where they overlap.",
    computed="gaps at the nodes of both surfaces, searched anew",
    thresholds="above 1/256 of the body; never",
)
PRESSURE = topic(
    "least contact pressure at '…'",
    "Bodies in contact press on each other, and do not pull.",
    "Report this: the solve should have parted them.",
    computed="smallest nodal pressure, and the largest",
    thresholds="never; below 0",
)
BALANCE = topic(
    "forces on both bodies at '…'",
    "The bodies exert equal and opposite forces on each other.",
    "Report this: integrals over both surfaces should agree.",
    computed="sum of the nodal forces on both surfaces, relative to the force on one",
    thresholds="above 1e-9; above 1e-6",
)
_DEEP = 2.0**-8  # of the body's length
_ROUNDED = 1e-9  # share of the largest pressure below which it may pull


class InterfaceCheck(Check):
    """Check gaps, pressures and forces of bodies in contact."""

    name, order = "surfaces in contact", 32

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and any(i.kind == "contact" for i in run.solution.job.all_interfaces)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution = run.equations, run.solution
        equations.put(solution)
        length, scales, unknowns = equations.body.length, equations.scales, equations.unknowns
        reports = {report.where: report for report in solution.contacts}
        for pair in equations.weak_form(solution.direction).contacts.pairs:
            if pair.spec.kind != "contact":
                continue
            place, report = pair.spec.between[0], reports[pair.where]
            for topic_of_gaps, loaded in ((LOADED, True), (UNLOADED, False)):
                gaps = pair.node_gaps(loaded=loaded)
                yield _gap_line(topic_of_gaps.placed(place), gaps, length, scales.length)
                gaps.destroy()
            pressures = pair.pressures * scales.stress
            least, largest = float(pressures.min(initial=0.0)), float(np.abs(pressures).max(initial=0.0))
            verdict = Verdict.PASS if least >= -_ROUNDED * largest else Verdict.FAIL
            note = f"at most {readable(largest, 'Pa')}"
            yield Line(PRESSURE.placed(place), least + 0.0, "Pa", "fail below 0", verdict, note)
            if pair.has_obstacle:
                continue
            forces = np.zeros(unknowns.state.x.index_map.size_local * unknowns.state.x.block_size)
            pair.add_forces(forces)
            total = forces[unknowns.owned_displacement_dofs].reshape(-1, 3).sum(axis=0)
            both = np.asarray(equations.body.mesh.comm.allreduce(total, op=MPI.SUM)) * scales.stress * scales.length**2
            size = float(np.linalg.norm(report.force))
            share = float(np.linalg.norm(both)) / size if size else 0.0
            yield upper_bound_line(BALANCE.placed(place), share, 1e-9, 1e-6, note=f"force {readable(size, 'N')}")


def _gap_line(about: Topic, gaps: NodeGaps, length: float, unit: float) -> Line:
    """Return the line of the deepest node of two surfaces."""
    limit = _DEEP * length * unit
    rule = f"warning above {readable(limit, 'm')}"
    if not len(gaps.gaps):
        return Line(about, None, "m", rule, Verdict.UNDECIDED, "no node faces the other surface")
    worst, widest = int(gaps.gaps.argmin()), int(gaps.gaps.argmax())
    depth = max(0.0, -float(gaps.gaps[worst])) * unit
    (low, there), (high, elsewhere) = (
        (readable(float(gaps.gaps[node]) * unit, "m"), point_text(gaps.points[node] * unit)) for node in (worst, widest)
    )
    note = f"smallest gap {low} at ({there}) m, largest {high} at ({elsewhere}) m"
    verdict = Verdict.PASS if depth <= limit else Verdict.WARN
    return Line(about, depth, "m", rule, verdict, note)
