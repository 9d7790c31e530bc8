"""``*BOUNDARY`` of Abaqus and CalculiX: what is held at the end of the last step."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import degrees, hypot

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.base.reading.single_conditions import AXES, held_axes, held_groups
from hpcinv.base.reading.standing_conditions import NewConditions, Standing, by_axis
from hpcinv.formats.cards.abaqus_amplitudes import Amplitude
from hpcinv.formats.cards.abaqus_couplings import SPREAD, Coupling
from hpcinv.formats.cards.abaqus_file import InputFile
from hpcinv.formats.cards.abaqus_transform import TransformAxes
from hpcinv.formats.cards.card import CardError
from hpcinv.formats.cards.deck import Measure

_SPECIAL = ("FIXED", "USER", "SUBMODEL")
_LARGEST_TURN = 90.0
"""degrees of a rigid motion that a job may have"""


class Supports:
    """Supports of sets and of single nodes."""

    def __init__(self, file: InputFile) -> None:
        self._file, self._deck = file, file.deck
        self._held = Standing[tuple[str, str]](adds=False)  # by set and axis
        self._moved = Standing[tuple[int, str]](adds=False)  # by reference node and axis
        self._spelled: dict[str, str] = {}  # sets as they are first named: case does not count
        self._new = NewConditions()

    def read(self, keyword: Keyword, step: int) -> None:
        """Read the conditions of a keyword."""
        options = keyword.options
        if self._new.ends_earlier("BOUNDARY", options, step):
            self._held.end_earlier(step)
            self._moved.end_earlier(step)
            self._file.single.end_earlier("BOUNDARY", step)
        elif self._new.is_late("BOUNDARY", options, step):
            self._deck.unused.append("OP=NEW of a *BOUNDARY that is not the first of its step")
        kind = options.get("TYPE", "DISPLACEMENT").upper()
        special = [name for name in _SPECIAL if name in options]
        if special or kind != "DISPLACEMENT":
            self._deck.unused.append(f"*BOUNDARY, {special[0] if special else f'TYPE={kind}'}")
            return
        amplitude = self._file.amplitudes.at_end(keyword, step, self._deck.unused)
        for line in keyword.lines:
            try:
                self._read_line([*line, ""][: max(2, len(line))], step, amplitude)
            except ValueError:
                raise CardError(f"*BOUNDARY: {', '.join(line)!r} names no components") from None

    def _read_line(self, line: list[str], step: int, amplitude: Amplitude) -> None:
        """Read a line of data; ``ValueError`` if it is damaged."""
        name, *entries = line
        if entries[0].isdigit() and int(entries[0]) > len(AXES):
            self._deck.unused.append(f"*BOUNDARY of component {entries[0]}, such as a temperature, on '{name}'")
        if (reference := self._file.couplings.reference(name)) is not None:
            node, is_turned = reference
            for axis, value in held_axes(entries, has_rotations=not is_turned).items():
                self._moved.put((node, f"r{axis}" if is_turned else axis), step, value, amplitude.of(value))
        if self._file.single.read("BOUNDARY", [name, *entries], step, amplitude.of) or reference is not None:
            return
        name = self._spelled.setdefault(name.lower(), name)
        for axis, value in held_axes(entries, has_rotations=self._file.elements.has_rotations).items():
            self._held.put((name, axis), step, value, amplitude.of(value))

    def moved(self) -> dict[int, dict[str, float]]:
        """Return the displacements and rotations by reference node and axis, ``x`` to ``rz``."""
        result: dict[int, dict[str, float]] = {}
        for (node, axis), value in self._moved.values.items():
            result.setdefault(node, {})[axis] = value.scaled
        held = {axis: set(nodes) for axis, nodes in by_axis(self._file.single.held).items()}
        for name, axis in self._held.values:
            held.setdefault(axis, set()).update(self._file.nodes(name))
        for axis, nodes in held.items():  # also of sets with other nodes
            for number in nodes & self._file.couplings.nodes:
                if (reference := self._file.couplings.reference(str(number))) is not None:
                    node, is_turned = reference
                    result.setdefault(node, {}).setdefault(f"r{axis}" if is_turned else axis, 0.0)
        return result

    def add(self) -> None:
        """Add the supports to the deck."""
        by_set: dict[str, dict[str, float]] = {}
        for (name, axis), value in self._held.values.items():
            by_set.setdefault(name, {})[axis] = value.scaled
        self._note_conflicts()
        for name, values in by_set.items():
            self._add_support(name, values, self._file.transforms.frames(name))
        for name in self._file.transforms.unknown:
            text = f"*TRANSFORM of '{name}': other sets with its nodes have other axes than in the file"
            self._deck.unused.append(text)
        self._add_single()

    def _note_conflicts(self) -> None:
        """List a node that is held by different displacements: the file has the later one, the job both."""
        seen: dict[tuple[str, int], tuple[float, str]] = {}
        for (axis, node), value in self._file.single.held.values.items():
            seen[axis, node] = value.scaled, "single nodes"
        names = {name for name, _ in self._held.values}
        for (name, axis), value in self._held.values.items():
            for node in self._file.nodes(name) if len(names) > 1 or seen else ():
                other = seen.setdefault((axis, node), (value.scaled, name))
                if other[0] != value.scaled:
                    text = f"supports of '{other[1]}' and '{name}' have other displacements {axis} of node {node}"
                    self._deck.unused.append(f"{text}: the file has the later one; keep the regions apart")
                    return

    def _add_support(self, region: str, values: Mapping[str, float], frames: set[TransformAxes | None]) -> None:
        """Add a support by the displacements of its components along the axes of its nodes."""
        turns = self._held_turns(region, values)
        values = {axis: value for axis, value in values.items() if len(axis) == 1}
        if frames == {None}:
            self._deck.support(region, values, turns)
            return
        converted = _in_all_frames(values, frames)
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

    def _held_turns(self, region: str, values: Mapping[str, float]) -> list[str]:
        """Return the axes about which a region does not turn; list those about which it turns."""
        turned = {name[1]: value for name, value in values.items() if len(name) > 1}
        if prescribed := [axis for axis, value in turned.items() if value]:
            self._deck.unused.append(f"rotations of '{region}' about {', '.join(prescribed)}: state a displacement")
        return [axis for axis, value in turned.items() if not value]

    def _add_single(self) -> None:
        """Add the supports of single nodes by the sets that the reader of the mesh makes of them."""
        raw, scaled = by_axis(self._file.single.held), self._file.single.held.values
        references, missing = self._file.couplings.nodes, sum(map(len, raw.values()))
        for name, values, nodes in held_groups(raw):
            if nodes <= references:
                missing -= len(nodes) * len(values)
                continue
            sizes = {axis: {scaled[axis, node].scaled for node in nodes - references} for axis in values}
            if self._file.nodes(name) == nodes and all(len(size) == 1 for size in sizes.values()):
                turned = {axis: size for axis, (size,) in sizes.items()}
                self._add_support(name, turned, self._file.transforms.frames_of(nodes))
                missing -= len(nodes) * len(values)
        if missing:
            self._deck.unused.append(f"*BOUNDARY of single nodes ({missing:,} components), which change in the steps")


def _in_all_frames(
    values: Mapping[str, float], frames: Collection[TransformAxes | None]
) -> tuple[dict[str, float], list[float]] | None:
    """Return global displacements and a normal, as `TransformAxes.supports`; ``None`` if frames of nodes differ."""
    first, *others = ((dict(values), list[float]()) if frame is None else frame.supports(values) for frame in frames)
    return first if all(other == first for other in others) else None


def motion_of(position: Collection[float], held: Mapping[str, float], coupling: Coupling) -> dict[str, object] | None:
    """Return the section of a support by the motion of a reference node; ``None`` if a job cannot say it.

    Args:
        held: displacements and rotations (radians) by axis, ``x`` to ``rz``.
    """
    if coupling.kind == SPREAD or held.keys() != {*AXES}:
        return None
    move, turn = [held[axis] for axis in "xyz"], [held[f"r{axis}"] for axis in "xyz"]
    angle = hypot(*turn)
    if degrees(angle) > _LARGEST_TURN:
        return None
    displacement = [Measure(part, length=1) for part in move]
    if not angle:
        return {"displacement": displacement} if any(move) else {"fix": ["x", "y", "z"]}
    motion: dict[str, object] = {"rotate": f"{degrees(angle):.15g} deg", "axis": [part / angle for part in turn]}
    motion["about"] = [Measure(part, length=1) for part in position]
    return {"motion": motion | ({"move": displacement} if any(move) else {})}
