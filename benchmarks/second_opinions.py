"""Second opinions of CalculiX on many bodies, and what explains each difference.

Bodies are the jobs of jobs/ and of the published pages, and the decks (.inp) of directories, such as CalculiX's own
examples, which Debian has in the package calculix-ccx-test. Each is solved as the given body, or loaded if it has no
rest shape, and CalculiX loads what was found. Each body has a process of its own with a limit of time; what was found
is kept in the store and is not solved again.

Command: python -m benchmarks.second_opinions [--decks DIRECTORY]... [--store DIRECTORY] [--limit SECONDS] [NAME ...]
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import gzip
import io
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hpcinv.job.job import Job

ROOT = Path(__file__).parents[1]
LARGEST_POISSON = 0.475  # of such laws: CalculiX has no elements for nearly incompressible ones
HEADINGS = (
    "body",
    "law",
    "solved",
    "elements",
    "verdict",
    "farthest (mm)",
    "of displacement",
    "elements explain",
    "rest of it",
)
LEFT = (
    "first",
    "quantities",
    "expected_shape",
    "sensitivities",
    "uncertainty",
    "identify",
    "accuracy",
    "second_opinion",
)
"""sections that do not change the body, and of which a quick run has no need"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="only bodies with these in their names")
    parser.add_argument("--decks", type=Path, action="append", default=[], help="directories with further decks")
    parser.add_argument("--store", type=Path, default=ROOT / "results" / "second-opinions")
    parser.add_argument("--limit", type=float, default=180, help="seconds for a body")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(found(options.one)))
        return
    options.store.mkdir(parents=True, exist_ok=True)
    rows = {}
    for name, path in bodies(options.decks):
        if all(part not in name for part in options.names) and options.names:
            continue
        rows[name] = kept(name, path, options.store, options.limit)
        print(name, rows[name].get("reason") or rows[name]["verdict"], file=sys.stderr, flush=True)
    print_table(rows)


def bodies(directories: list[Path]) -> Iterator[tuple[str, Path]]:
    """Yield names and files of jobs and decks."""
    for path in [*sorted(ROOT.glob("jobs/*.yaml")), *sorted(ROOT.glob("jobs/hard/*.yaml"))]:
        if re.search("^mesh:", path.read_text(), re.MULTILINE):  # sweeps and studies have none
            yield str(path.relative_to(ROOT).with_suffix("")), path
    published = ROOT / "benchmarks" / "published"
    for path in sorted(published.glob("*/*.yaml")):
        if not path.stem.endswith("-unloaded"):  # they need the loaded body of another job
            yield str(path.relative_to(published).with_suffix("")), path
    for directory in directories:
        for path in sorted([*directory.glob("*.inp"), *directory.glob("*.inp.gz")]):
            yield f"decks/{path.name.partition('.')[0]}", path


def kept(name: str, path: Path, store: Path, limit: float) -> dict[str, Any]:
    """Return what is found for a body, from the store if it has it."""
    record = store / f"{name.replace('/', '-')}.json"
    if not record.exists():
        command = [sys.executable, "-m", "benchmarks.second_opinions", "--one", str(path)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False, cwd=ROOT)
        except subprocess.TimeoutExpired:
            text = json.dumps({"reason": f"takes more than {limit:.0f} s"})
        else:
            text = done.stdout.splitlines()[-1] if done.returncode == 0 else ""
            text = text or json.dumps({"reason": "FAULT: " + (done.stderr.splitlines() or ["no message"])[-1]})
        record.write_text(text)
    row: dict[str, Any] = json.loads(record.read_text())
    return row


def found(path: Path) -> dict[str, Any]:
    """Solve a body, and return the opinion or why there is none."""
    from hpcinv.errors import HpcinvError

    with tempfile.TemporaryDirectory() as directory, contextlib.redirect_stdout(io.StringIO()):
        try:
            if path.suffix == ".yaml":
                return opinion_of(path, Path(directory))
            return opinion_of(job_of_deck(path, Path(directory)), Path(directory))
        except HpcinvError as error:
            return {"reason": " / ".join(error.message.replace(directory, "").replace(f"{ROOT}/", "").splitlines()[:2])}


