"""Outlook on a sweep before it runs: number of cases, their sizes, and the time that they will take."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import islice

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.model.cell_layers import layers_of_cells
from hpcinv.model.spaces import Unknowns
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.outcomes import outcomes_of
from hpcinv.studies.batch.time_forecast import duration_text, remaining_seconds
from hpcinv.studies.sweep.results import results
from hpcinv.studies.sweep.sweep_plan import SweepPlan

MOST_MEASURED = 32
"""largest number of reuse groups whose mesh is made"""


def outlook(plan: SweepPlan, ledger: Ledger, groups: int) -> list[str]:
    """Return lines on the cases of a sweep, their sizes, and the time that the open ones take; not collective."""
    reuse_groups = dict(zip(plan.cases.keys, plan.cases.reuse_groups, strict=True))
    records = results(plan, ledger)
    failed = sum(not record.converged for record in records.values())
    also = f", {failed} of them failed" if failed else ""
    lines = [f"{plan.sweep.sweep}: {_count(len(plan.cases), 'case')}; {len(records)} finished in {plan.store}{also}"]
    if len(reuse_groups) < len(plan.cases):
        lines.append(f"  {len(reuse_groups):,} of them are different; duplicates are not run again")
    sizes, unknowns = _sizes(plan, Counter(reuse_groups.values()))
    return [*lines, *sizes, _time(reuse_groups, records, unknowns, groups)]


def _sizes(plan: SweepPlan, counts: Mapping[str, int]) -> tuple[list[str], dict[str, int]]:
    """Return a line on the mesh of each reuse group (``counts``: their numbers of cases), and the unknowns by group."""
    first = {group: plan.cases[place] for group, place in _first_places(plan.cases.reuse_groups).items()}
    lines = [
        f"  {_count(len(counts), 'reuse group')}, each with a mesh, kernels and a symbolic factorization of its own:"
    ]
    measured: dict[str, tuple[int, int] | str] = {}  # by the sections of the job that decide on it
    unknowns: dict[str, int] = {}
    for reuse_group, count in islice(counts.items(), MOST_MEASURED):
        job = plan.job(first[reuse_group])
        content = fingerprint(job)
        sections = json.dumps([content["mesh"], content["discretisation"]], sort_keys=True)
        if sections not in measured:
            measured[sections] = _size(job)
        text = size = measured[sections]
        if not isinstance(size, str):
            cells, unknowns[reuse_group] = size
            text = f"{cells:,} cells, {unknowns[reuse_group]:,} unknowns" + (" at first" if job.accuracy else "")
        lines.append(f"    {_count(count, 'case')} such as {first[reuse_group].title}: {text}")
    if len(counts) > MOST_MEASURED:
        lines.append(f"    {_count(len(counts) - MOST_MEASURED, 'reuse group')} more, not measured")
    return lines, unknowns


def _first_places(labels: Iterable[str]) -> dict[str, int]:
    places: dict[str, int] = {}
    for place, label in enumerate(labels):
        places.setdefault(label, place)
    return places


def _time(
    reuse_groups: Mapping[str, str], records: Mapping[str, CaseRecord], unknowns: Mapping[str, int], groups: int
) -> str:
    left = len(reuse_groups) - len(records)
    if not left:
        return "  nothing is left to run"
    seconds = remaining_seconds(reuse_groups, outcomes_of(records.items()), unknowns)
    if seconds is None:
        return "  time: not known, since no case is finished; run some first: 'sweep run --first 8' (results are kept)"
    ranks = sorted({int(record.statistics.get("machine", {}).get("ranks", 0)) for record in records.values()} - {0})
    ranks_text = f", with {' or '.join(map(str, ranks))} rank{'s' if ranks != [1] else ''} a case" if ranks else ""
    side = f"{_count(groups, 'group')} of ranks" + (" side by side" if groups > 1 else "")
    basis = f"from {_count(len(records), 'finished case')}"
    return f"  time: about {duration_text(seconds / groups)} for {_count(left, 'case')} on {side}{ranks_text} ({basis})"


def _size(job: Job) -> tuple[int, int] | str:
    try:
        body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve)
        layers = layers_of_cells(job, body)
    except MeshError as error:
        return error.message
    unknowns = Unknowns(body.mesh, job.discretisation.displacement, job.pressure_degree, layers)
    return body.mesh.topology.index_map(3).size_global, unknowns.size


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
