"""Plan of a sweep: every case with its key, all checked before any of them begins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import files_noted, is_asked
from hpcinv.errors import JobError
from hpcinv.job.job import UNNAMED, Job, parse
from hpcinv.job.job_variants import JobVariants
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.studies.batch.axes import number_of, sections_first
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.points import AxisPoint, CombinedPoints
from hpcinv.studies.batch.specification import SpecificationFaults, changed_data, read_base, read_spec
from hpcinv.studies.sweep.cases import Case, Cases, Found, title_of
from hpcinv.studies.sweep.sweep_spec import Sweep

_STORE = Path("results/store")
# For thousands of cases summaries are enough, and most cases take less time than a checkpoint.
_DEFAULTS: dict[str, Mapping[str, Any]] = {
    "output": {"fields": False, "mesh": [], "summary": ["json"]},
    "checkpoint": {"seconds": 10.0},
}
_KEEPING = {"checkpoint": {"seconds": 0.0, "keep": 1}}
"""Defaults of sweeps that keep solutions."""


@dataclass(frozen=True)
class SweepFile:
    """A sweep whose cases are not checked yet; ``data`` is the content of the job file ``base``.

    Attributes:
        is_untrusted: whether the file is from another source, so that nothing in its jobs may be executed.
    """

    path: Path
    sweep: Sweep
    base: Path
    data: Mapping[str, Any]
    is_untrusted: bool

    @property
    def store(self) -> Path:
        """Directory of the store, which sweeps may share."""
        return _STORE if self.sweep.store is None else self.path.parent / self.sweep.store

    @property
    def results(self) -> Path:
        """Directory of tables, diagrams and scripts, unless another one is given."""
        return Path("results") / self.sweep.sweep

    @property
    def case_count(self) -> int:
        return number_of(self.sweep.axes)

    def plan(self, first: int | None = None) -> SweepPlan:
        """Check all cases, or the ``first`` ones.

        Raises:
            JobError: with a line for each fault, of the form ``file: case (and n more cases): key: fault``.
        """
        cases, faults = Cases(self.sweep), SpecificationFaults(self.path, "case")
        reader = CaseReader(self)
        with files_noted() as files:
            for number in range(len(cases.points))[:first]:
                point = cases.points[number]
                try:
                    cases.append(*reader.find(point))
                except JobError as error:
                    faults.add(error, title_of(number, point.parameters), self.base)
        faults.raise_if_any()
        return SweepPlan(self.path, self.sweep, self.base, self.data, self.is_untrusted, cases, frozenset(files))

    def found(self, numbers: Iterable[int]) -> list[Found]:
        """Check some cases by their numbers, and return what is found; raises ``JobError`` for a fault."""
        points, reader = CombinedPoints(self.sweep.axes), CaseReader(self)
        return [reader.find(points[number]) for number in numbers]


class CaseReader:
    """Reader of cases of a sweep, which share the sections in which they do not differ."""

    def __init__(self, file: SweepFile) -> None:
        self._variants = JobVariants(file.base, untrusted=file.is_untrusted)
        self._contents = _Contents(file.sweep, file.data)

    def job(self, point: AxisPoint) -> Job:
        """Return the job of a case, as `SweepPlan.job`; raises ``JobError`` with its faults."""
        return self._variants.job(self._contents.of(point.settings))

    def find(self, point: AxisPoint) -> Found:
        """Return what is found for a case by checking it; raises ``JobError`` with its faults."""
        return self._variants.identity(self.job(point))


@dataclass(frozen=True)
class SweepPlan(SweepFile):
    """A sweep and its cases in order.

    Attributes:
        files_read: files on which the cases depend, in addition to the sweep and its job.
    """

    cases: Cases
    files_read: frozenset[Path] = frozenset()

    @property
    def ledger(self) -> Ledger:
        """The ledger of the store, for reading."""
        return ledger_of(self.store, self.cases.home_of())

    def job(self, case: Case) -> Job:
        """Return the job of a case; raises ``JobError`` if a file that it needs was removed meanwhile."""
        return parse(self.content(case), self.base, untrusted=self.is_untrusted)

    def content(self, case: Case) -> Mapping[str, Any]:
        """Return the content of a job file of the case, with paths relative to the job of the sweep."""
        return _with_defaults(changed_data(self.data, case.settings), self.sweep.keep_solutions)


def read_sweep(
    source: str | Path | Mapping[str, Any], directory: str | Path = ".", *, untrusted: bool = False
) -> SweepFile:
    """Read a sweep, a file or a mapping with the content of one.

    Args:
        directory: base of relative paths in a mapping; in a file they are relative to the file.
        untrusted: the sweep is from another source, as in `hpcinv.job.job.load`.

    Raises:
        JobError: with a line for each fault of the file.
    """
    if isinstance(source, Mapping):
        path, content = Path(directory) / UNNAMED, {"sweep": "sweep", **source}
    else:
        path, content = Path(source), dict(read_yaml(Path(source)))
    if "axes" not in content:
        raise JobError(f"{path}: is not a sweep, since it has no 'axes'; use 'run' for jobs, 'study' for studies")
    untrusted = untrusted or is_asked()
    sweep = read_spec(Sweep, "sweep", path, content, untrusted=untrusted)
    base, data = read_base(path, sweep.job)
    return SweepFile(path, sweep, base, data, untrusted)


def load_sweep(
    source: str | Path | Mapping[str, Any], directory: str | Path = ".", *, untrusted: bool = False
) -> SweepPlan:
    """Read a sweep and check all of its cases; as `read_sweep` and `SweepFile.plan`."""
    return read_sweep(source, directory, untrusted=untrusted).plan()


class _Contents:
    """Contents of the job files of cases; sections that no axis sets are the same objects in all of them."""

    def __init__(self, sweep: Sweep, data: Mapping[str, Any]) -> None:
        self._data, self._defaults, self._keeps_solutions = data, sections_first(sweep.set), sweep.keep_solutions
        self._templates: dict[frozenset[str], tuple[dict[str, Any], dict[str, Any]]] = {}

    def of(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the content of the job file of a case, for the settings of its axes."""
        replaced = frozenset(self._defaults.keys() & given.keys())
        if replaced not in self._templates:
            common = {key: value for key, value in self._defaults.items() if key not in replaced}
            plain = changed_data(self._data, common)
            self._templates[replaced] = plain, _with_defaults(plain, self._keeps_solutions)
        plain, complete = self._templates[replaced]
        changed: dict[str, Any] = changed_data(plain, sections_first(given))
        if all(changed.get(section) is plain.get(section) for section in _DEFAULTS):
            changed |= {section: complete[section] for section in _DEFAULTS}
        else:
            changed = _with_defaults(changed, self._keeps_solutions)
        return changed


def _with_defaults(content: Mapping[str, Any], keeps_solutions: bool) -> dict[str, Any]:
    completed = dict(content)
    for section, default in (_DEFAULTS | _KEEPING if keeps_solutions else _DEFAULTS).items():
        given = completed.get(section, {})
        if isinstance(given, Mapping):
            completed[section] = {**default, **given}
    return completed
