"""How far the body of another program is from the given one, and how much of that its elements explain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hpcinv.base.files.names import is_file
from hpcinv.base.quantity.units import readable
from hpcinv.errors import HpcinvError, OutputError
from hpcinv.mesh.source import Floats
from hpcinv.output.run_directory import RunDirectory
from hpcinv.output.summary import write_on_this_rank
from hpcinv.studies.second_opinion.loaded_body import loaded_body
from hpcinv.studies.second_opinion.program_run import NoOpinion
from hpcinv.studies.second_opinion.programs import PROGRAMS
from hpcinv.studies.second_opinion.same_elements import equilibrium_of, with_elements
from hpcinv.studies.second_opinion.state_shapes import job_of_state
from hpcinv.trust.certificate import Line, Topic, Verdict
from hpcinv.trust.certificate.check import with_line

FOLDER = "second-opinion"
"""directory in the run's"""
_AGREES, _AGREES_ROUGHLY = 1e-3, 1e-2
"""Distances, relative to the largest displacement, up to which both programs agree: with the same elements, and where
elements differ by what is not known. Raised, an error of a load is not seen; lowered, digits of CalculiX's file are."""
_OTHER_EQUILIBRIUM = "its body is in equilibrium by our equations, too: the rest shape has several under this load"
_LIMIT = 600.0
"""seconds for the program where a job asks for it"""
TOPIC = Topic(
    "second opinion",
    "Whether another program loads the rest shape into the given body.",
    "Compare loads, supports and law in the deck with the job's.",
    "Read the last lines and the files of the other program.",
)


@dataclass(frozen=True)
class Opinion:
    """What another program found.

    Attributes:
        program: name and version.
        element: its type of element.
        largest, rms: distance of its body from the given one at the nodes, m.
        place: of the largest in the given body (3,), m.
        displacement: largest, m.
        by_elements: largest distance that its elements make, m; ``None`` if that is not known.
        apart: largest distance of its body from ours with its elements, m; ``None`` if that is not known.
        reason: why they are not known.
        notes: how parts of the job are said in the deck.
    """

    program: str
    element: str
    largest: float
    rms: float
    place: tuple[float, float, float]
    displacement: float
    by_elements: float | None
    apart: float | None
    reason: str
    notes: tuple[str, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether both agree; a distance does not say which of them is wrong."""
        if self.apart is not None:
            return Verdict.PASS if self.apart <= _AGREES * self.displacement else Verdict.WARN
        return Verdict.PASS if self.largest <= _AGREES_ROUGHLY * self.displacement else Verdict.UNDECIDED

    def lines(self) -> list[str]:
        """Return sentences for the terminal, the certificate and reports."""
        place = ", ".join(f"{c:.4g}" for c in self.place)
        text = f"{self.program} loads the rest shape to within {readable(self.largest, 'm')} of the given body"
        share = f" ({self.largest / self.displacement:.2g} of the largest displacement)" if self.displacement else ""
        found = [f"{text}{share}, largest at ({place}) m"]
        if self.by_elements is None:
            found.append(f"how much its elements ({self.element}) explain is not known: {self.reason}")
        elif self.by_elements:
            apart = "" if self.apart is None else f"; with them we differ by {readable(self.apart, 'm')}"
            found.append(f"its elements ({self.element}) explain {readable(self.by_elements, 'm')}{apart}")
        else:
            found.append(f"its elements ({self.element}) are ours")
        return [*found, *self.notes]

    def line(self) -> Line:
        """Return the line of the certificate."""
        rule = f"warning above {_AGREES:g} of the displacement with the same elements"
        return Line(TOPIC, self.largest, "m", rule, self.verdict, "; ".join(self.lines()))


def opinion_line(run: Path) -> Line:
    """Add a line to the certificate of a run that has just ended, and return it."""
    try:
        return second_opinion(run, None, _LIMIT).line()
    except HpcinvError as error:
        line = Line(TOPIC, None, "", "", Verdict.UNDECIDED, error.message)
        _record(run, line)
        return line


def second_opinion(
    run: Path, executable: str | None, limit: float, memory: int | None = None, name: str = "calculix"
) -> Opinion:
    """Let another program load the rest shape of a finished run, and add a line to its certificate.

    Deck and files of the program stay in the directory `FOLDER` of the run.

    Args:
        executable: command of the program; by default the installed one.
        limit: seconds for it.
        memory: bytes for it; by default the machine's.
        name: of the program, one of `PROGRAMS`.

    Raises:
        OutputError: the run is not finished, or has what no deck can say.
        NoOpinion: the program is missing or fails; the line then says that it is not decided.
    """
    program = PROGRAMS[name]
    body = loaded_body(run, program.deck.loads, program.deck.abilities)
    directory = run / FOLDER
    try:
        directory.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{directory}: cannot be made: {error.strerror}") from None
    path = directory / f"{body.name}{program.suffix}"
    units = program.units(body)
    deck = program.deck.write(path, body, units)
    try:
        executable = program.command(executable)
        theirs = units.length * program.displacements(executable, path, deck.tags, limit, memory)
    except NoOpinion as error:
        _record(run, Line(TOPIC, None, "", "", Verdict.UNDECIDED, error.message))
        raise
    expected = body.displacement[deck.nodes]
    distances = np.linalg.norm(theirs - expected, axis=1)
    worst = int(distances.argmax())
    job = job_of_state(run, RunDirectory(run).job(None))
    if job.state:
        body.notes.append(f"the loaded body is the state '{job.state}'")
    places = body.rest.points.copy()
    places[deck.nodes] += theirs
    ours, reason = with_elements(job, body, program, deck.element, places)
    opinion = Opinion(
        f"{program.name} {program.version(executable, path)}".strip(),
        deck.element,
        float(distances[worst]),
        float(np.sqrt((distances**2).mean())),
        tuple(body.loaded[deck.nodes[worst]].tolist()),
        float(np.linalg.norm(expected, axis=1).max()),
        None if ours is None else _largest(ours[deck.nodes] - body.loaded[deck.nodes]),
        None if ours is None else _largest(places[deck.nodes] - ours[deck.nodes]),
        reason,
        tuple(body.notes),
    )
    if opinion.verdict is not Verdict.PASS:
        near = equilibrium_of(job, body, program, deck.element, places)
        if near is not None and _largest((near - places)[deck.nodes]) <= _AGREES * opinion.displacement:
            opinion = replace(opinion, notes=(_OTHER_EQUILIBRIUM, *opinion.notes))
    _record(run, opinion.line())
    return opinion


def _largest(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _record(run: Path, line: Line) -> None:
    """Add a line to the certificate in the summary of a run."""
    if (summary := RunDirectory(run).summary()) is not None:
        content = {**summary, "certificate": with_line(summary["certificate"], line)}
        write_on_this_rank(run, content, [form for form in ("h5", "json") if is_file(run / f"summary.{form}")])
