"""Materials of sets, supports and loads of input files of Abaqus and CalculiX."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hpcinv.cards.abaqus_axes import GLOBAL, axes_of
from hpcinv.cards.abaqus_elastic import elastic_law, is_isotropic
from hpcinv.cards.abaqus_keywords import Keyword, keywords
from hpcinv.cards.abaqus_shell import SECTIONS, has_shells, section_of
from hpcinv.cards.abaqus_transform import TransformAxes, Transforms
from hpcinv.cards.card import CardError, Counterpart, UnknownLaw, number
from hpcinv.cards.deck import Deck, Measure, NodalForces, RemoteForce, isotropic, layer_name
from hpcinv.reading.single_conditions import force_groups, held_axes, held_groups, pressed_groups

_NOT_TAKEN = (
    *("TEMPERATURE", "INITIAL CONDITIONS", "CONTACT PAIR", "TIE"),
    *("SPRING", "DASHPOT", "MASS", "CONNECTOR SECTION", "BEAM SECTION", "NORMAL", "PRE-TENSION SECTION"),
    *("REBAR", "REBAR LAYER", "TRANSVERSE SHEAR STIFFNESS"),
    *("DYNAMIC", "BUCKLE", "FREQUENCY", "VISCO", "HEAT TRANSFER", "COUPLED TEMPERATURE-DISPLACEMENT"),
)
_TIES = ("EQUATION", "MPC")
"""equations between displacements of nodes"""
_SPREAD = "distributing *COUPLING"
_PRESSED, _EDGE_LOAD = re.compile(r"P[1-6]"), re.compile(r"EDNOR([1-4])")
_SHELL = re.compile(r"(S|STRI|M3D)[34689][A-Z0-9]*", re.ASCII)
_OF_MATERIALS = (
    *("PLASTIC", "CREEP", "VISCOELASTIC", "HYSTERESIS", "MULLINS EFFECT", "EXPANSION", "DAMAGE INITIATION"),
    *("NO COMPRESSION", "NO TENSION"),
)


def is_shell(text: str) -> bool:
    """Return whether the elements of a file are shells; raise ``UnknownLaw`` if some are."""
    return has_shells(keywords(text))


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the file says at the end of its last step.

    Args:
        nodes_of_sets: numbers of nodes by name of the set, also of the sets of ``hpcinv.reading.single_conditions``.

    Raises:
        CardError: a number is damaged.
    """
    return _KeywordReader(list(keywords(text)), nodes_of_sets).deck()


