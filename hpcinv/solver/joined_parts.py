"""Parts of a body that interfaces join."""

from collections.abc import Sequence

import numpy as np

from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.interface_sides import sides_of
from hpcinv.mesh.source import Ints
from hpcinv.mesh.topology import connected


def joined_parts(body: Body, interfaces: Sequence[Interface], count: int, labels: Ints) -> tuple[int, Ints]:
    """Return number and labels of the parts that are left if those on both sides of interfaces are one; collective.

    Args:
        count, labels: parts that share no node, as `parts_of` returns them.
    """
    pairs = list[tuple[int, int]]()
    for interface in interfaces:
        found = np.concatenate([_labels(body, labels, name) for name in sides_of(body, interface.between)])
        everywhere = np.unique(np.concatenate(body.mesh.comm.allgather(found)))
        pairs += [(int(everywhere[0]), int(other)) for other in everywhere[1:]]
    joints = np.array([*pairs, *((part, part) for part in range(count))], dtype=np.int64)
    _, numbers = np.unique(connected(joints, count)[-count:], return_inverse=True)
    return int(numbers.max()) + 1, numbers[labels]


def _labels(body: Body, labels: Ints, region: str) -> Ints:
    links = body.mesh.topology.connectivity(2, 3)
    return np.array([labels[links.links(facet)[0]] for facet in body.facets(region)], dtype=np.int64)
