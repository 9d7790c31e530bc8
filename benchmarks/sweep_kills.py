"""Kills of the allocations that work on a sweep, spread over its whole life: nothing may be lost or done twice.

Two allocations at a time work on a sweep of small cases. Again and again one of them, by turns, is killed as a node
that fails does, with all its processes, at a moment that is drawn: some in the first seconds, while directories are
made and kernels are loaded, most while cases are solved. At the end the same command, once more, must find every case
finished or finish it; no record may have changed, and no case may have been reported by two allocations.

Command: python benchmarks/sweep_kills.py [--kills 100] [--cases 60] [--seed 1]
"""

from __future__ import annotations

import argparse
import random
import re
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "sweep")]

from command_line import Started, hpcinv  # noqa: E402
from sweeps import records_of, write_sweep  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--steps", type=int, default=60, help="load steps of a case: the more, the longer it takes")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        return kill(Path(place), options)


def kill(place: Path, options: argparse.Namespace) -> int:
    chance = random.Random(options.seed)
    values = [8000 + 100 * i for i in range(options.cases)]
    steps = {"strategy": "fixed", "steps": options.steps}
    sweep = write_sweep(place, [{"grid": {"material.mu": values}}], set={"solver": steps})
    committed: dict[Path, tuple[int, bytes]] = {}
    reported: list[str] = []
    kills, alive = 0, list[Started]()
    while kills < options.kills:
        while len(alive) < 2:
            alive.append(Started(1 + kills % 2, "sweep", "run", sweep, cwd=place))
        # A fifth as they start, and the later the more cases are to be done before the end.
        time.sleep(chance.uniform(0.0, 3.0) if kills % 5 == 0 else chance.uniform(1.0, 8.0))
        victim = alive.pop(0)
        if victim.mpirun.poll() is None:
            victim.kill()
            kills += 1
        reported += re.findall(r"case (\d+), [^\n]*certificate", victim.text)
        problems = check(place, committed, reported)
        if any(record is not None and not record.converged for record in records_of(sweep).values()):
            problems.append("a case has failed")
        if problems:
            print("\n".join(problems), victim.text, sep="\n")
            return 1
        if len(committed) == options.cases:
            print(f"all cases were finished after {kills} kills: take more of them, or more steps")
            break
    for left in alive:
        left.exit_code()
        reported += re.findall(r"case (\d+), [^\n]*certificate", left.text)
    ended = hpcinv(2, "sweep", "run", sweep, cwd=place)
    reported += re.findall(r"case (\d+), [^\n]*certificate", ended.stdout)
    problems = check(place, committed, reported)
    records = records_of(sweep)
    converged = sum(record is not None and record.converged for record in records.values())
    attempts = max(record.attempts for record in records.values() if record is not None)
    print(f"{kills} kills: {converged} of {options.cases} cases converged, {attempts} attempts at most")
    print(f"exit code {ended.returncode}; {len(reported)} reports, of {len(set(reported))} cases")
    print("\n".join(problems) or "no record has changed, and none was written twice")
    return 1 if problems or converged != options.cases else 0


def check(place: Path, committed: dict[Path, tuple[int, bytes]], reported: list[str]) -> list[str]:
    """What has gone wrong so far."""
    problems = [f"case {number} was solved twice" for number in set(reported) if reported.count(number) > 1]
    for path in place.glob("store/ledger/*/*.record-*.json"):
        now = path.stat().st_ino, path.read_bytes()
        if committed.setdefault(path, now) != now:
            problems.append(f"{path.name} has changed")
    return problems


if __name__ == "__main__":
    sys.exit(main())
