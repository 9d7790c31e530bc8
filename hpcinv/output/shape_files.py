"""Distance of the files of a shape from the computed body, and the lines on it in log and certificate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from hpcinv.base.quantity.units import readable
from hpcinv.trust.certificate import Line, topic, upper_bound_line

SHAPE_FILES = topic(
    "shape files: largest distance from the computed body, relative to the displacement",
    "Distance of the written files, which may have fewer nodes, from the computed body.",
    "Use smaller cells, or for solids 'mesh: {geometry_degree: 2}'; if it is set, write msh or vtu.",
    computed="distance of the written files from the computed body, where these have fewer nodes",
    thresholds="above 0.05; never",
)
_VISIBLE = 1e-3
"""Share of the displacement below which a file is the computed body; raised, log and certificate are silent of more."""
_LARGE = 0.05
"""Share of the displacement above which the line warns, as the discretisation error does; raised, fewer runs warn."""


@dataclass(frozen=True)
class ShapeFile:
    """A written file of a shape.

    Attributes:
        left_out: largest distance (m) between the computed body and the cells of the file.
        scale: displacement (m) that it is compared with.
        degree: of the cells in the file.
        state: of the body, empty in a job without states.
    """

    name: str
    left_out: float
    scale: float
    degree: int
    state: str = ""

    @property
    def share(self) -> float:
        return self.left_out / self.scale if self.scale else 0.0

    @property
    def why(self) -> str:
        """Reason of the distance, and the remedy."""
        if self.degree == 1:
            return "straight between its vertices; 'mesh: {geometry_degree: 2}' writes the nodes between them"
        return "without some nodes of the computed cells, which it cannot hold"


def notes_of(files: Mapping[str, ShapeFile]) -> Iterator[str]:
    """Yield a line on the files that differ from the computed body in the same way."""
    for group in _alike(files.values()):
        yield f"{_names(group)}: up to {readable(group[0].left_out, 'm', 3)} from the computed body: {group[0].why}"


def lines_of(files: Mapping[str, ShapeFile]) -> Iterator[Line]:
    """Yield the line of the certificate on the file that differs most in each state, if one does visibly."""
    for state in dict.fromkeys(file.state for file in files.values()):
        if groups := _alike(file for file in files.values() if file.state == state):
            worst = max(groups, key=lambda group: group[0].left_out)
            note = f"{readable(worst[0].left_out, 'm', 3)}; {_names(worst)}: {worst[0].why}"
            line = upper_bound_line(SHAPE_FILES, worst[0].share, _LARGE, math.inf, note=note)
            yield replace(line, state=state)


def _names(files: Sequence[ShapeFile]) -> str:
    """Return such as ``shape.msh, .vtu``; only files of several states have several stems."""
    stems = {file.name.partition(".")[0] for file in files}
    return ", ".join(
        file.name if number == 0 or len(stems) > 1 else file.name.removeprefix(*stems)
        for number, file in enumerate(files)
    )


def _alike(files: Iterable[ShapeFile]) -> list[list[ShapeFile]]:
    """Return visibly different files in groups of the same distance and reason."""
    groups: dict[tuple[float, int], list[ShapeFile]] = {}
    for file in files:
        if file.share > _VISIBLE:
            groups.setdefault((file.left_out, file.degree), []).append(file)
    return list(groups.values())
