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
sys.path[:0] = [str(ROOT / "tests")]

from helpers.command_line import Started, hpcinv  # noqa: E402
from helpers.sweeps import records_of, write_sweep  # noqa: E402


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
        # A fifth as they start, and all that are ahead of an even pace; the others once there is one more record.
        ahead = len(committed) >= 0.9 * options.cases * kills / options.kills
        deadline = time.monotonic() + 60
        while not ahead and kills % 5 and len(records(place)) <= len(committed) and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(chance.uniform(0.0, 3.0 if ahead or kills % 5 == 0 else 0.5))
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
            problems.append(f"all cases were finished after {kills} kills: take more of them, or more steps")
            print(problems[-1])
            return 1
    for left in alive:
        left.exit_code()
        reported += re.findall(r"case (\d+), [^\n]*certificate", left.text)
    ended = hpcinv(2, "sweep", "run", sweep, cwd=place)
    reported += re.findall(r"case (\d+), [^\n]*certificate", ended.stdout)
    problems = check(place, committed, reported)
    found = [record for record in records_of(sweep).values() if record is not None]
    converged = sum(record.converged for record in found)
    attempts = max(record.attempts for record in found)
    print(f"{kills} kills: {converged} of {options.cases} cases converged, {attempts} attempts at most")
    print(f"exit code {ended.returncode}; {len(reported)} reports, of {len(set(reported))} cases")
    print("\n".join(problems) or "no record has changed, and none was written twice")
    return 1 if problems or converged != options.cases else 0


def records(place: Path) -> list[Path]:
    return list(place.glob("store/ledger/*/*.record-*.json"))


def check(place: Path, committed: dict[Path, tuple[int, bytes]], reported: list[str]) -> list[str]:
    """What has gone wrong so far."""
    problems = [f"case {number} was solved twice" for number in set(reported) if reported.count(number) > 1]
    for path in records(place):
        now = path.stat().st_ino, path.read_bytes()
        if committed.setdefault(path, now) != now:
            problems.append(f"{path.name} has changed")
    return problems


if __name__ == "__main__":
    sys.exit(main())
