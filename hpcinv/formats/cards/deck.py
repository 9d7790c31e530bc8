"""Materials of sets, supports and loads of an input file of another program, in its own units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hpcinv.formats.cards.card import Counterpart, Stress

type Vector = tuple[float, ...]


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
        region: name of a node set, or of a surface; ``None`` if the file has none of these nodes.
        title: keyword and place in the file.
    """

    region: str | None
    title: str
    forces: Mapping[int, tuple[float, float, float]]
    of: str = "nodes"


@dataclass(frozen=True)
class RigidRegion:
    """A region that one node moves, by a force and a moment or by a motion.

    Attributes:
        region: name of the region.
        of: ``nodes`` if it is a node set, else ``surface``.
        section: of a support of a job, without the region.
    """

    region: str
    of: str
    section: Mapping[str, Any]


@dataclass(frozen=True)
class ShellSection:
    """Section of a set of shell elements, in the file's units.

    Attributes:
        region: name of the set.
        layers: material and thickness of each layer, along the elements' normals; a shell without layers has one.
        offset: distance of the nodes from the middle along the normals, over the thickness.
        array: data array of the mesh with the thickness at nodes, if the thickness of the layer is given as 0.
        is_membrane: whether the elements have no bending stiffness.
        orientations: names of the axes of the layers; empty for the axes of the coordinates along the surface.
    """

    region: str
    layers: tuple[tuple[str, float], ...]
    offset: float = 0.0
    array: str = ""
    is_membrane: bool = False
    orientations: tuple[str, ...] = ("",)

    @property
    def thickness(self) -> float:
        """Sum of the layers."""
        return sum(thickness for _, thickness in self.layers)


def layer_name(number: int) -> str:
    """Return the name of the region of a layer, counted from 1 along the normals of the elements."""
    return f"layer{number}"


@dataclass(frozen=True)
class Axes:
    """Axes of the material of a set.

    Attributes:
        frame: unit vectors 1, 2 and 3; empty if they vary over the body.
        fibres: directions of fibres.
    """

    frame: tuple[Vector, ...] = ()
    fibres: tuple[Vector, ...] = ()


@dataclass
class Deck:
    """Materials, supports and loads.

    Attributes:
        materials: names of materials by the set of elements that has them.
        axes: of the materials, by the same sets.
        linear: linearly elastic materials, by name; taken if the program's other laws of it have no counterpart.
        supports: sections of a job, whose regions are names of sets; numbers with units are `Measure`. Of a shell,
            ``turns`` has the axes of the rotations that are held. Regions are node sets, or what ``of`` says: a
            ``surface`` or a ``part``.
        effects: the same; one on sets of elements names them under ``on``. Of a shell, ``face`` is ``back`` for a
            pressure that pushes along the normals, ``surface`` on the side that a surface names, and ``edge`` for a
            force by length instead of a pressure.
        forces: forces at nodes.
        moments: the same of moments, on shells.
        remotes: regions that one node moves.
        shells: sections; the file has no solids if there are any.
        is_linear: whether displacements are small in a step of the file, which solves linear equations.
        unused: what is in the file and not in the job.
    """

    materials: dict[str, str] = field(default_factory=dict)
    axes: dict[str, Axes] = field(default_factory=dict)
    linear: dict[str, Counterpart] = field(default_factory=dict)
    supports: list[Mapping[str, Any]] = field(default_factory=list)
    effects: list[Mapping[str, Any]] = field(default_factory=list)
    forces: list[NodalForces] = field(default_factory=list)
    moments: list[NodalForces] = field(default_factory=list)
    remotes: list[RigidRegion] = field(default_factory=list)
    shells: list[ShellSection] = field(default_factory=list)
    is_linear: bool = False
    unused: list[str] = field(default_factory=list)

    def support(
        self, region: str, values: Mapping[str, float], turns: Sequence[str] = (), *, of: str = "nodes"
    ) -> None:
        """Add a support by the displacements of its components, and the axes about which a shell is held.

        Args:
            of: what the region is: ``nodes``, a set of them, ``surface`` or ``part``.
        """
        turned: dict[str, Any] = {"of": of} if of != "nodes" else {}
        turned |= {"turns": sorted(turns)} if turns else {}
        if any(values.values()):
            components = [Measure(values[axis], length=1) if axis in values else None for axis in "xyz"]
            self.supports.append({"region": region, "displacement": components} | turned)
        elif values or turns:
            self.supports.append({"region": region, "fix": sorted(values)} | turned)

    def mass_load(self, effect: Mapping[str, Any], densities: Mapping[str, float], load: str, entry: str) -> None:
        """Add a load on mass, by the density of each region if materials differ; without any it is not used.

        Args:
            densities: by material.
            load, entry: names of the load and of a density in the file.
        """
        by_region = {region: densities.get(material, 0.0) for region, material in self.materials.items()}
        sizes = set(by_region.values()) or {next(filter(None, densities.values()), 0.0)}
        if not any(sizes):
            self.unused.append(f"{load}: no material has a {entry}")
            return
        measures = {size: Measure(size, length=-2, stress=1, time=2) for size in sizes}
        density: Any = {region: measures[size] for region, size in by_region.items()}
        self.effects.append({**effect, "density": density if len(sizes) > 1 else measures[sizes.pop()]})


def isotropic(young: float, poisson: float) -> Counterpart:
    """Return the hyperelastic law that agrees with isotropic linear elasticity at small strain."""
    return Counterpart({"law": "neo-hookean", "young": Stress(young), "poisson": poisson})
