"""Distances of unloaded bodies from a surface that is known: what narrows the contact tractions of a given shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.job.interfaces import OBSTACLE, Interface, interface_of
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.body import source_node_values
from hpcinv.mesh.boundary_shells import cells_of_facets
from hpcinv.mesh.parts import parts_of
from hpcinv.mesh.regions import find
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.surface_distance import SurfaceDistance
from hpcinv.physics.closures.known import RestSurface
from hpcinv.physics.effects.contact import Contact
from hpcinv.results.quantities_of_interest import owned_nodes
from hpcinv.results.solution import Solution
from hpcinv.solver.support_checks import joined_parts


class KnownRestSurface:
    """A surface on which a region of the unloaded bodies lies. Methods are collective.

    Attributes:
        within: largest distance (m) of a node of the region.

    Raises:
        MeshError: on all ranks, if the file cannot be read, or the region belongs to none of the bodies in contact.
    """

    def __init__(self, known: RestSurface, where: str, interface: Interface, job: Job, body: Body) -> None:
        self.within, self._body = known.within, body
        _check_part(known.region, where, interface, job, body)
        self._distance = SurfaceDistance(job.resolve(known.file), known.unit, False, body.mesh.comm)
        self._nodes = owned_nodes(body, known.region)

    def distances(self, solution: Solution, rates: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return distances (k,) m of the nodes along the normals of the surface, and their rates (k, n).

        Args:
            rates: of the displacement (m) at the local geometry nodes, by n numbers.
        """
        comm, at_nodes = self._body.mesh.comm, self._at_nodes
        found, normals = self._distance(at_nodes(solution.other_nodes))
        columns = [-np.einsum("ni,ni->n", normals, at_nodes(rate)) for rate in rates]
        own = np.array(columns).reshape(len(rates), len(found)).T
        return np.concatenate(comm.allgather(found)), np.concatenate(comm.allgather(own))

    def _at_nodes(self, values: Floats) -> Floats:
        return np.asarray(source_node_values(self._body, values)[self._nodes])


def known_rest_surfaces(interfaces: Sequence[tuple[str, Interface]], job: Job, body: Body) -> list[KnownRestSurface]:
    """Return the known rest surfaces of interfaces, which have their places in the job; collective.

    Raises:
        MeshError: on all ranks, if a file cannot be read, or a region belongs to none of the bodies in contact.
    """
    named = [(where, interface, interface.known.rest_surface) for where, interface in interfaces]
    return [KnownRestSurface(known, where, spec, job, body) for where, spec, known in named if known is not None]


def check_rest_surfaces(job: Job, body: Body) -> None:
    """Check the known rest surfaces of a job before it is solved; raises as `known_rest_surfaces`; collective."""
    interfaces = [(f"interfaces[{i}]", interface) for i, interface in enumerate(job.interfaces)]
    interfaces += [
        (f"effects[{i}]", interface_of(effect))
        for i, effect in enumerate(job.effects)
        if isinstance(effect, Contact) and effect.is_paired
    ]
    known_rest_surfaces(interfaces, job, body)


def _check_part(region: str, where: str, interface: Interface, job: Job, body: Body) -> None:
    tied = [interface for interface in job.interfaces if interface.kind == "tied"]
    _, labels = joined_parts(body, tied, *parts_of(body))
    own = _parts_of_region(region, labels, body)
    surfaces = (name for name in interface.between if name != OBSTACLE)
    touching = set[int]().union(*(_parts_of_region(name, labels, body) for name in surfaces))
    if not own or own - touching:
        raise MeshError(
            f"{where}.known.rest_surface.region: '{region}' is not on the bodies that touch at"
            f" '{interface.between[0]}', and contact there does not move it",
            "Name a region of one of both bodies, or the interface that touches its body.",
        )


def _parts_of_region(name: str, labels: Ints, body: Body) -> set[int]:
    """Return the parts to which a region belongs; collective."""
    region: Any = find(body.regions, name, body.source)
    cells = region.cells
    if len(region.facets):
        cells = np.append(cells, cells_of_facets(body.mesh, region.facets))
    return set().union(*body.mesh.comm.allgather(set(np.unique(labels[cells]).tolist())))
