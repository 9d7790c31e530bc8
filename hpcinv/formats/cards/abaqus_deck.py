"""Materials of sets, supports and loads of input files of Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

from hpcinv.base.reading.abaqus_keywords import Keyword, keywords_of_text
from hpcinv.base.reading.abaqus_options import not_used
from hpcinv.base.reading.standing_conditions import SingleConditions
from hpcinv.formats.cards.abaqus_amplitudes import Amplitudes
from hpcinv.formats.cards.abaqus_axes import GLOBAL, axes_of
from hpcinv.formats.cards.abaqus_couplings import Couplings
from hpcinv.formats.cards.abaqus_elastic import elastic_law, is_isotropic
from hpcinv.formats.cards.abaqus_file import InputFile, NodeSets
from hpcinv.formats.cards.abaqus_loads import DistributedLoads, PointLoads
from hpcinv.formats.cards.abaqus_shell import SECTIONS, elements_of, section_of
from hpcinv.formats.cards.abaqus_supports import Supports
from hpcinv.formats.cards.abaqus_transform import Transforms
from hpcinv.formats.cards.card import CardError, Counterpart, UnknownLaw, number
from hpcinv.formats.cards.deck import Deck, isotropic, layer_name

_CONDITIONS = ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD")
_TIES = ("EQUATION", "MPC")
"""equations between displacements of nodes"""
_OF_MATERIALS = (
    *("PLASTIC", "CREEP", "VISCOELASTIC", "HYSTERESIS", "MULLINS EFFECT", "EXPANSION", "DAMAGE INITIATION"),
    *("NO COMPRESSION", "NO TENSION", "CONDUCTIVITY", "SPECIFIC HEAT", "DAMPING", "DEPVAR", "USER MATERIAL"),
    *("HYPERFOAM", "DAMAGE EVOLUTION", "USER OUTPUT VARIABLES"),
)
"""keywords of materials, which are listed with the name of theirs"""


def body_kind(text: str) -> str:
    """Return the name of the kind of the body; raise ``UnknownLaw`` if only some elements are shells."""
    return elements_of(keywords_of_text(text)).body_kind


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the file says at the end of its last step.

    Args:
        nodes_of_sets: numbers of nodes by name of the set, also of the sets of
            ``hpcinv.base.reading.single_conditions``.

    Raises:
        CardError: a number is damaged.
    """
    return _KeywordReader(keywords_of_text(text), nodes_of_sets).deck()


