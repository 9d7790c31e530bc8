"""Solve the jobs of published values and compare: ``mpirun -n 2 python -m benchmarks.published [SOURCE …]``.

Finished runs are kept in ``--store``, so that an interrupted command goes on. Without names, all sources are run and
the page ``docs/verification/published.md`` is written with its picture.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hpcinv.parallel.runtime import MPI

from . import page
from .comparison import Row, compare
from .references import Reference, TableError, cases, read, sources
from .runs import summary_of

ROOT = Path(__file__).parents[2]


def rows_of(references: list[Reference], store: Path, comm: MPI.Intracomm) -> list[Row]:
    """Return the compared rows, in the order of the tables; collective."""
    compared: list[Row] = []
    grouped = cases(references)
    for number, case in enumerate(grouped.values(), 1):
        summary = summary_of(case[0], store, comm)
        rows = [compare(reference, summary) for reference in case]
        compared += rows
        if comm.rank == 0:
            for row in rows:
                values = f"theirs {row.reference.value}, ours {row.ours:.8g} ± {row.error:.1g} {row.reference.unit}, "
                print(
                    f"{number}/{len(grouped)} {row.reference.folder}/{row.reference.job} {row.reference.quantity}: "
                    f"{'' if row.missing else values}{row.verdict} {row.reason}",
                    flush=True,
                )
    return compared


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
