"""Derivatives of the nodes of the given mesh by numbers of a job: the thickness of a shell."""

from collections.abc import Iterable

import numpy as np

from hpcinv.job.sections import Shell
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh import Body
from hpcinv.mesh.body import local_node_values
from hpcinv.mesh.source import Floats


def node_rates(body: Body, parameters: Iterable[Parameter]) -> dict[str, Floats]:
    """Return derivatives (n, 3) of the local geometry nodes by those parameters that move them, by key; collective."""
    return {p.key: _thickness_rate(body, p.value) for p in parameters if isinstance(p.owner, Shell)}


def _thickness_rate(body: Body, thickness: float) -> Floats:
    """Nodes of a column lie at fixed shares of the thickness from the given surface."""
    surface, points = body.source.midsurface, body.source.points
    assert surface is not None
    columns = points - np.tile(surface.points, (len(points) // max(len(surface.points), 1), 1))
    return local_node_values(body, columns / thickness)
