"""Measures of integration over the mesh: the whole body, regions of cells, regions of the boundary."""

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.mesh import Body
from hpcinv.mesh.cells import quadrature_metadata


class Integration:
    """Measures with one quadrature degree.

    Args:
        parts: local cells of each part of the volume, without gaps or overlaps; by default it is not divided.
    """

    def __init__(self, body: Body, degree: int, parts: tuple[npt.NDArray[np.int32], ...] = ()) -> None:
        self._body, self._degree = body, degree
        # Both lists are shared by all measures of their kind, as DOLFINx requires; the second grows with the regions.
        self._cells = list(enumerate(parts, start=1)) or None
        self._facets: list[tuple[int, npt.NDArray[np.int32]]] = []
        self._known: dict[str, int] = {}

    @property
    def volume(self) -> Any:
        """The whole body."""
        rule = quadrature_metadata(self._body.source.kind, self._degree)
        return ufl.Measure("dx", self._body.mesh, subdomain_data=self._cells, metadata=rule)

    def part(self, number: int) -> Any:
        """Return one of the parts, from 0; the whole body if it is not divided."""
        return self.volume if self._cells is None else self.volume(number + 1)

    def surface(self, region: str, least_degree: int = 0) -> Any:
        """Return a region of the boundary; raise ``MeshError`` on all ranks if it is none."""
        if region not in self._known:
            topology = self._body.mesh.topology
            facets = self._body.boundary_facets(region)
            entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, facets)
            self._known[region] = len(self._known) + 1
            self._facets.append((self._known[region], entities))
        rule = {"quadrature_degree": max(int(self._degree), least_degree)}
        measure = ufl.Measure("ds", self._body.mesh, subdomain_data=self._facets, metadata=rule)
        return measure(self._known[region])

    @property
    def layers(self) -> int:
        """Number of layers of a shell."""
        return self._body.source.layers
