"""Sentences on the result of a run, its certainty and the next step."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hpcinv.base.quantity.units import readable
from hpcinv.output.shape_error import CAUSES, REMEDIES, ShapeError, shape_error

_NEXT = {
    "pass": "Use the shape. All files are in the directory of the run.",
    "not checked": "Nothing was checked: run the job with certificate: standard before you rely on the shape.",
    "not decided": "Some checks came to no decision. Read their notes; a finer mesh often decides them.",
    "warning": "Read the warnings, and correct the job where they ask for it, before you rely on the shape.",
    "fail": "Do not use the shape. The lines that fail say why, and their notes what to change.",
}


@dataclass(frozen=True)
class Words:
    """Head of a report: its verdict ("pass", …, "not reached", "stopped"), and sentences."""

    verdict: str
    finding: str
    sure: Sequence[str]
    next: Sequence[str]


def _open_lines(lines: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of the certificate that were checked and do not pass, with their remedies."""
    for line in lines:
        if line["verdict"] not in ("pass", "not checked"):
            parts = [f"{_named(line)}: {line['verdict']}.", _sentence(line["note"]), line.get("remedy")]
            yield " ".join(filter(None, parts))


def _remedy(error: ShapeError | None, verdict: str) -> Iterator[str]:
    """Yield what makes the error of the shape smaller, where its largest cause is known."""
    if error is None or (error.cause == "surface" and "mesh" not in error.causes):
        return  # without the mesh's error it is not known which is larger
    if verdict == "warning" or (verdict == "pass" and error.cause != "mesh"):
        yield REMEDIES[error.cause]


def words(summary: Mapping[str, Any], *, overlapping: bool, strained: str = "") -> Words:
    """Return the verdict on a run in plain words.

    Args:
        overlapping: whether facets where the body passes through itself are marked in the picture.
        strained: where the body is strained most at the last accepted step of a run that did not reach its end.
    """
    certificate = summary["certificate"]
    if summary["status"] != "converged":
        return _unfinished(summary, strained)
    warnings = (summary.get("body") or {}).get("warnings") or []
    verdict = "warning" if certificate["verdict"] == "pass" and warnings else certificate["verdict"]
    error = shape_error(summary)
    sure = _counted(certificate["lines"])
    if verdict != "fail":  # an estimate supposes that there is such a body
        sure += _accuracy(summary, error)
    sure += _open_lines(certificate["lines"])
    advice = [_NEXT[verdict], *_remedy(error, verdict)]
    if overlapping:
        advice.append("The facets where the body passes through itself are red in the picture.")
    advice += [_sentence(text) for text in warnings]
    finding = _found(summary)
    if verdict == "fail":
        finding = f"The certificate fails: the result is not to be relied on. {finding}"
    return Words(verdict, finding, sure, advice)


