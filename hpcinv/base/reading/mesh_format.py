"""A format of mesh files: what is known of one from its suffix and its header."""

from __future__ import annotations

import importlib
from abc import ABC
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    type Floats = npt.NDArray[np.float64]
    type Ints = npt.NDArray[np.int64]


OUTER, INNER = "outer", "inner"
"""regions of the faces of a shell: the outer one is on the side of its normal"""
OF_NODES = "-nodes"
"""ends the name of the region of a node set, if the surface of its name has other nodes"""


class Later:
    """A module that is imported where an attribute of it is first asked for: jobs know all formats without NumPy."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(importlib.import_module(self._name), attribute)


@dataclass(frozen=True)
class Groups:
    """Names of the groups of a mesh.

    Attributes:
        names: groups of surfaces and volumes.
        thin: groups of points and curves.
        patterns: patterns of further names.
        arrays: arrays of integers, whose values a job may name as regions.
    """

    names: frozenset[str]
    thin: frozenset[str] = frozenset()
    patterns: tuple[str, ...] = ()
    arrays: tuple[str, ...] = ()

    def of_shell(self) -> Groups:
        """Return the names that are possible where the mesh is a shell, whose curves are edges."""
        faces = {f"{name}|{face}" for name in self.names for face in (OUTER, INNER)}
        names = self.names | self.thin | faces | {OUTER, INNER}
        sides = [rf"({pattern})\|({OUTER}|{INNER})" for pattern in (*self.patterns, r"surface-\d+")]
        return Groups(names, patterns=(*self.patterns, r"curve-\d+", *sides), arrays=self.arrays)


@dataclass(frozen=True)
class MeshArrays:
    """Content of a mesh file in VTK's terms.

    Attributes:
        points: (n, 3) coordinates, in the unit of the file.
        types: (m,) VTK's numbers of the types of the cells, solid ones and facets of groups.
        offsets: (m + 1,) where the nodes of each cell begin in ``connectivity``, and where the last ones end.
        connectivity: indices of nodes, in VTK's order of the nodes of a cell.
        regions: (m,) a number other than 0 on the cells of a region, by its name.
        data: further arrays, ``nodes:NAME`` (n, …) and ``cells:NAME`` (m, …).
    """

    points: Floats
    types: Ints
    offsets: Ints
    connectivity: Ints
    regions: Mapping[str, Ints] = field(default_factory=dict)
    data: Mapping[str, Any] = field(default_factory=dict)


class MeshFormat(ABC):
    """A format of mesh files, registered by subclassing in a module of `hpcinv.formats`.

    Names of regions and faults are found without DOLFINx, so that ``hpcinv validate`` is instant. A format has a method
    `arrays`, or names its ``elements`` or its ``reader``, which need the packages above.
    """

    action: ClassVar[str] = ""
    """action of ``hpcinv.base.reading.isolated_reader`` that reads a file, in a process with limits"""
    suffix: ClassVar[str]
    other_suffixes: ClassVar[tuple[str, ...]] = ()
    elements: ClassVar[str] = ""
    """what messages call a file of which ``action`` reads nodes, elements and sets; materials and loads are not used"""
    reader: ClassVar[str] = ""
    """``module:function`` that reads a path as a ``MeshSource``"""
    saver: ClassVar[str] = ""
    """``module:function`` that saves path, ``MeshSource`` and points; without it the format is only read"""
    is_partitioned: ClassVar[bool] = False
    """each rank reads and writes its part; coordinates are in m"""
    saves_27_nodes: ClassVar[Literal["always", "if read", "never"]] = "always"
    """whether hexahedra of degree 2 keep the nodes of their faces and centre: always, or if they were read with them"""
    head: ClassVar[str] = ""
    """file that a directory of this format has; empty if a mesh is one file"""

    def arrays(self, path: Path) -> MeshArrays:
        """Read a file; raises ``MeshError`` or ``OSError``."""
        raise NotImplementedError

    def groups(self, path: Path) -> Groups | None:
        """Groups by the header of a file, or None if they are unknown until it is read."""
        return None

    def fault(self, path: Path) -> str:
        """Fault of the first bytes of a file; empty text if they are valid."""
        return ""

    def fault_inside(self, path: Path) -> str:
        """Fault that is found by searching a whole file, where no ``action`` reads it; empty text if there is none."""
        return ""

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """Names of further files, relative to the directory of ``path``, that have parts of the mesh.

        Args:
            isolated: whether a child process searches for them; by default with ``--untrusted``.

        Raises:
            Fault: the child does not survive the file.
        """
        return []

    def untrusted(self) -> str:
        """Why a file of this format from others must not be read; empty text if it may be."""
        return ""


def loaded(name: str) -> Callable[..., Any]:
    """Return the function ``module:function``."""
    module, _, function = name.partition(":")
    result: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return result
