"""A line on the volume ratio at the faces of a shell, beyond the quadrature points of its layer."""

from collections.abc import Iterator

import numpy as np

from hpcinv.mesh.cells import scalar_element
from hpcinv.model.quadrature_values import PointValues
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, lower_bound_line, topic
from hpcinv.trust.certificate.volume import SMALLEST_RATIO

FACES = topic(
    f"{SMALLEST_RATIO.name} at the faces of the shell",
    SMALLEST_RATIO.meaning,
    SMALLEST_RATIO.remedy,
    computed="least J at the corners, edges and middles of both faces",
    thresholds=SMALLEST_RATIO.thresholds,
)


class FaceCheck(Check):
    """Check the volume ratio at the faces of a shell."""

    name, order = "faces", 60

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and bool(run.solution.job.mesh.kind.faces)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        run.equations.put(run.solution)
        weak_form = run.equations.weak_form(run.solution.direction)
        plane = scalar_element("quadrilateral", 2).points
        points = np.concatenate([np.column_stack([plane, np.full(len(plane), side)]) for side in (0.0, 1.0)])
        smallest, _ = PointValues(weak_form.J, weak_form.unknowns.mesh, points).range()
        note = "at the corners, edges and middles of the cells on both faces"
        yield lower_bound_line(FACES, smallest, warn=0.1, fail=0.0, note=note)
