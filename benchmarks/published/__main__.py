"""Solve the jobs of published values and compare: ``mpirun -n 2 python -m benchmarks.published [SOURCE …]``.

Ranks share the cases. Finished runs are kept in ``--store``, so that an interrupted command goes on. Without names,
all sources are run and the page ``docs/verification/published.md`` is written with its picture.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from hpcinv.base.parallel.ranks import MPI, failing_together, on_root

from . import page
from .comparison import ComparedValue, compare
from .references import PublishedValue, TableError, cases, read, sources
from .runs import summary_of

ROOT = Path(__file__).parents[2]


def rows_of(references: list[PublishedValue], store: Path, comm: MPI.Intracomm) -> list[ComparedValue]:
    """Return the compared rows, in the order of the tables; collective.

    Ranks share the cases: each takes the next one that is free and solves it alone, since kernels of small bodies take
    longer to compile than their equations to solve. Cases from the same forward job are one task: none is solved twice.
    """
    by_case = cases(references)
    tasks: dict[tuple[str, str, str], list[list[PublishedValue]]] = {}
    for case in by_case.values():
        row = case[0]
        tasks.setdefault((row.folder, row.loaded or row.job, repr(sorted(row.changes.items()))), []).append(case)
    claims = Path(on_root(comm, lambda: _folder_of_claims(store)))
    compared: dict[tuple[int, str], list[ComparedValue]] = {}
    with failing_together(comm):
        for number, task in enumerate(tasks.values(), 1):
            if _is_claimed(claims / str(number)):
                for case in task:
                    compared[case[0].line, case[0].folder] = _compared(case, store, f"{number}/{len(tasks)}")
        everywhere = {key: rows for part in comm.allgather(compared) for key, rows in part.items()}
    on_root(comm, lambda: shutil.rmtree(claims))
    return [row for case in by_case.values() for row in everywhere[case[0].line, case[0].folder]]


def _folder_of_claims(store: Path) -> str:
    store.mkdir(parents=True, exist_ok=True)
    return tempfile.mkdtemp(prefix="claims-", dir=store)


def _is_claimed(file: Path) -> bool:
    """Claim a task by a file that only one rank can create, and return whether this rank did."""
    try:
        file.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def _compared(case: list[PublishedValue], store: Path, progress: str) -> list[ComparedValue]:
    """Return the compared rows of one case, solved on this rank."""
    summary = summary_of(case[0], store, MPI.COMM_SELF)
    rows = [compare(reference, summary) for reference in case]
    for row in rows:
        values = f"theirs {row.reference.value}, ours {row.ours:.8g} ± {row.error:.1g} {row.reference.unit}, "
        print(
            f"{progress} {row.reference.folder}/{row.reference.job} {row.reference.quantity}: "
            f"{'' if row.missing else values}{row.verdict} {row.reason}",
            flush=True,
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", nargs="*", help="names of sources; default: all")
    parser.add_argument("--store", type=Path, default=ROOT / "results" / "published", help="finished runs")
    parser.add_argument("--small", action="store_true", help="only the rows that the tests run")
    options = parser.parse_args()
    comm = MPI.COMM_WORLD
    if unknown := sorted(set(options.source) - set(sources())):
        sys.exit(f"there is no source {', '.join(unknown)}; there are {', '.join(sources())}")
    try:
        references = [row for name in options.source or sources() for row in read(name)]
    except TableError as error:
        sys.exit(str(error))
    rows = rows_of([row for row in references if row.small or not options.small], options.store, comm)
    if comm.rank == 0:
        if not options.source and not options.small:
            page.write(rows, ROOT)
        else:
            print(page.table(rows))
        sys.exit(any(row.verdict not in ("inside", "skipped") for row in rows))


if __name__ == "__main__":
    main()
