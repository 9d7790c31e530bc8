"""The parameters of a scene, scaled, as entries of one constant of its forms: changing a value recompiles nothing.

One constant and not many, since UFL orders constants by the text of their running numbers: several would change places
between the 9th and the 10th, and the same form would be compiled anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import ufl
from dolfinx import fem

from hpcinv.quantities import quantities_of

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh
    from pydantic import BaseModel

    from hpcinv.scales import Scales


class Parameters:
    """The load factor, and the finite quantities of laws and effects.

    Args:
        specs: laws and effects.
        further: values that a scene needs beside their fields, scaled already, by name.
    """

    def __init__(self, specs: Sequence[BaseModel], further: dict[str, float], mesh: Mesh, scales: Scales) -> None:
        values, places = [0.0], []
        for spec in specs:
            found: dict[str, slice | int] = {}
            for name, dimension in quantities_of(type(spec)).items():
                value, scale = getattr(spec, name), scales.of(dimension)
                if value is None or value == math.inf:
                    continue
                entries = value if isinstance(value, tuple) else (value,)
                start = len(values)
                values += [v / scale for v in entries]
                found[name] = slice(start, len(values)) if isinstance(value, tuple) else start
            places.append(found)
        self._further = {name: len(values) + i for i, name in enumerate(further)}
        self._constant = fem.Constant(mesh, [*values, *further.values()])
        self._places = places

    @property
    def load(self) -> Any:
        """The load factor, as UFL sees it."""
        return self._constant[0]

    def set_load(self, value: float) -> None:
        self._constant.value[0] = value

    def of(self, index: int) -> Any:
        """The quantities of the ``index``-th spec by name, vectors as UFL vectors."""
        return SimpleNamespace(**{name: self._entry(place) for name, place in self._places[index].items()})

    def further(self, name: str) -> Any:
        """One of the ``further`` values."""
        return self._constant[self._further[name]]

    def _entry(self, place: slice | int) -> Any:
        if isinstance(place, int):
            return self._constant[place]
        return ufl.as_vector([self._constant[i] for i in range(place.start, place.stop)])
