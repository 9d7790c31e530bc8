"""What a further state of a body costs in addition to its solve, on the bodies of ``benchmarks/machine.py``.

Command: python benchmarks/states.py [--sizes N …] [--repeat 3]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData, median
from bodies import measure
from machine import bodies

if TYPE_CHECKING:
    from machine import Bodies

_STATES = (1, 2, 5)


def section(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    return [states(bench, bodies(bench), options.sizes, options.repeat)]


def states(bench: Bench, measured: Bodies, sizes: Sequence[int], repeat: int) -> Findings:
    """Measure jobs of one, two and five states on one rank."""
    jobs = {
        f"{name}, {size}, {count}": (states_job({**body(size), "certificate": WITHOUT_CERTIFICATE}, count), 1)
        for size in sizes
        for name, body in measured.items()
        for count in _STATES
    }
    runs = bench.alternating(jobs, repeat)
    seconds = {
        name: {
            "command": median(measured_run, lambda run: run.seconds),
            "solver": median(measured_run, lambda run: run.solver),
            "others": median(measured_run, lambda run: run.seconds - run.solver),
        }
        for name, measured_run in runs.items()
    }
    rows, notes = list[tuple[str, ...]](), list[str]()
    for size in sizes:
        for name in measured:
            single, last = (seconds[f"{name}, {size}, {count}"] for count in (_STATES[0], _STATES[-1]))
            for count in _STATES:
                key = f"{name}, {size}, {count}"
                measured_run = runs[key][0]
                figures = (f"{value:.2f}" for value in seconds[key].values())
                rows.append(
                    (name, f"{measured_run.unknowns}", str(count), f"{measured_run.count('factorizations')}", *figures)
                )
            each = {title: (last[title] - single[title]) / (_STATES[-1] - _STATES[0]) for title in single}
            notes.append(
                f"{name}, {rows[-1][1]} unknowns: a further state takes {each['command']:.2f} s, {each['solver']:.2f} s"
                f" of them its solve; a job of its own would take {single['others']:.2f} s and its solve"
            )
    return Findings(
        f"states: 1 rank, seconds, medians of {repeat}",
        ("body", "unknowns", "states", "factorizations", "command", "solver", "others"),
        rows,
        notes,
        {"repeat": repeat, "seconds": seconds},
    )


def states_job(job: JobData, count: int) -> JobData:
    """Return a job with a number of loaded states: the given one, and others with the load turned and smaller."""
    (effect,), loaded_states = job["effects"], []
    for i in range(count):
        x, y, z = ((1 - i / 8) * a for a in effect["acceleration"])
        turned = effect | {"acceleration": [x, y, z] if i % 2 == 0 else [x, z, y]}
        loaded_states.append({"name": f"state-{i}", "effects": [turned]} | ({} if i else {"given": True}))
    return {key: value for key, value in job.items() if key != "effects"} | {"states": loaded_states}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[15_000], help="unknowns, about")
    measure(parser, section)
