"""Data arrays of MSH files ($NodeData and $ElementData), which gmsh reads and writes as views."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.mesh.source import DataArray, Floats, MeshSource, Place, data_arrays

PLACES: dict[str, Place] = {"NodeData": "nodes", "ElementData": "cells"}


def read_views(gmsh: Any, source: MeshSource) -> dict[str, DataArray]:
    """Values of gmsh's views at the nodes or in the cells of ``source``, at their last time step.

    Missing values are NaN; views on surfaces only are ignored.
    """
    return data_arrays(_matched(gmsh, source))


def _matched(gmsh: Any, source: MeshSource) -> Iterator[tuple[str, Place, Floats]]:
    known = {"nodes": source.node_tags, "cells": source.cell_tags}  # in ascending order
    for view in gmsh.view.getTags():
        last = int(gmsh.view.option.getNumber(view, "NbTimeStep")) - 1
        kind, tags, values, _, components = gmsh.view.getHomogeneousModelData(view, last)
        if kind not in PLACES:
            continue
        on = PLACES[kind]
        rows = np.searchsorted(known[on], tags.astype(np.int64)).clip(max=len(known[on]) - 1)
        found = known[on][rows] == tags
        if found.any():
            result = np.full((len(known[on]), components), np.nan)
            result[rows[found]] = values.reshape(-1, components)[found]
            yield gmsh.view.option.getString(view, "Name"), on, result


def write_views(gmsh: Any, path: Path, source: MeshSource) -> None:
    """Append the data of ``source``, whose mesh is gmsh's current model, to the MSH file at ``path``."""
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
    tags = {"nodes": source.node_tags, "cells": source.cell_tags}
    kinds = {on: kind for kind, on in PLACES.items()}
    for name, array in source.data.items():
        view = gmsh.view.add(name)
        gmsh.view.addHomogeneousModelData(
            view,
            0,
            gmsh.model.getCurrent(),
            kinds[array.on],
            tags[array.on],
            array.values.ravel(),
            numComponents=array.values.shape[1],
        )
        gmsh.view.write(view, str(path), append=True)
