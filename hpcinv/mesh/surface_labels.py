"""Integers in the surface cells of a mesh file, for the files that are written of it."""

from collections.abc import Mapping

import numpy as np

from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.facet_groups import facets_of_cells
from hpcinv.mesh.source import Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, find_rows


def labelled_facets(source: MeshSource) -> tuple[Ints, Mapping[str, Ints]]:
    """Return facets (f, l), the mesh's own first, and integers (f,) in them by name of the array.

    The others are surface cells of the file without a group. A facet that the file does not have gets a number that is
    below those in the file, at most -1. Surface cells that are not facets of the cells are left out.
    """
    labelled = source.surface_cells
    if labelled is None:
        return source.facets, {}
    vertices = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, vertices)
    corners = find_rows(labelled.vertex_tags.reshape(-1, 1), source.node_tags[:, None])
    row_of_label = table.find(corners.reshape(labelled.vertex_tags.shape))
    row_of_facet = table.find(source.facets[:, : labelled.vertex_tags.shape[1]])
    more = np.setdiff1d(row_of_label[row_of_label >= 0], row_of_facet)
    facets = np.concatenate([source.facets, facets_of_cells(source, table.owners(more))])
    rows, is_known = np.concatenate([row_of_facet, more]), row_of_label >= 0
    labels = dict[str, Ints]()
    for name, values in labelled.values.items():
        row_labels = np.full(len(table.vertices), min(-1, int(values.min()) - 1))
        row_labels[row_of_label[is_known]] = values[is_known]
        labels[name] = row_labels[rows]
    return facets, labels
