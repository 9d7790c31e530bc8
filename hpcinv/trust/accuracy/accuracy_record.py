"""Record of a search for accuracy: its steps, and bounds of the errors."""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from hpcinv.base.quantity.written_units import as_shown
from hpcinv.trust.certificate.check import Line, Verdict, topic

ERROR = topic(
    "error of …",
    "Bound of the estimated error, against what the job demands.",
    computed="[estimated error](../how-to/accuracy.md) times a safety factor",
    thresholds="not decided above the demand; half of it above the demand",
)
_DOUBTS = (Verdict.UNDECIDED, Verdict.WARN, Verdict.FAIL)


class Ending(enum.Enum):
    """End of a search: text and advice."""

    MET = "met", ""
    LIMIT = (
        "not met: no discretisation within the limits is predicted to be much more accurate",
        "raise solver.maximum_unknowns, use a machine with more memory, or demand less",
    )
    LAYER = (
        "not met: a finer mesh does not reduce the error of the shell's layer",
        "give the shell several 'layers', mesh a solid, or demand less",
    )
    STEPS = "not met: too many steps", "the error hardly falls: give a mesh that is finer where the stress concentrates"
    STOPPED = "not met: a signal stopped the search", "run the job again with more time, or demand less"
    UNSOLVED = (
        "not met: with a better discretisation the load was not reached",
        "perhaps no such shape exists, and a coarse mesh only seemed to find one",
    )

    def __init__(self, text: str, advice: str) -> None:
        self.text = text
        self.advice = advice


@dataclass(frozen=True)
class AccuracyStep:
    """One step: the mesh, and the values and errors on it.

    Attributes:
        errors: estimated errors of the quantities (SI), without safety factors.
        bounds: errors times safety factors.
        excess: the largest ratio of a bound to its demand. All are ``None`` if a second mesh is needed to know them.
        left_out: note that the estimate has no error of the geometry; else empty.
        limit: note on an edge that limits the rate; else empty.
    """

    mesh: str
    cells: int
    degree: int
    unknowns: int
    values: Mapping[str, Any]
    errors: Mapping[str, float | None]
    bounds: Mapping[str, float | None]
    excess: float | None
    left_out: str
    factorizations: int
    seconds: float
    limit: str = ""

    def described(self, units: Mapping[str, str], symbols: Mapping[str, str]) -> str:
        """Return a line on the step.

        Args:
            units: SI units of quantities by name, where the job defines them.
            symbols: units of the job by SI unit.
        """
        errors = ", ".join(
            f"{name} ± {'?' if bound is None else as_shown(bound, units.get(name, ''), symbols, 3)}"
            for name, bound in self.bounds.items()
        )
        excess = "one mesh cannot show" if self.excess is None else f"{self.excess:.2g} of what is allowed"
        return (
            f"  {self.mesh}: {self.cells} cells, degree {self.degree}, {self.unknowns} unknowns,"
            f" {self.factorizations} factorizations, {self.seconds:.1f} s: {errors} ({excess}){self.left_out}"
        )


@dataclass(frozen=True)
class AccuracyRecord:
    """Demands, steps and ending of a search.

    Attributes:
        chosen: number of the step whose result is returned, from 0.
        bounds: estimated errors of that step times safety factors.
        certain: errors of that step that are certain, as in `Assessment`.
    """

    demands: Mapping[str, float]
    rows: Sequence[AccuracyStep]
    chosen: int
    bounds: Mapping[str, float]
    certain: Mapping[str, float]
    ending: Ending
    seconds: float

    def lines(self, units: Mapping[str, str], symbols: Mapping[str, str], checked: Sequence[Line] = ()) -> list[Line]:
        """Return a line of the certificate for each demand; other arguments as of `AccuracyStep.described`.

        Args:
            checked: lines of the certificate. A promise is not decided while one of them doubts the mesh.
        """
        lines = [self._line(name, demand, units.get(name, ""), symbols) for name, demand in self.demands.items()]
        doubts = [line.name for line in checked if line.topic.judges_mesh and line.verdict in _DOUBTS]
        if not doubts:
            return lines
        why = f"the certificate doubts the mesh: {', '.join(dict.fromkeys(doubts))}"
        return [
            replace(line, verdict=Verdict.UNDECIDED, note="; ".join(filter(None, [line.note, why])))
            if line.verdict is Verdict.PASS
            else line
            for line in lines
        ]

    def _line(self, name: str, demand: float, unit: str, symbols: Mapping[str, str]) -> Line:
        bound, row, allowed = self.bounds[name], self.rows[self.chosen], as_shown(demand, unit, symbols)
        rule = f"pass up to {allowed}, which accuracy.{name} demands; fail if half the estimate is larger"
        verdict, texts = Verdict.PASS, list[str]()
        if not bound <= demand:
            verdict = Verdict.FAIL if self.certain[name] > demand else Verdict.UNDECIDED
            if (error := row.errors.get(name)) is not None:
                texts.append(f"estimated as {as_shown(error, unit, symbols, 3)}")
            texts.append(f"{self.ending.text}: {self.ending.advice}")
        note = "; ".join(filter(None, [("; ".join(texts) + row.left_out).removeprefix(", "), row.limit]))
        return Line(ERROR.placed(name), bound, unit, rule, verdict, note)

    def as_data(self) -> dict[str, Any]:
        data = asdict(self)
        return {"steps": data.pop("rows"), **data, "ending": self.ending.name}