def _counted(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return sentences on the number of checks."""
    verdicts = [line["verdict"] for line in lines]
    left = verdicts.count("not checked")
    checked = len(lines) - left
    sentences = [f"{verdicts.count('pass')} of {checked} checks pass." if checked else "No check was made."]
    return sentences + ([f"{left} {'check was' if left == 1 else 'checks were'} not made."] if left else [])


def _found(summary: Mapping[str, Any]) -> str:
    job, first = summary["job"], summary["solutions"][0]
    moves = f"its largest displacement is {readable(first['largest_displacement'], 'm')}"
    for cavity in first.get("cavities", ()):
        moves += f", and the pressure of cavity '{cavity['name']}' is {readable(cavity['pressure'], 'Pa')}"
    for load in first.get("remote_loads", ()):
        moves += f", and '{load['region']}' turns by {math.degrees(load['motion']['rotate']):.4g}°"
    if states := summary.get("states"):
        others = [name for name, state in states.items() if not state["given"]]
        given = next(name for name, state in states.items() if state["given"])
        other_names = _listed([f"'{name}'" for name in others])
        moves = f"the largest displacement to '{first['state']}' is {readable(first['largest_displacement'], 'm')}"
        verb = "was" if len(others) == 1 else "were"
        return f"From the state '{given}' of the body, {other_names} {verb} found; {moves}."
    if first["direction"] == "forward":
        return f"The deformed shape of '{job['job']}' was found; {moves}."
    back = " It was loaded again, as a check." if job.get("analysis") == "round_trip" else ""
    return f"The undeformed shape of '{job['job']}' was found; {moves}.{back}"


def _accuracy(summary: Mapping[str, Any], error: ShapeError | None) -> list[str]:
    """Return sentences on the largest error of the shape, its cause, and the smaller ones."""
    estimate = summary["certificate"].get("estimate") or {}
    unknown = [] if estimate.get("shape") is not None else ["The error of the mesh was not estimated."]
    if error is None:
        return unknown
    size, (largest, *others) = summary["solutions"][0]["largest_displacement"], error.causes.items()
    share = f" ({100 * largest[1] / size:.2g} % of the displacement)" if size else ""
    omission = f", without the error of the geometry ({text})" if (text := estimate.get("without_geometry")) else ""
    own_omission = omission if error.cause == "mesh" else ""
    head = {
        "mesh": f"Nodes are estimated to be within {readable(largest[1], 'm')}{share} of the exact ones{own_omission}.",
        "surface": f"The shape is uncertain by {readable(largest[1], 'm')}{share}, by errors of the given surface.",
        "round trip": f"Solved back, the shape misses the given body by {readable(largest[1], 'm')}{share}.",
    }
    less = [f"Less comes from {CAUSES[cause]}: {readable(value, 'm')}." for cause, value in others]
    singular = estimate.get("singular")
    doubt = (
        [f"The error of the mesh is not reliable: {singular['edge']}."] if singular and not singular["reliable"] else []
    )
    return [head[error.cause], *less, *unknown, *doubt]


def _place_of_end(line: Mapping[str, Any]) -> str:
    """Return how far a run came by the first line of its certificate; empty if that is not known."""
    state_text = f" of state '{line['state']}'" if line.get("state") else ""
    if line["name"] == "position residual":
        return f"The search{state_text} ended {readable(float(line['value'] or 0.0), 'm')} from the given shape."
    if line["value"] == 0:
        return f"No load step{state_text} was accepted; the picture shows the body without load."
    if line["value"] is not None:
        return f"It carries {100 * line['value']:.4g} % of the load{state_text}; the picture shows the body there."
    is_saved = line["name"] == "certificate"
    return "The solution under the full load was found and is saved; it was not checked." if is_saved else ""


def _unfinished(summary: Mapping[str, Any], strained: str) -> Words:
    lines, status = summary["certificate"]["lines"], summary["status"]
    stopped = status.startswith("stopped by")
    line: Mapping[str, Any] = lines[0] if lines else {"name": "load factor", "value": None, "unit": ""}
    where = _place_of_end(line)
    advice = [_sentence(part) for part in [summary.get("advice") or ""] if part]
    if stopped:
        return Words(
            "stopped", "The run was stopped before its end.", [where], advice or ["Go on with 'hpcinv resume'."]
        )
    finding = f"No solution under the full load was found: {status}."
    sure = [where, strained, "This is not the result that the job asks for."]
    if not advice:
        advice = ["Check the load, the material and their units, and that the supports hold the body."]
    return Words("not reached", finding, [sentence for sentence in sure if sentence], advice)


def _named(line: Mapping[str, Any]) -> str:
    name = str(line["name"]).partition(",")[0]
    text = name[0].upper() + name[1:]
    return f"{text} (state '{line['state']}')" if line.get("state") else text


def _sentence(text: str) -> str:
    text = text.strip()
    return text if not text or text.endswith((".", "!", "?")) else text[0].upper() + text[1:] + "."


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
