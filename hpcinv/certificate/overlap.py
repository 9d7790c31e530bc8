"""Self-overlap of a body: two parts of it may cross although ``det F > 0`` everywhere.

A deformation with ``det F > 0`` that is one-to-one on the boundary is one-to-one on the whole body, so facets of the
boundary that cross are all there is to look for.

Source: Ball, "Global invertibility of Sobolev functions and the interpenetration of matter" (1981),
doi:10.1017/S030821050002014X.
"""

from __future__ import annotations

from hpcinv.mesh import Body
from hpcinv.mesh.crossing_facets import Overlap, find_overlap
from hpcinv.mesh.source import Floats
from hpcinv.mesh.surface import gather_surface
from hpcinv.parallel.runtime import on_root

MOST_FACETS = 500_000  # that are gathered on one rank: about 2 GB


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
