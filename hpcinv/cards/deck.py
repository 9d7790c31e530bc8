"""Materials of sets, supports and loads of an input file of another program, in its own units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Measure:
    """A number of a file in a unit that follows from its units of length and stress, with seconds.

    Attributes:
        length: power of the unit of length.
        stress: power of the unit of stress.
        time: power of the second.
    """

    value: float
    length: int = 0
    stress: int = 0
    time: int = 0


@dataclass(frozen=True)
class NodalForces:
    """Forces at nodes: components by number of the node, in the file's units of stress by its square of lengths.

    Attributes:
        region: name of a node set; ``None`` if the file has none of these nodes.
        title: keyword and place in the file.
    """

    region: str | None
    title: str
    forces: Mapping[int, tuple[float, float, float]]


@dataclass
class Deck:
    """Materials, supports and loads.

    Attributes:
        materials: names of materials by the set of elements that has them.
        linear: Young's modulus and Poisson's ratio of materials without another law, by name.
        supports: sections of a job, whose regions are names of sets; numbers with units are `Measure`.
        effects: the same; one on sets of elements names them under ``on``.
        forces: forces at nodes.
        unused: what is in the file and not in the job.
    """

    materials: dict[str, str] = field(default_factory=dict)
    linear: dict[str, tuple[float, float]] = field(default_factory=dict)
    supports: list[Mapping[str, Any]] = field(default_factory=list)
    effects: list[Mapping[str, Any]] = field(default_factory=list)
    forces: list[NodalForces] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)

    def support(self, region: str, values: Mapping[str, float]) -> None:
        """Add a support by the displacements of its components."""
        if any(values.values()):
            components = [Measure(values[axis], length=1) if axis in values else None for axis in "xyz"]
            self.supports.append({"region": region, "displacement": components})
        elif values:
            self.supports.append({"region": region, "fix": sorted(values)})