class _KeywordReader:
    """Reads the keywords in order.

    Attributes:
        held: displacements by set, of the conditions that hold so far.
        loads: the lines of ``*DLOAD`` and ``*DSLOAD`` that hold so far, with the size of their amplitude, by keyword,
            set and kind of load: a later step replaces them.
        held_nodes, forces, pressed: conditions on single nodes and elements that hold so far, with their amplitudes.
    """

    def __init__(self, file: Sequence[Keyword], nodes_of_sets: Mapping[str, frozenset[int]]) -> None:
        self._file, self._curves, self._deck = file, _Amplitudes(file), Deck()
        self._is_shell = has_shells(file)
        self._sets = nodes_of_sets
        names = [keyword.parameters.get("NAME", "") for keyword in file if keyword.name == "MATERIAL"]
        self._materials = {name.lower(): name for name in names}  # case does not count
        self._axes = {k.parameters.get("NAME", "").lower(): k for k in file if k.name == "ORIENTATION"}
        self._held_nodes: dict[str, dict[int, tuple[float, float]]] = {}
        self._forces: dict[str, dict[int, float]] = {}  # by node or set, and component
        self._moments: dict[str, dict[int, float]] = {}
        self._pressed: dict[tuple[int, int], tuple[float, float]] = {}
        self._edges: dict[tuple[int, int], tuple[float, float]] = {}
        self._edges_ever: dict[tuple[int, int], float] = {}
        self._couplings: dict[int, tuple[str, str]] = {}  # surface and kind by the number of the node
        self._pressed_ever: dict[tuple[int, int], float] = {}
        self._densities: dict[str, float] = {}
        self._held: dict[str, dict[str, float]] = {}
        self._loads: dict[tuple[str, str, str], tuple[list[str], float]] = {}
        self._spelled: dict[str, str] = {}  # sets as they are first named: case does not count
        self._turned: dict[int, int] = {}  # nodes of rigid bodies by the nodes that have their rotations
        self._coupled: tuple[int, str] | None = None  # node and surface of the last coupling
        self._single = Counter[str]()  # conditions on single nodes, by keyword
        self._transforms = Transforms(file, nodes_of_sets)

    def deck(self) -> Deck:
        deck, material, step = self._deck, "", 0
        for keyword in self._file:
            match keyword.name:
                case "STEP":
                    step += 1
                case "ELEMENT":
                    kind = keyword.parameters.get("TYPE", "").upper()
                    if not (_SHELL.fullmatch(kind) if self._is_shell else kind.startswith("C3D")):
                        deck.unused.append(f"elements of type {kind}")
                case "MATERIAL":
                    material = keyword.parameters.get("NAME", "")
                case "ELASTIC" if keyword.lines and len(keyword.lines[0]) > 1:
                    is_linear = is_isotropic(keyword)
                    deck.linear[material] = _linear(keyword, material) if is_linear else elastic_law(keyword)[1]
                case "DENSITY" if keyword.lines:
                    self._densities[material] = number(keyword.lines[0][0], "*DENSITY")
                case "SOLID SECTION":
                    self._read_section(keyword)
                case name if name in SECTIONS:
                    self._read_shell(keyword)
                case "BOUNDARY" | "DLOAD" | "DSLOAD" | "CLOAD" if not (keyword.lines or "OP" in keyword.parameters):
                    deck.unused.append(f"*{keyword.name}, which has no line of data")
                case "BOUNDARY":
                    self._read_conditions(keyword, step)
                case "DLOAD" | "DSLOAD":
                    self._read_loads(keyword, step)
                case "CLOAD":
                    self._read_forces(keyword, step)
                case "COUPLING" | "KINEMATIC" | "DISTRIBUTING":
                    self._read_coupling(keyword)
                case "RIGID BODY":
                    self._read_rigid_body(keyword)
                case name if name in _TIES:
                    text = "fix a plane of symmetry, or give a face that stays rigid a 'remote' load"
                    deck.unused.append(f"*{name}, which a job cannot say: {text}")
                case name if name in _NOT_TAKEN:
                    deck.unused.append(f"*{name}")
                case name if name in _OF_MATERIALS:
                    deck.unused.append(f"*{name} of material {material}")
        deck.unused += [f"{name} of single nodes or elements ({count:,})" for name, count in self._single.items()]
        for name, values in self._held.items():
            self._add_support(name, values, self._transforms.frames(name))
        for name in self._transforms.unknown:
            deck.unused.append(f"*TRANSFORM of '{name}': other sets with its nodes have other axes than in the file")
        self._add_supports_of_nodes()
        self._add_loads()
        self._add_pressed_elements(self._pressed, self._pressed_ever, "pressed")
        self._add_pressed_elements(self._edges, self._edges_ever, "edge-loaded")
        self._add_forces()
        deck.unused += [f"{kind} of {surface} to a node without a force" for surface, kind in self._couplings.values()]
        return deck

    def _read_section(self, keyword: Keyword) -> None:
        parameters = keyword.parameters
        region, name, axes = (parameters.get(key, "") for key in ("ELSET", "MATERIAL", "ORIENTATION"))
        if axes and axes.lower() not in self._axes:
            raise CardError(f"*SOLID SECTION: there is no *ORIENTATION {axes}")
        self._deck.materials[region] = self._materials.get(name.lower(), name)
        self._deck.axes[region] = axes_of(self._axes[axes.lower()]) if axes else GLOBAL
        if "COMPOSITE" in parameters:
            self._deck.unused.append(f"*SOLID SECTION, COMPOSITE: the layers of {region}")

    def _read_shell(self, keyword: Keyword) -> None:
        section = section_of(keyword)
        self._deck.shells.append(section)
        is_layered = len(section.layers) > 1
        for place, (name, _) in enumerate(section.layers, 1):
            region = layer_name(place) if is_layered else section.region
            self._deck.materials[region] = self._materials.get(name.lower(), name)

    def _read_conditions(self, keyword: Keyword, step: int) -> None:
        if keyword.parameters.get("OP", "").upper() == "NEW":
            self._held.clear()
            self._held_nodes.clear()
        kind = keyword.parameters.get("TYPE", "DISPLACEMENT").upper()
        special = [name for name in ("FIXED", "USER", "SUBMODEL") if name in keyword.parameters]
        if special or kind != "DISPLACEMENT":
            self._deck.unused.append(f"*BOUNDARY, {special[0] if special else f'TYPE={kind}'}")
            return
        factor = self._curves.factor(keyword, step, self._deck)
        for line in keyword.lines:
            name, *entries = [*line, ""][: max(2, len(line))]
            try:
                values = held_axes(entries, has_rotations=self._is_shell)
            except ValueError:
                raise CardError(f"*BOUNDARY: {', '.join(line)!r} names no components") from None
            if name.isdigit():
                for axis, value in values.items():
                    self._held_nodes.setdefault(axis, {})[int(name)] = value, factor
            else:
                entry = self._held.setdefault(self._spelled.setdefault(name.lower(), name), {})
                entry.update({axis: value * factor for axis, value in values.items()})

    def _add_support(self, region: str, values: Mapping[str, float], frames: set[TransformAxes | None]) -> None:
        """Add a support by the displacements of its components along the axes of its nodes."""
        turned = {name[1]: value for name, value in values.items() if len(name) > 1}
        values = {axis: value for axis, value in values.items() if len(axis) == 1}
        if prescribed := [axis for axis, value in turned.items() if value]:
            self._deck.unused.append(f"rotations of '{region}' about {', '.join(prescribed)}: state a displacement")
        turns = [axis for axis, value in turned.items() if not value]
        if frames == {None}:
            self._deck.support(region, values, turns)
            return
        frame = frames.pop() if len(frames) == 1 else None
        converted = frame.supports(values) if frame else None
        if converted is None:
            text = "whose components are along the axes of *TRANSFORM: state it, such as by 'fix: [normal]'"
            self._deck.unused.append(f"support on '{region}', {text}")
            return
        displacements, normal = converted
        if len(turns) not in (0, 3):
            self._deck.unused.append(f"rotations of '{region}' about some axes of *TRANSFORM")
        self._deck.support(region, displacements, turns if len(turns) == 3 else ())
        if normal:
            self._deck.supports.append({"region": region, "fix": ["normal"], "normal": normal})

    def _add_supports_of_nodes(self) -> None:
        """Add the supports of single nodes by the sets that the reader of the mesh makes of them."""
        raw = {axis: {node: value for node, (value, _) in nodes.items()} for axis, nodes in self._held_nodes.items()}
        added = dict.fromkeys(raw, 0)
        for name, values, nodes in held_groups(raw):
            factors = {self._held_nodes[axis][node][1] for axis in values for node in nodes}
            if self._sets.get(name) == nodes and len(factors) == 1:
                (factor,) = factors
                turned = {axis: value * factor for axis, value in values.items()}
                self._add_support(name, turned, self._transforms.frames_of(nodes))
                for axis in values:
                    added[axis] += len(nodes)
        if missing := sum(len(nodes) - added[axis] for axis, nodes in raw.items()):
            self._deck.unused.append(f"*BOUNDARY of single nodes ({missing:,} components), which change in the steps")

    def _read_loads(self, keyword: Keyword, step: int) -> None:
        if keyword.parameters.get("OP", "").upper() == "NEW":
            self._pressed.clear()
            self._edges.clear()
            self._loads = {key: load for key, load in self._loads.items() if key[0] != keyword.name}
        factor = self._curves.factor(keyword, step, self._deck)
        for line in keyword.lines:
            kind = line[1].upper() if len(line) > 2 else ""
            if line[0].isdigit() and (_PRESSED.fullmatch(kind) or (self._is_shell and kind == "P")):
                place = int(line[0]), int(kind[1:] or 0)
                self._pressed[place] = number(line[2], "*DLOAD"), factor
                self._pressed_ever[place] = self._pressed[place][0]
            elif line[0].isdigit() and self._is_shell and (match := _EDGE_LOAD.fullmatch(kind)):
                place = int(line[0]), int(match[1])
                self._edges[place] = number(line[2], "*DLOAD"), factor
                self._edges_ever[place] = self._edges[place][0]
            elif line[0].isdigit():
                self._single[f"*{keyword.name}"] += 1
            elif len(line) > 1:
                name = self._spelled.setdefault(line[0].lower(), line[0])
                self._loads[keyword.name, name, line[1].upper()] = line, factor

    def _add_loads(self) -> None:
        deck = self._deck
        weights: dict[tuple[float, ...], list[str]] = {}
        for (keyword, name, kind), (line, factor) in self._loads.items():
            if keyword == "DSLOAD" and kind == "P" and len(line) > 2:
                pressure = Measure(number(line[2], "*DSLOAD") * factor, stress=1)
                face = {"face": "surface"} if self._is_shell else {}
                deck.effects.append({"effect": "pressure", "region": name, "pressure": pressure} | face)
            elif self._is_shell and (keyword, kind) == ("DLOAD", "P") and len(line) > 2:
                pressure = Measure(number(line[2], "*DLOAD") * factor, stress=1)
                deck.effects.append({"effect": "pressure", "region": name, "pressure": pressure, "face": "back"})
            elif self._is_shell and kind.startswith("EDNOR") and len(line) > 2:
                edge = f"{name}-{kind}" if keyword == "DLOAD" else name
                by_length = Measure(number(line[2], f"*{keyword}") * factor, length=1, stress=1)
                deck.effects.append({"effect": "pressure", "region": edge, "pressure": by_length, "face": "edge"})
            elif keyword == "DLOAD" and _PRESSED.fullmatch(kind) and len(line) > 2:
                pressure = Measure(number(line[2], "*DLOAD") * factor, stress=1)
                deck.effects.append({"effect": "pressure", "region": f"{name}-{kind}", "pressure": pressure})
            elif keyword == "DLOAD" and kind == "CENTRIF" and len(line) > 8:
                self._add_rotation([number(entry, "*DLOAD") for entry in line[2:9]], factor, name)
            elif keyword == "DLOAD" and kind == "GRAV" and len(line) > 5:
                size, *direction = (number(entry, "*DLOAD") for entry in line[2:6])
                weights.setdefault(tuple(size * factor * entry for entry in direction), []).append(name)
            else:
                deck.unused.append(f"*{keyword}, {kind} on {name}")
        for acceleration, names in weights.items():
            self._add_weight(acceleration, names)

    def _add_pressed_elements(
        self, pressed: Mapping[tuple[int, int], tuple[float, float]], ever: Mapping[tuple[int, int], float], called: str
    ) -> None:
        """Add the pressures on single elements by the sets that the reader of the mesh makes of them."""
        added, is_edge = 0, called != "pressed"
        face = {"face": "edge" if is_edge else "back"} if self._is_shell else {}
        for name, value, places in pressed_groups(ever, called):
            now = [pressed.get(place) for place in places]
            if None not in now and len(set(now)) == 1 and now[0] is not None and now[0][0] == value:
                pressure = Measure(value * now[0][1], length=int(is_edge), stress=1)
                self._deck.effects.append({"effect": "pressure", "region": name, "pressure": pressure} | face)
                added += len(places)
        if missing := len(pressed) - added:
            self._deck.unused.append(f"*DLOAD on {missing:,} faces of single elements, which change in the steps")

    def _read_coupling(self, keyword: Keyword) -> None:
        """Read a coupling of a surface to a node; the next keyword says its kind."""
        if keyword.name == "COUPLING":
            node, surface = (keyword.parameters.get(name, "") for name in ("REF NODE", "SURFACE"))
            is_along_axes = "ORIENTATION" not in keyword.parameters
            self._coupled = (int(node), surface) if node.isdigit() and is_along_axes else None
            if self._coupled is None:
                self._deck.unused.append(f"*COUPLING of {surface}")
            return
        if self._coupled is None:
            return
        node_number, surface = self._coupled
        lines = [[entry for entry in line if entry] for line in keyword.lines] or [["1", "3"]]
        axes = {axis for line in lines if line for axis in held_axes(line)}
        if keyword.name == "DISTRIBUTING" or axes == set("xyz"):
            self._couplings[node_number] = surface, _SPREAD if keyword.name == "DISTRIBUTING" else "*COUPLING"
        else:
            self._deck.unused.append(f"*COUPLING of {surface} along some axes only")

    def _read_rigid_body(self, keyword: Keyword) -> None:
        """Read a set of nodes that moves as a rigid body; CalculiX has its rotations at a node of their own."""
        sets = [keyword.parameters[name] for name in ("NSET", "TIE NSET", "PIN NSET") if name in keyword.parameters]
        node, turned = (keyword.parameters.get(name, "") for name in ("REF NODE", "ROT NODE"))
        if len(sets) != 1 or not node.isdigit() or "ELSET" in keyword.parameters:
            self._deck.unused.append("*RIGID BODY that is not one set of nodes with a reference node")
            return
        self._couplings[int(node)] = sets[0], "*RIGID BODY"
        if turned.isdigit():
            self._turned[int(turned)] = int(node)

    def _read_forces(self, keyword: Keyword, step: int) -> None:
        if keyword.parameters.get("OP", "").upper() == "NEW":
            self._forces.clear()
            self._moments.clear()
        factor = self._curves.factor(keyword, step, self._deck)
        for line in keyword.lines:
            component = line[1] if len(line) > 2 else ""
            if line[0].isdigit() and int(line[0]) in self._turned and component in ("1", "2", "3"):  # a moment
                line = [str(self._turned[int(line[0])]), str(int(component) + 3), *line[2:]]
                component = line[1]
            is_coupled = line[0].isdigit() and int(line[0]) in self._couplings
            if component in ("1", "2", "3") or (component in ("4", "5", "6") and is_coupled):
                name = self._spelled.setdefault(line[0].lower(), line[0])
                self._forces.setdefault(name, {})[int(component) - 1] = number(line[2], "*CLOAD") * factor
            elif component in ("4", "5", "6") and self._is_shell:
                name = self._spelled.setdefault(line[0].lower(), line[0])
                self._moments.setdefault(name, {})[int(component) - 4] = number(line[2], "*CLOAD") * factor
            else:
                self._deck.unused.append(f"*CLOAD, {', '.join(line)}")

    def _add_forces(self) -> None:
        self._add_vectors(self._forces, self._deck.forces, "loaded", "*CLOAD")
        self._add_vectors(self._moments, self._deck.moments, "turned", "*CLOAD of moments")

    def _add_vectors(
        self, components: Mapping[str, Mapping[int, float]], added: list[NodalForces], called: str, keyword: str
    ) -> None:
        """Add forces or moments at nodes by their components, by the name of a set or the number of a node."""
        vectors = {name: tuple(force.get(i, 0.0) for i in range(3)) for name, force in components.items()}
        single: dict[int, tuple[float, float, float]] = {}
        spelled_sets = {name.lower(): name for name in self._sets}
        for name, (x, y, z) in vectors.items():
            if name.isdigit() and int(name) in self._couplings:
                if self._transforms.frames_of([int(name)]) != {None}:
                    self._deck.unused.append(f"*CLOAD on node {name}, along the axes of *TRANSFORM")
                    self._couplings.pop(int(name))
                elif self._is_held(int(name)):
                    surface, kind = self._couplings.pop(int(name))
                    self._deck.unused.append(f"{kind} of {surface} and its load, since its node {name} is held")
                else:
                    self._add_coupled(int(name), (x, y, z))
            elif name.isdigit():
                single[int(name)] = x, y, z
            elif (region := spelled_sets.get(name.lower())) is not None:
                self._add_nodal(added, region, f"{keyword} on {name}", dict.fromkeys(self._sets[region], (x, y, z)))
            else:
                self._deck.unused.append(f"{keyword} on {name}, which has no node of the mesh")
        for name, nodes in force_groups(single, called):
            region = name if self._sets.get(name) == nodes else None
            title = f"{keyword} on {len(nodes):,} single nodes"
            self._add_nodal(added, region, title, {node: single[node] for node in nodes})

    def _add_nodal(
        self,
        added: list[NodalForces],
        region: str | None,
        title: str,
        forces: Mapping[int, tuple[float, float, float]],
    ) -> None:
        """Add forces at nodes by their components along the axes of the nodes."""
        turned: dict[int, tuple[float, float, float]] = {}
        for node, force in forces.items():
            (frame,) = self._transforms.frames_of([node])
            in_space = frame.force(force) if frame else force
            if in_space is None:
                self._deck.unused.append(f"{title}, along the radial axes of *TRANSFORM")
                return
            turned[node] = in_space
        added.append(NodalForces(region, title, turned))

    def _is_held(self, node: int) -> bool:
        """Return whether a node of a coupling has a support, also of its rotations."""
        nodes = {node, *(turned for turned, own in self._turned.items() if own == node)}
        single = {held for by_node in self._held_nodes.values() for held in by_node}
        return bool(nodes & single) or any(nodes & self._sets.get(name, frozenset()) for name in self._held)

    def _add_coupled(self, node: int, force: tuple[float, float, float]) -> None:
        surface, kind = self._couplings.pop(node)
        x, y, z = (self._forces[str(node)].get(i, 0.0) for i in (3, 4, 5))
        if kind != _SPREAD:
            self._deck.remotes.append(RemoteForce(surface, node, force, (x, y, z)))
        elif x or y or z:
            self._deck.unused.append(f"*CLOAD on node {node}: its moment on the distributing *COUPLING of {surface}")
        else:
            title = f"*CLOAD on node {node} with a distributing *COUPLING"
            self._deck.forces.append(NodalForces(surface, title, {node: force}))

    def _add_weight(self, acceleration: tuple[float, ...], names: list[str]) -> None:
        """Add the gravity of sets, which is one of the whole body."""
        components = [Measure(component, length=1, time=-2) for component in acceleration]
        self._add_mass_load({"effect": "gravity", "acceleration": components}, "GRAV", names)

    def _add_rotation(self, data: list[float], factor: float, name: str) -> None:
        """Add a centrifugal force by the square of the velocity (1/s²), a point of the axis, and its direction."""
        square, *rest = data
        speed = f"{(square * factor) ** 0.5:.15g} rad/s"
        centre = [Measure(component, length=1) for component in rest[:3]]
        effect = {"effect": "centrifugal", "angular_velocity": speed, "axis": rest[3:], "centre": centre}
        self._add_mass_load(effect, "CENTRIF", [name])

    def _add_mass_load(self, effect: Mapping[str, Any], kind: str, names: list[str]) -> None:
        """Add a load on the mass of sets."""
        used = [self._densities[m] for m in self._deck.materials.values() if m in self._densities]
        self._deck.mass_load({**effect, "on": names}, used, f"*DLOAD, {kind} on {', '.join(names)}", "*DENSITY")


