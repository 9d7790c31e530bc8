"""Plans that are kept in the stores of sweeps, so that a status or a table of many cases need not check them again.

``plans/SWEEP.json`` in a store has what was found for each case, and the digests of all files that were read for it. It
counts as long as sweep, job and files have the same content, and the first and the last case still have their keys.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic_core import PydanticSerializationError

from hpcinv.base.files.atomic import make_directory, replace
from hpcinv.base.files.inputs import digest_of
from hpcinv.base.reading.door import admitted
from hpcinv.errors import HpcinvError, OutputError
from hpcinv.job.fingerprint import FORMAT, hash_of
from hpcinv.studies.batch.ledger.store import open_store
from hpcinv.studies.sweep.cases import Cases
from hpcinv.studies.sweep.sweep_plan import SweepFile, SweepPlan, read_sweep
from hpcinv.version import __version__

PLANS = "plans"
"""directory in a store"""
LEAST = 100
"""Cases of a sweep whose plan is kept. Raised, a status checks more cases again, each in a fifth of a millisecond."""


def known_plan(path: Path) -> SweepPlan:
    """Return the plan of a sweep: as its run has kept it, or made anew.

    Raises:
        JobError: as `hpcinv.studies.sweep.sweep_plan.load_sweep`.
    """
    file = read_sweep(path)
    return _kept(file) or file.plan()


def keep_plan(plan: SweepPlan) -> None:
    """Keep the plan of a whole sweep in its store, if that can be written."""
    content = _content(plan)
    if len(plan.cases) < max(LEAST, plan.case_count) or content is None:
        return
    files = {str(path): digest_of(path) for path in sorted(plan.files_read)}
    data = {"content": content, "files": files, "cases": plan.cases.as_data()}
    file = _file(plan)
    with suppress(OutputError, OSError):
        open_store(plan.store)
        make_directory(file.parent)
        replace(file, json.dumps(data).encode(), shared=True)


def _kept(file: SweepFile) -> SweepPlan | None:
    """Return the plan that is kept for a sweep; ``None`` if there is none, or something differs."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, HpcinvError):
        data = json.loads(admitted(_file(file)).read_bytes())
        if data["content"] != _content(file) or any(digest_of(Path(p)) != d for p, d in data["files"].items()):
            return None
        cases = Cases.of_data(file.sweep, data["cases"])
        ends = [0, len(cases) - 1]
        if len(cases) == file.case_count and file.found(ends) == [cases.found(place) for place in ends]:
            files = frozenset(map(Path, data["files"]))
            return SweepPlan(file.path, file.sweep, file.base, file.data, file.is_untrusted, cases, files)
    return None


def _file(file: SweepFile) -> Path:
    return file.store / PLANS / f"{file.sweep.sweep}.json"


def _content(file: SweepFile) -> str | None:
    """Return a digest of what a plan follows from, without the files that the job names; ``None`` without one."""
    versions: Mapping[str, Any] = {"hpcinv": __version__, "keys": FORMAT}
    try:
        sweep = file.sweep.model_dump(mode="json", exclude={"store", "limit"}, warnings=False)
        place = str(file.base.absolute().parent)
        return hash_of([versions, sweep, file.data, place, file.is_untrusted])
    except (PydanticSerializationError, TypeError, ValueError):
        return None
