"""Directions of fibres in FEBio: a vector of a material, or data of its elements.

Data at the nodes of an element follow its shape functions to its integration points.

Source: FEBio's ``FEBioMeshDataSection4.cpp``, ``FEDomainMap.cpp``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape

import numpy as np

from hpcinv.formats.feb import in_febio_order
from hpcinv.mesh.source import Floats, Ints
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.loaded_body import LoadedBody


class FibreMaps:
    """Data of elements on the fibres of materials.

    Args:
        parts: rows of the elements of each part, by its name.
        elements: nodes (rows) of the elements, in the order of Abaqus.
    """

    def __init__(self, body: LoadedBody, parts: Mapping[str, Ints], elements: Ints) -> None:
        self._body, self._parts = body, parts
        self._listed = in_febio_order(elements)
        self._used: dict[str, tuple[str, str]] = {}  # part and family by the name of the map

    def of(self, part: str, law: MaterialLaw) -> dict[str, tuple[str, str]]:
        """Return type and text of ``<fiber>`` by the families of a law."""
        entries = dict[str, tuple[str, str]]()
        for family in law.families:
            if family in self._body.fibres:
                entries[family] = "vector", ",".join(map(repr, self._body.fibres[family].tolist()))
            elif family in self._body.fibre_fields:
                name = family if len(self._parts) == 1 else f"{family}-{part}"
                self._used[name] = part, family
                entries[family] = "map", name
        return entries

    def sets(self, tags: Ints) -> Iterator[str]:
        """Yield element sets with the names of parts that have data, unless these are regions.

        Args:
            tags: numbers of the elements.
        """
        regions = {group.name for group in self._body.rest.groups if group.dim == 3}
        for part in dict.fromkeys(part for part, _ in self._used.values()):
            if part not in regions:
                listed = ",".join(map(str, tags[self._parts[part]].tolist()))
                yield f'<ElementSet name="{escape(part)}">{listed}</ElementSet>'

    def data(self) -> Iterator[str]:
        """Yield the data, with the elements of a part in its order."""
        for name, (part, family) in self._used.items():
            yield f'<ElementData name="{escape(name)}" elem_set="{escape(part)}" data_type="vec3">'
            vectors = self._at_listed_nodes(self._body.fibre_fields[family])[self._parts[part]]
            for number, row in enumerate(vectors.reshape(len(vectors), -1).tolist(), 1):
                yield f'<e lid="{number}">{",".join(map(repr, row))}</e>'
            yield "</ElementData>"

    def _at_listed_nodes(self, vectors: Floats) -> Floats:
        """Return vectors at the nodes of cells in the order of the model; those in cells stay."""
        if vectors.shape[1] == 1:
            return vectors
        cells = self._body.rest.cells
        places = (cells[:, None, :] == self._listed[:, :, None]).argmax(axis=2)
        return np.asarray(np.take_along_axis(vectors, places[:, :, None], axis=1))