class _Amplitudes:
    """Amplitudes of loads at the end of the step that has them."""

    def __init__(self, file: Sequence[Keyword]) -> None:
        self._tables = {k.parameters.get("NAME", "").lower(): k for k in file if k.name == "AMPLITUDE"}
        self._periods = [0.0]
        for keyword in file:
            if keyword.name == "STEP":
                self._periods.append(1.0)
            elif keyword.name == "STATIC" and len(self._periods) > 1 and keyword.lines and len(keyword.lines[0]) > 1:
                self._periods[-1] = number(keyword.lines[0][1] or "1", "*STATIC")

    def factor(self, keyword: Keyword, step: int, deck: Deck) -> float:
        """Return the amplitude of a load at the end of its step; 1 without one."""
        name = keyword.parameters.get("AMPLITUDE", "")
        if not name:
            return 1.0
        table = self._tables.get(name.lower())
        if table is None:
            raise CardError(f"*{keyword.name}: there is no *AMPLITUDE {name}")
        end = sum(self._periods) if _is_of_total_time(table) else self._periods[step]
        kind = table.parameters.get("DEFINITION", "TABULAR").upper()
        entries = [number(entry, "*AMPLITUDE") for line in table.lines for entry in line if entry]
        points = list(zip(entries[::2], entries[1::2], strict=False))
        if kind == "TABULAR" and points and len(entries) % 2 == 0:
            delay = number(keyword.parameters.get("TIME DELAY", "0"), f"*{keyword.name}")  # of CalculiX, as the shifts
            later, higher = (number(table.parameters.get(name, "0"), "*AMPLITUDE") for name in ("SHIFTX", "SHIFTY"))
            return _interpolated(points, end - delay - later) + higher
        deck.unused.append(f"*AMPLITUDE {name} ({kind}) of *{keyword.name}")
        return 1.0


def _is_of_total_time(table: Keyword) -> bool:
    return table.parameters.get("TIME", "").upper() == "TOTAL TIME"


def _interpolated(points: Sequence[tuple[float, float]], time: float) -> float:
    """Return the value of a table at a time; constant outside of it."""
    before = points[0]
    if time <= before[0]:
        return before[1]
    for after in points[1:]:
        if time <= after[0]:
            share = (time - before[0]) / (after[0] - before[0])
            return before[1] + share * (after[1] - before[1])
        before = after
    return before[1]


def _linear(keyword: Keyword, material: str) -> Counterpart:
    """Return the law of Young's modulus and Poisson's ratio."""
    if len(keyword.lines) > 1:
        raise UnknownLaw(f"*ELASTIC of material {material} depends on temperature; keep one line of data")
    young, poisson = (number(entry, "*ELASTIC") for entry in keyword.lines[0][:2])
    return isotropic(young, poisson)