def job_of_deck(path: Path, directory: Path) -> Path:
    """Write the job of a deck. Decks have no units: lengths are taken for mm."""
    from hpcinv.__main__ import main as command
    from hpcinv.errors import JobError

    deck, job = directory / "deck.inp", directory / "job.yaml"
    deck.write_bytes(gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes())
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        code = command(["new", "job", "--from", str(deck), "--unit", "mm", "--stress-unit", "MPa", str(job)])
    if code:
        raise JobError(said.getvalue().strip() or f"exit code {code}")
    return job


def opinion_of(path: Path, directory: Path) -> dict[str, Any]:
    """Solve a job as its given body, or load it if it has no rest shape, and return CalculiX's opinion."""
    from hpcinv.base.parallel.runtime import MPI
    from hpcinv.base.quantity.keys import assigned
    from hpcinv.errors import SolveError
    from hpcinv.interface import run
    from hpcinv.job.body_kinds import SOLID
    from hpcinv.job.job import parse
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.studies.second_opinion.opinion import second_opinion

    data = given_state({key: value for key, value in read_yaml(path).items() if key not in LEFT})
    given = parse(data, path)
    changes = {"certificate": "off", "output": {"mesh": ["msh"], "fields": False}, **laws_of_both(given)}
    if given.mesh.kind is SOLID:
        changes["mesh.geometry_degree"] = min(2, given.discretisation.displacement)
    reason = ""
    for analysis in ("inverse", "forward"):
        job = parse(assigned(data, changes | {"analysis": analysis}), path)
        try:
            run(job, MPI.COMM_SELF, directory=directory / analysis, progress=False)
        except SolveError as error:
            reason = reason or error.message.splitlines()[0]
            continue
        said = second_opinion(directory / analysis, None, 120)
        return {
            "solved": analysis,
            "law": "other" if any(key.startswith("material") for key in changes) else "its own",
            "verdict": str(said.verdict.value),
            "text": said.lines(),
            **{name: getattr(said, name) for name in ("element", "largest", "displacement", "by_elements", "apart")},
            "why": said.reason,
        }
    return {"reason": f"no solution: {reason}"}


def given_state(data: dict[str, Any]) -> dict[str, Any]:
    """Return a job with the given one of its states only."""
    state: dict[str, Any] = next((state for state in data.pop("states", ()) if state.get("given")), {})
    parts = {key: [*data.get(key, ()), *(state.get(key) or ())] for key in ("effects", "supports")}
    return data | {key: entries for key, entries in parts.items() if entries}


def laws_of_both(job: Job) -> dict[str, Any]:
    """Return changes of a job: laws that CalculiX lacks become isochoric neo-Hookean ones of equal moduli."""
    from hpcinv.base.quantity.spatial_fields import is_uniform
    from hpcinv.errors import JobError
    from hpcinv.formats.cards import abaqus
    from hpcinv.formats.cards.card import Values

    changes = {}
    for place, law in job.laws.items():
        try:
            abaqus.write(Values(law, abaqus.PROGRAM, 1.0), "law")
            is_there = not law.is_incompressible
        except JobError:
            is_there = False
        if not is_there and not all(is_uniform(value) for value, _ in law.quantities().values()):
            raise JobError(f"{place}: a law with moduli that vary has no other one in its place")
        if not is_there:
            young, poisson = law.young_and_poisson()
            other = {"law": "isochoric-neo-hookean", "young": young, "poisson": min(poisson, LARGEST_POISSON)}
            changes[place] = other
    return changes


def print_table(rows: dict[str, dict[str, Any]]) -> None:
    """Print the opinions, and count the bodies of which there is none by reason."""
    heard = {name: row for name, row in rows.items() if "reason" not in row}
    for cells in (HEADINGS, ("---",) * len(HEADINGS)):
        print(f"| {' | '.join(cells)} |")
    for name, row in heard.items():
        displacement = row["displacement"] or math.inf
        share = [None if row[key] is None else row[key] / displacement for key in ("by_elements", "apart")]
        explained, apart = ["not known" if value is None else f"{value:.1e}" for value in share]
        kind = " | ".join(row[key] for key in ("law", "solved", "element", "verdict"))
        print(f"| {name} | {kind} | {row['largest'] * 1e3:.2g} ", end="")
        print(f"| {row['largest'] / displacement:.1e} | {explained} | {apart} |")
    print(f"\n{len(heard)} opinions: {dict(collections.Counter(row['verdict'] for row in heard.values()))}\n")
    for reason, count in collections.Counter(row["reason"] for row in rows.values() if "reason" in row).most_common():
        print(f"{count} x {reason}")


if __name__ == "__main__":
    main()
