"""What a sweep will be: how many cases of what size, and how long they will take."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.forecast import forecast, in_words
from hpcinv.errors import MeshError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.mesh import build_body
from hpcinv.model.spaces import Unknowns
from hpcinv.parallel.runtime import MPI
from hpcinv.sweep.results import results

if TYPE_CHECKING:
    from hpcinv.batch.ledger.ledger import Ledger
    from hpcinv.batch.ledger.record import CaseRecord
    from hpcinv.job.job import Job
    from hpcinv.sweep.plan import SweepPlan


MOST_MEASURED = 32
"""reuse groups of which the mesh is made"""


class Size(NamedTuple):
    """Of a mesh and of what is solved on it."""

    cells: int
    unknowns: int


def outlook(plan: SweepPlan, ledger: Ledger, groups: int) -> list[str]:
    """Lines of text on the cases of a sweep, their sizes, and the time that the open ones take; not collective.

    Args:
        groups: how many groups of ranks will take cases side by side.
    """
    reuse_groups = {case.key: case.reuse_group for case in plan.cases}
    records = results(plan, ledger)
    return [
        *_counts(plan, len(reuse_groups), records),
        *_sizes_and_time(plan, reuse_groups, records, groups),
    ]


def _counts(plan: SweepPlan, distinct: int, records: Mapping[str, CaseRecord]) -> list[str]:
    failed = sum(not record.converged for record in records.values())
    also = f", {failed} of them failed" if failed else ""
    lines = [f"{plan.sweep.sweep}: {_count(len(plan.cases), 'case')}; {len(records)} finished in {plan.store}{also}"]
    if distinct < len(plan.cases):
        lines.append(f"  {distinct:,} of them are different; what is the same as another one is not run again")
    return lines


def _sizes_and_time(
    plan: SweepPlan, reuse_groups: Mapping[str, str], records: Mapping[str, CaseRecord], groups: int
) -> list[str]:
    first = {case.reuse_group: case for case in reversed(plan.cases)}
    counts = Counter(reuse_groups.values())
    lines = [
        f"  {_count(len(counts), 'reuse group')}, each with a mesh, kernels and a symbolic factorization of its own:"
    ]
    sizes: dict[str, Size | str] = {}
    unknowns: dict[str, int] = {}
    for reuse_group, count in islice(counts.items(), MOST_MEASURED):
        job = plan.job(first[reuse_group])
        where = _place(job)
        if where not in sizes:
            sizes[where] = _size(job)
        size = sizes[where]
        if isinstance(size, Size):
            unknowns[reuse_group] = size.unknowns
            what = f"{size.cells:,} cells, {size.unknowns:,} unknowns" + (" at first" if job.accuracy else "")
        else:
            what = size
        lines.append(f"    {_count(count, 'case')} such as {first[reuse_group].title}: {what}")
    if len(counts) > MOST_MEASURED:
        lines.append(f"    {_count(len(counts) - MOST_MEASURED, 'reuse group')} more, not measured")
    return lines + _time(reuse_groups, records, unknowns, groups)


def _time(
    reuse_groups: Mapping[str, str], records: Mapping[str, CaseRecord], unknowns: Mapping[str, int], groups: int
) -> list[str]:
    open_ = [reuse_group for key, reuse_group in reuse_groups.items() if key not in records]
    if not open_:
        return ["  nothing is left to run"]
    finished: dict[str, list[float]] = {}
    for key, record in records.items():
        finished.setdefault(reuse_groups[key], []).append(record.seconds)
    seconds = forecast(open_, finished, unknowns)
    if seconds is None:
        return [
            "  time: not known, since no case has been run yet; "
            "'sweep run --first 8' runs 8 of them, which are kept, and then this can tell"
        ]
    ranks = sorted({_ranks(record) for record in records.values()} - {0})
    a_case = f", with {' or '.join(map(str, ranks))} rank{'s' if ranks != [1] else ''} a case" if ranks else ""
    side = f"{_count(groups, 'group')} of ranks" + (" side by side" if groups > 1 else "")
    basis = f"from {_count(len(records), 'finished case')}"
    return [f"  time: about {in_words(seconds / groups)} for {_count(len(open_), 'case')} on {side}{a_case} ({basis})"]


def _ranks(record: CaseRecord) -> int:
    machine: Mapping[str, Any] = record.statistics.get("machine", {})
    return int(machine.get("ranks", 0))


def _place(job: Job) -> str:
    """What decides on the size of a job: its mesh and its spaces."""
    content = fingerprint(job)
    return json.dumps([content["mesh"], content["discretisation"]], sort_keys=True)


def _size(job: Job) -> Size | str:
    """Cells and unknowns, or why there is no mesh."""
    try:
        body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve)
    except MeshError as error:
        return error.message
    unknowns = Unknowns(body.mesh, job.discretisation.displacement, job.pressure_degree)
    return Size(body.mesh.topology.index_map(3).size_global, unknowns.size)


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
