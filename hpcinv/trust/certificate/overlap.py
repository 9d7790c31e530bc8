"""Self-overlap of a body: two parts of it may cross although ``det F > 0`` everywhere.

A deformation with ``det F > 0`` that is one-to-one on the boundary is one-to-one on the whole body, so facets of the
boundary that cross are all there is to look for.

Source: Ball, "Global invertibility of Sobolev functions and the interpenetration of matter" (1981),
doi:10.1017/S030821050002014X.
"""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.base.parallel.runtime import on_root
from hpcinv.mesh import Body
from hpcinv.mesh.crossing_facets import Overlap, find_overlap
from hpcinv.mesh.regions import BOUNDARY
from hpcinv.mesh.source import Floats
from hpcinv.mesh.surface import gather_surface
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, skipped, topic
from hpcinv.trust.certificate.shape import point_text

MOST_FACETS = 500_000  # that are gathered on one rank: about 2 GB


OVERLAP = topic(
    "boundary facets that cross each other",
    "Whether the computed body passes through itself.",
    "Check load and stiffness; where parts touch, the job needs their contact.",
    computed="pairs of facets that cross",
    thresholds="never; any",
    costs="a search on rank 0",
)


class OverlapCheck(Check):
    """Check that the computed body does not pass through itself."""

    name, order = "overlap", 90
    has_switch = True

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        body = run.equations.body
        if not run.solution.job.certificate.overlap:
            yield skipped(OVERLAP, "switched off: certificate.overlap")
            return
        if run.solution.job.interfaces:
            yield skipped(OVERLAP, "surfaces of interfaces touch each other")
            return
        if (facets := body.regions[BOUNDARY].facet_count) > MOST_FACETS:
            yield skipped(OVERLAP, f"there are {facets} of them, and one rank searches no more than {MOST_FACETS}")
            return
        crossings = overlap(body, run.solution.other_nodes)
        rule = "number of pairs; fail above 0"
        if crossings.point is None:
            yield Line(OVERLAP, 0.0, "", rule, Verdict.PASS, "the body does not pass through itself")
        else:
            note = f"the body passes through itself, such as at ({point_text(crossings.point)}) m"
            yield Line(OVERLAP, float(crossings.pairs), "", rule, Verdict.FAIL, note)


def overlap(body: Body, nodes: Floats) -> Overlap:
    """Find where a body with its local geometry nodes at ``nodes`` (n, 3) m passes through itself; collective.

    The boundary is gathered on rank 0 and searched there: n cells have a surface of about n^(2/3) facets, with 3.5 kB
    each while it is searched (`MOST_FACETS`).
    """
    surface = gather_surface(body, nodes)

    def search() -> Overlap:
        assert surface is not None
        return find_overlap(surface)

    return on_root(body.mesh.comm, search)
