"""Regions that a job gives by conditions: their borders follow cells and facets, and move from mesh to mesh."""

from collections.abc import Iterator, Mapping

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.job.region_rules import RegionRule
from hpcinv.mesh.body import Body
from hpcinv.mesh.boundary_shells import outer_facets
from hpcinv.mesh.cells import jacobians, kind_and_degree, quadrature, scalar_element
from hpcinv.mesh.checks import det
from hpcinv.mesh.regions import BOUNDARY, evaluate, is_facet_condition

# Share of the body that fulfils a condition outside of the region's cells, or by which a region of facets changes, from
# which its border moves; larger ones are let pass.
MOVED = 1e-3


def cut_regions(body: Body, rules: Mapping[str, RegionRule]) -> Iterator[str]:
    """Yield the names of regions of cells whose border passes through cells instead of between them; collective."""
    mesh = body.mesh
    kind, degree = kind_and_degree(mesh)
    points, weights = quadrature(kind, 4)
    owned = mesh.topology.index_map(3).size_local
    nodes = body.given_nodes[mesh.geometry.dofmaps[0][:owned]]
    for name, condition in rules.items():
        region = body.regions[name]
        if not isinstance(condition, Expression) or not region.cell_count or is_facet_condition(condition):
            continue
        parts = np.zeros(2)
        if owned:
            volumes = np.abs(det(jacobians(kind, degree, nodes, points))) * weights
            positions = scalar_element(kind, degree).tabulate(0, points)[0, :, :, 0] @ nodes
            is_outside = evaluate(name, condition, positions.reshape(-1, 3)).reshape(volumes.shape).copy()
            is_outside[region.cells] = False
            parts[:] = volumes[is_outside].sum(), volumes.sum()
        part, whole = mesh.comm.allreduce(parts, op=MPI.SUM)
        if part > MOVED * whole:
            yield name


def facet_shares(body: Body) -> dict[str, float]:
    """Return the share of the surface of each region of facets that is given by a condition; collective."""
    mesh, shares = body.mesh, {}
    owned = mesh.topology.index_map(2).size_local
    for name, region in body.regions.items():
        if region.origin == "geometric" and not region.cell_count:
            both = (region.facets, body.regions[BOUNDARY].facets)
            with body.at(body.given_nodes):
                areas = [np.linalg.norm(outer_facets(mesh, f[f < owned])[1], axis=1).sum() for f in both]
            part, whole = mesh.comm.allreduce(np.array(areas), op=MPI.SUM)
            shares[name] = float(part / whole)
    return shares


def moved(earlier: Mapping[str, float], later: Mapping[str, float]) -> set[str]:
    """Return the names of regions whose shares differ on two meshes."""
    return {name for name in earlier.keys() & later.keys() if abs(later[name] - earlier[name]) > MOVED}
