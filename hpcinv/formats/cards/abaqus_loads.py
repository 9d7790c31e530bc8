"""``*DLOAD``, ``*DSLOAD`` and ``*CLOAD`` of Abaqus and CalculiX: what loads the body at the end of the last step.

Sources: *Abaqus Keywords Guide*; Dhondt, *CalculiX CrunchiX User's Manual*.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.base.reading.single_conditions import AXES, force_groups, pressed_groups
from hpcinv.base.reading.standing_conditions import COMPONENTS, NewConditions, Standing, Value, vectors
from hpcinv.formats.cards.abaqus_couplings import SPREAD
from hpcinv.formats.cards.abaqus_file import InputFile
from hpcinv.formats.cards.abaqus_supports import Supports, motion_of
from hpcinv.formats.cards.card import CardError, number
from hpcinv.formats.cards.deck import Measure, NodalForces, RigidRegion

type _Load = tuple[str, str, str, tuple[float, ...]]
"""keyword, set, kind, and direction or axis"""
type _Vector = tuple[float, float, float]


class DistributedLoads:
    """Pressures on faces and edges, gravity and centrifugal forces."""

    def __init__(self, file: InputFile) -> None:
        self._file, self._deck = file, file.deck
        self._loads = Standing[_Load](adds=True)
        self._spelled: dict[str, str] = {}
        self._new = NewConditions()
        self._not_read = Counter[str]()  # loads on single elements, by keyword
        self.densities: dict[str, float] = {}
        """by material"""

    def read(self, keyword: Keyword, step: int) -> None:
        """Read the loads of a keyword."""
        name, options = keyword.name, keyword.options
        if self._new.ends_earlier(name, options, step):
            self._file.single.end_earlier(name, step)
            kept = {key: load for key, load in self._loads.values.items() if key[0] != name or load.step == step}
            self._loads.values = kept
        elif self._new.is_late(name, options, step):
            self._deck.unused.append(f"OP=NEW of a *{name} that is not the first of its step")
        amplitude = self._file.amplitudes.at_end(keyword, step, self._deck.unused)
        for line in keyword.lines:
            if line[0].isdigit():
                self._read_single(name, line, step, amplitude.of)
            elif len(line) > 1:
                spelled = self._spelled.setdefault(line[0].lower(), line[0])
                size = number(line[2] or "0", f"*{name}") if len(line) > 2 else 0.0
                self._loads.put((name, spelled, line[1].upper(), _direction(line)), step, size, amplitude.of(size))

    def _read_single(self, name: str, line: list[str], step: int, scaled: Callable[[float], float]) -> None:
        kind = line[1].upper() if len(line) > 1 else ""
        if not self._file.elements.can_bear(kind):
            self._not_read[f"*{name}"] += 1
            return
        try:
            self._file.single.read("DLOAD", line, step, scaled)
        except ValueError:
            raise CardError(f"*{name}: {', '.join(line)!r} is not a load") from None

    def add(self) -> None:
        """Add the loads to the deck."""
        self._deck.unused += [f"{name} of single nodes or elements ({n:,})" for name, n in self._not_read.items()]
        weights: dict[str, list[tuple[Value, tuple[float, ...]]]] = {}
        for (keyword, name, kind, direction), load in self._loads.values.items():
            if kind == "GRAV" and keyword == "DLOAD" and direction:
                weights.setdefault(name, []).append((load, direction))
            elif kind == "CENTRIF" and keyword == "DLOAD" and direction:
                self._add_rotation(load.scaled, direction, name)
            elif (effect := self._file.elements.pressure(keyword, name, kind, load.scaled)) is not None:
                self._deck.effects.append(effect)
            else:
                self._deck.unused.append(f"*{keyword}, {kind} on {name}")
        self._add_weights(weights)
        self._note_order()
        self._add_single(self._file.single.pressed, "pressed")
        self._add_single(self._file.single.edges, "edge-loaded")

    def _add_weights(self, weights: Mapping[str, Sequence[tuple[Value, tuple[float, ...]]]]) -> None:
        """Add gravity, whose directions add up on a set; sets of the same acceleration have one effect."""
        sets: dict[tuple[float, ...], list[str]] = {}
        for name, loads in weights.items():
            parts = [[load.scaled * component for component in direction] for load, direction in loads]
            sets.setdefault(tuple(sum(part) for part in zip(*parts, strict=True)), []).append(name)
            if len(steps := {load.step for load, _ in loads}) > 1:
                text = f"the end of *DLOAD, GRAV on {name} of step {min(steps)}, which a later step has in another"
                self._deck.unused.append(f"{text} direction: CalculiX adds them, as this job; Abaqus replaces it")
        for acceleration, names in sets.items():
            components = [Measure(component + 0.0, length=1, time=-2) for component in acceleration]
            self._add_mass_load({"effect": "gravity", "acceleration": components}, "GRAV", names)

    def _note_order(self) -> None:
        """List loads of several steps on faces by several names, which may share faces."""
        faces = {(name, load.step) for (_, name, kind, _), load in self._loads.values.items() if kind.startswith("P")}
        names = sorted({name for name, _ in faces})
        if len({step for _, step in faces}) > 1 and len(names) > 1:
            text = f"the order of the pressures on {', '.join(names)}, which several steps have"
            self._deck.unused.append(f"{text}: where they share faces, the file has the later one, and the job all")

    def _add_single(self, standing: Standing[tuple[int, int]], called: str) -> None:
        """Add the loads on single elements by the sets that the reader of the mesh makes of them."""
        added, is_edge = 0, called != "pressed"
        face = self._file.elements.face(is_edge=is_edge)
        raw = {place: value.raw for place, value in standing.values.items()}
        for name, _, places in pressed_groups(raw, called):
            sizes = {standing.values[place].scaled for place in places}
            if len(sizes) == 1:
                pressure = Measure(sizes.pop(), length=int(is_edge), stress=1)
                self._deck.effects.append({"effect": "pressure", "region": name, "pressure": pressure} | face)
                added += len(places)
        if missing := len(raw) - added:
            self._deck.unused.append(f"*DLOAD on {missing:,} faces of single elements, which change in the steps")

    def _add_rotation(self, square: float, axis: tuple[float, ...], name: str) -> None:
        """Add a centrifugal force by the square of the velocity (1/s²), a point of the axis, and its direction."""
        if square < 0:
            raise CardError(f"*DLOAD, CENTRIF on {name}: the square of the velocity is negative")
        speed = f"{square**0.5:.15g} rad/s"
        centre = [Measure(component, length=1) for component in axis[:3]]
        effect = {"effect": "centrifugal", "angular_velocity": speed, "axis": list(axis[3:]), "centre": centre}
        self._add_mass_load(effect, "CENTRIF", [name])

    def _add_mass_load(self, effect: Mapping[str, Any], kind: str, names: list[str]) -> None:
        """Add a load on the mass of sets."""
        load = f"*DLOAD, {kind} on {', '.join(names)}"
        self._deck.mass_load({**effect, "on": names}, self.densities, load, "*DENSITY")


def _direction(line: Sequence[str]) -> tuple[float, ...]:
    """Return the unit direction of gravity, or point and direction of an axis; empty for other loads."""
    kind = line[1].upper()
    if kind not in ("GRAV", "CENTRIF"):
        return ()
    count = 3 if kind == "GRAV" else 6
    values = [number(entry or "0", f"*DLOAD, {kind}") for entry in [*line[3:], *[""] * count][:count]]
    if kind == "CENTRIF":
        return tuple(values) if any(values[3:]) else ()
    length = sum(value**2 for value in values) ** 0.5  # both programs take the direction only
    return tuple(value / length for value in values) if length else ()


class PointLoads:
    """Forces and moments on nodes, sets and reference nodes.

    Args:
        own_sets: names of the sets of the file, in lower case; the others are of the reader of the mesh.
    """

    def __init__(self, file: InputFile, own_sets: Collection[str]) -> None:
        self._file, self._deck, self._own_sets = file, file.deck, own_sets
        self._loads = Standing[tuple[str, int]](adds=True)  # by set and component, from 0
        self._on_references = Standing[tuple[int, int]](adds=True)
        self._ended: dict[tuple[str, int], set[int]] = {}  # nodes of sets whose component a later step replaces
        self._spelled: dict[str, str] = {}
        self._new = NewConditions()

    def read(self, keyword: Keyword, step: int) -> None:
        """Read the forces and moments of a keyword."""
        if self._new.ends_earlier("CLOAD", keyword.options, step):
            for standing in (self._loads, self._on_references):
                standing.end_earlier(step)
            self._file.single.end_earlier("CLOAD", step)
        elif self._new.is_late("CLOAD", keyword.options, step):
            self._deck.unused.append("OP=NEW of a *CLOAD that is not the first of its step")
        amplitude = self._file.amplitudes.at_end(keyword, step, self._deck.unused)
        for line in keyword.lines:
            self._read_line(line, step, amplitude.of)

    def _read_line(self, line: list[str], step: int, scaled: Callable[[float], float]) -> None:
        component = line[1] if len(line) > 1 else ""
        reference = self._file.couplings.reference(line[0])
        has_moments = self._file.elements.has_rotations or reference is not None
        if component not in COMPONENTS or (component > "3" and not has_moments):
            self._deck.unused.append(f"*CLOAD, {', '.join(line)}")
            return
        size = number(line[2] or "0", "*CLOAD") if len(line) > 2 else 0.0
        place = int(component) - 1
        if reference is not None:
            self._on_references.put((reference[0], place + 3 * reference[1]), step, size, scaled(size))
        if line[0].isdigit():
            self._file.single.read("CLOAD", line, step, scaled)
            self._end_others({int(line[0])}, place, step, "")
        elif reference is None:
            name = self._spelled.setdefault(line[0].lower(), line[0])
            self._end_others(self._file.nodes(name), place, step, name)
            self._ended.pop((name, place), None)
            self._loads.put((name, place), step, size, scaled(size))

    def _end_others(self, nodes: frozenset[int] | set[int], place: int, step: int, name: str) -> None:
        """End what earlier steps have on nodes by other sets, and by their numbers."""
        for (other, component), load in self._loads.values.items():
            if component == place and other != name and load.step < step:
                self._ended.setdefault((other, place), set()).update(nodes & self._file.nodes(other))
        standing = (self._file.single.moments if place > 2 else self._file.single.forces).values
        for node in nodes if name else ():
            if (old := standing.get((node, place % 3))) is not None and old.step < step:
                text = f"*CLOAD on {name}: it replaces the force on node {node} of an earlier step, which the job keeps"
                self._deck.unused.append(text)
                return

    def add(self, supports: Supports) -> None:
        """Add the forces to the deck, and the loads and motions of reference nodes."""
        self._add_references(supports.moved())
        for first, added, called, keyword in (
            (0, self._deck.forces, "loaded", "*CLOAD"),
            (3, self._deck.moments, "turned", "*CLOAD of moments"),
        ):
            for name in dict.fromkeys(name for name, place in self._loads.values if first <= place < first + 3):
                self._add_set(name, first, added, keyword)
            standing = self._file.single.moments if first else self._file.single.forces
            scaled = vectors(standing, is_scaled=True)
            groups = dict(force_groups(vectors(standing, is_scaled=False), called))
            for region, nodes in self._in_regions(groups):
                own = {node: scaled[node] for node in nodes if node not in self._file.couplings.nodes}
                self._add_nodal(added, region, f"{keyword} on {len(own):,} single nodes", own)

    def _in_regions(self, groups: Mapping[str, frozenset[int]]) -> Iterator[tuple[str | None, frozenset[int]]]:
        """Yield regions that the reader of the mesh makes of loaded nodes, and the nodes whose forces they bear.

        It adds unloaded vertices of faces, and joins nodes that are vertices of another group's faces.
        """
        joined = {
            name: name
            for name, nodes in groups.items()
            if nodes == self._file.nodes(name) or (nodes < self._file.nodes(name) and name not in self._own_sets)
        }
        for name, nodes in groups.items():
            if name not in joined and (other := next((o for o in joined if nodes <= self._file.nodes(o)), None)):
                joined[name] = other
        for region in dict.fromkeys(joined.values()):
            yield region, frozenset().union(*(groups[name] for name, other in joined.items() if other == region))
        yield from ((None, nodes) for name, nodes in groups.items() if name not in joined)

    def _add_set(self, name: str, first: int, added: list[NodalForces], keyword: str) -> None:
        """Add the forces or moments on the nodes of a set."""
        found = self._file.sets.find(name)
        if found is None:
            self._deck.unused.append(f"{keyword} on {name}, which has no node of the mesh")
            return
        region, nodes = found
        components = [self._loads.values.get((name, first + i)) for i in range(3)]
        sizes = [0.0 if load is None else load.scaled for load in components]
        ended = [self._ended.get((name, first + i), set()) for i in range(3)]
        forces: dict[int, _Vector] = {}
        for node in nodes:
            x, y, z = (0.0 if node in gone else size for size, gone in zip(sizes, ended, strict=True))
            forces[node] = x, y, z
        self._add_nodal(added, region, f"{keyword} on {name}", forces)

    def _add_nodal(
        self, added: list[NodalForces], region: str | None, title: str, forces: Mapping[int, _Vector]
    ) -> None:
        """Add forces at nodes by their components along the axes of the nodes."""
        turned: dict[int, _Vector] = {}
        for node, force in forces.items():
            (frame,) = self._file.transforms.frames_of([node])
            in_space = frame.force(force) if frame else force
            if in_space is None:
                self._deck.unused.append(f"{title}, along the radial axes of *TRANSFORM")
                return
            turned[node] = in_space
        if turned:
            added.append(NodalForces(region, title, turned))

    def _add_references(self, moved: Mapping[int, Mapping[str, float]]) -> None:
        """Add the loads and motions of reference nodes."""
        loads: dict[int, list[float]] = {}
        for (node, place), load in self._on_references.values.items():
            loads.setdefault(node, [0.0] * 6)[place] = load.scaled
        for node in dict.fromkeys([*loads, *moved]):
            self._file.couplings.used.add(node)
            coupling = self._file.couplings.of(node)
            force, moment = loads.get(node, [0.0] * 6)[:3], loads.get(node, [0.0] * 6)[3:]
            if self._file.transforms.frames_of({node} & self._file.couplings.nodes) != {None}:
                self._deck.unused.append(f"*CLOAD on node {node}, along the axes of *TRANSFORM")
            elif node in moved:
                self._add_motion(node, moved[node], [*force, *moment])
            elif coupling.kind != SPREAD:
                remote = {
                    "force": [Measure(part, length=2, stress=1) for part in force],
                    "moment": [Measure(part, length=3, stress=1) for part in moment],
                    "about": [Measure(part, length=1) for part in self._file.couplings.position(node)],
                }
                of = "nodes" if coupling.is_set else "surface"
                self._deck.remotes.append(RigidRegion(coupling.region, of, {"remote": remote}))
            elif any(moment):
                text = f"*CLOAD on node {node}: its moment on the distributing *COUPLING of {coupling.region}"
                self._deck.unused.append(text)
            else:
                title = f"*CLOAD on node {node} with a distributing *COUPLING"
                x, y, z = force
                self._deck.forces.append(NodalForces(coupling.region, title, {node: (x, y, z)}, "surface"))
        self._deck.unused += [
            f"{coupling.kind} of {coupling.region} to a node without a force"
            for coupling in self._file.couplings.idle()
        ]

    def _add_motion(self, node: int, held: Mapping[str, float], loads: Sequence[float]) -> None:
        """Add the motion of a reference node that is held."""
        coupling = self._file.couplings.of(node)
        section = motion_of(self._file.couplings.position(node), held, coupling)
        free = [axis for place, axis in enumerate(AXES) if loads[place] and axis not in held]
        if section is None or free:
            text = "since its node {} is held along {}: state a 'motion', which has all components"
            loaded = " and its load" if any(loads) else ""
            axes = ", ".join(sorted(held))
            self._deck.unused.append(f"{coupling.kind} of {coupling.region}{loaded}, {text.format(node, axes)}")
            return
        self._deck.remotes.append(RigidRegion(coupling.region, "nodes" if coupling.is_set else "surface", section))