class _KeywordReader:
    """Reads the keywords in order."""

    def __init__(self, file: Sequence[Keyword], nodes_of_sets: Mapping[str, frozenset[int]]) -> None:
        self._file, self._deck = file, Deck()
        self._elements = elements_of(file)
        names = [keyword.options.get("NAME", "") for keyword in file if keyword.name == "MATERIAL"]
        self._materials = {name.lower(): name for name in names}  # case does not count
        self._axes = {k.options.get("NAME", "").lower(): k for k in file if k.name == "ORIENTATION"}
        self._material, self._step = "", 0
        _refuse_turned_axes(file)
        unused, elements = self._deck.unused, self._elements
        sets = NodeSets(nodes_of_sets)
        amplitudes, transforms = Amplitudes(file), Transforms(file, sets.nodes)
        couplings, single = Couplings(file, unused), SingleConditions(has_rotations=elements.has_rotations)
        named = InputFile(self._deck, amplitudes, transforms, couplings, sets, single, elements)
        self._supports, self._loads = Supports(named), DistributedLoads(named)
        own_sets = {k.options["NSET"].lower() for k in file if k.name in ("NODE", "NSET") and "NSET" in k.options}
        self._forces = PointLoads(named, own_sets)

    def deck(self) -> Deck:
        """Return what the file says.

        Raises:
            CardError: it is damaged.
        """
        for keyword in self._file:
            if keyword.name in _CONDITIONS and not keyword.rows and "OP" not in keyword.options:
                self._deck.unused.append(f"*{keyword.name}, which has no line of data")
                continue
            if reader := self._READERS.get(keyword.name):
                reader(self, keyword)
            self._list_unused(keyword)
        self._supports.add()
        self._loads.add()
        self._forces.add(self._supports)
        return self._deck

    def _list_unused(self, keyword: Keyword) -> None:
        """List a keyword that is not used, or its options that are not."""
        name = keyword.name
        if name in _TIES:
            text = "fix a plane of symmetry, or give a face that stays rigid a 'remote' load"
            self._deck.unused.append(f"*{name}, which a job cannot say: {text}")
        elif name in _OF_MATERIALS:
            self._deck.unused.append(f"*{name} of material {self._material}")
        else:
            self._deck.unused += not_used(name, keyword.options)

    def _begin_step(self, keyword: Keyword) -> None:
        self._step += 1
        if "PERTURBATION" in keyword.options:
            self._deck.unused.append("*STEP, PERTURBATION: small changes of the state of the step before")
        elif keyword.options.get("NLGEOM", "YES" if "NLGEOM" in keyword.options else "NO").upper() == "NO":
            self._deck.is_linear = True

    def _read_elements(self, keyword: Keyword) -> None:
        kind = keyword.options.get("TYPE", "").upper()
        if not self._elements.has_type(kind):
            self._deck.unused.append(f"elements of type {kind}")

    def _begin_material(self, keyword: Keyword) -> None:
        self._material = keyword.options.get("NAME", "")

    def _read_elastic(self, keyword: Keyword) -> None:
        if keyword.rows and len(keyword.lines[0]) > 1:
            law = _linear(keyword, self._material) if is_isotropic(keyword) else elastic_law(keyword)[1]
            self._deck.linear[self._material] = law

    def _read_density(self, keyword: Keyword) -> None:
        if keyword.rows:
            self._loads.densities[self._material] = number(keyword.lines[0][0], "*DENSITY")

    def _read_section(self, keyword: Keyword) -> None:
        region, name, axes = (keyword.options.get(key, "") for key in ("ELSET", "MATERIAL", "ORIENTATION"))
        self._deck.materials[region] = self._materials.get(name.lower(), name)
        self._deck.axes[region] = axes_of(self._orientation(keyword, axes)) if axes else GLOBAL
        if "COMPOSITE" in keyword.options:
            self._deck.unused.append(f"*SOLID SECTION, COMPOSITE: the layers of {region}")

    def _orientation(self, keyword: Keyword, name: str) -> Keyword:
        if name.lower() not in self._axes:
            raise CardError(f"*{keyword.name}: there is no *ORIENTATION {name}")
        return self._axes[name.lower()]

    def _read_shell(self, keyword: Keyword) -> None:
        section = section_of(keyword)
        self._deck.shells.append(section)
        is_layered = len(section.layers) > 1
        for place, ((name, _), axes) in enumerate(zip(section.layers, section.orientations, strict=True), 1):
            region = layer_name(place) if is_layered else section.region
            self._deck.axes[region] = axes_of(self._orientation(keyword, axes)) if axes else GLOBAL
            self._deck.materials[region] = self._materials.get(name.lower(), name)

    def _read_supports(self, keyword: Keyword) -> None:
        self._supports.read(keyword, self._step)

    def _read_loads(self, keyword: Keyword) -> None:
        self._loads.read(keyword, self._step)

    def _read_forces(self, keyword: Keyword) -> None:
        self._forces.read(keyword, self._step)

    _READERS: ClassVar[Mapping[str, Callable[[_KeywordReader, Keyword], None]]] = {
        "STEP": _begin_step,
        "ELEMENT": _read_elements,
        "MATERIAL": _begin_material,
        "ELASTIC": _read_elastic,
        "DENSITY": _read_density,
        "SOLID SECTION": _read_section,
        **dict.fromkeys(SECTIONS, _read_shell),
        "BOUNDARY": _read_supports,
        "DLOAD": _read_loads,
        "DSLOAD": _read_loads,
        "CLOAD": _read_forces,
    }


def _refuse_turned_axes(file: Sequence[Keyword]) -> None:
    """Raise ``CardError`` for axes within a part that an instance turns."""
    turned = next((k for k in file if k.name == "INSTANCE" and len(k.rows) > 1), None)
    is_inside = False
    for keyword in file if turned else ():
        if keyword.name in ("PART", "END PART"):
            is_inside = keyword.name == "PART"
        elif is_inside and keyword.name in ("ORIENTATION", "TRANSFORM"):
            text = f"*{keyword.name} in a part that *INSTANCE turns"
            raise CardError(f"{text}: its axes turn too; save the mesh and its axes in global coordinates")


def _linear(keyword: Keyword, material: str) -> Counterpart:
    """Return the law of Young's modulus and Poisson's ratio."""
    if len(keyword.rows) > 1:
        raise UnknownLaw(f"*ELASTIC of material {material} depends on temperature; keep one line of data")
    young, poisson = (number(entry, "*ELASTIC") for entry in keyword.lines[0][:2])
    return isotropic(young, poisson)
