"""Plan of a sweep: every case with its key, all checked before any of them begins."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import is_asked
from hpcinv.errors import JobError
from hpcinv.job.job import UNNAMED, Job, parse
from hpcinv.job.job_variants import JobVariants
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import keys_of, numbers_of
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.studies.batch.axes import combined, sections_first
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.specification import SpecificationFaults, changed_data, read_base, read_spec, texts_of
from hpcinv.studies.sweep.sweep_spec import Sweep

_STORE = Path("results/store")
# For thousands of cases summaries are enough, and most cases take less time than a checkpoint.
_DEFAULTS: dict[str, Mapping[str, Any]] = {
    "output": {"fields": False, "mesh": [], "summary": ["json"]},
    "checkpoint": {"seconds": 10.0},
}
_KEEPING = {"checkpoint": {"seconds": 0.0, "keep": 1}}
"""The same, where solutions are kept."""


@dataclass(frozen=True)
class Case:
    """One job of a sweep.

    Attributes:
        key: hash of everything that its results depend on, the same in every sweep (20 hex digits).
        reuse_group: key of the cases that share mesh, equations and the pattern of the factorization.
        numbers: the numbers in which cases of one reuse group differ (SI).
        parameters: values by key as in the file, sampled ones in SI, and labels of branches by the name of their axis.
        settings: values by key that are set in the job of the sweep.
        home: directory of the file of its mesh.
    """

    number: int
    key: str
    reuse_group: str
    numbers: tuple[float, ...]
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    home: Path

    @property
    def title(self) -> str:
        return _title(self.number, self.parameters)


@dataclass(frozen=True)
class SweepPlan:
    """A sweep and its cases in order; ``data`` is the content of the job file ``base``.

    Attributes:
        is_untrusted: whether the file is from another source, so that nothing in its jobs may be executed.
    """

    path: Path
    sweep: Sweep
    base: Path
    data: Mapping[str, Any]
    cases: tuple[Case, ...]
    is_untrusted: bool = False

    @property
    def store(self) -> Path:
        """Directory of the store, which sweeps may share."""
        return _STORE if self.sweep.store is None else self.path.parent / self.sweep.store

    @property
    def ledger(self) -> Ledger:
        """The ledger of the store, for reading."""
        return ledger_of(self.store, {case.key: case.home for case in self.cases})

    @property
    def results(self) -> Path:
        """Directory of tables, diagrams and scripts, unless another one is given."""
        return Path("results") / self.sweep.sweep

    def job(self, case: Case) -> Job:
        """Return the job of a case; raises ``JobError`` if a file that it needs was removed meanwhile."""
        return parse(self.content(case), self.base, untrusted=self.is_untrusted)

    def content(self, case: Case) -> Mapping[str, Any]:
        """Return the content of a job file of the case, with paths relative to the job of the sweep."""
        return _content(self.data, case.settings, self.sweep.keep_solutions)


def load_sweep(
    source: str | Path | Mapping[str, Any], directory: str | Path = ".", *, untrusted: bool = False
) -> SweepPlan:
    """Read a sweep, a file or a mapping with the content of one, and check all of its cases.

    Args:
        directory: base of relative paths in a mapping; in a file they are relative to the file.
        untrusted: the sweep is from another source, as in `hpcinv.job.job.load`.

    Raises:
        JobError: with a line for each fault, of the form ``file: case (and n more cases): key: fault``.
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
    faults = SpecificationFaults(path, "case")
    cases = tuple(_cases(sweep, base, data, faults, untrusted))
    faults.raise_if_any()
    return SweepPlan(path, sweep, base, data, cases, untrusted)


def _cases(
    sweep: Sweep, base: Path, data: Mapping[str, Any], faults: SpecificationFaults, untrusted: bool
) -> Iterator[Case]:
    """Yield every valid case; faults of the others are added to ``faults``."""
    known, variants, contents = SectionData(), JobVariants(base, untrusted=untrusted), _Contents(sweep, data)
    for number, (parameters, given) in enumerate(combined(sweep.axes)):
        with faults.collected(_title(number, parameters), base):
            settings, content = contents.of(given)
            job = variants.job(content)
            key, reuse_group = keys_of(job, known)
            home = job.resolve(job.mesh.file).absolute().parent
            yield Case(number, key, reuse_group, numbers_of(job), parameters, settings, home)


class _Contents:
    """Contents of the job files of cases; sections that no axis sets are the same objects in all of them."""

    def __init__(self, sweep: Sweep, data: Mapping[str, Any]) -> None:
        self._data, self._defaults, self._keeps_solutions = data, sections_first(sweep.set), sweep.keep_solutions
        self._templates: dict[frozenset[str], tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {}

    def of(self, given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return all settings of a case by key, and the content of its job file, for the settings of its axes."""
        replaced = frozenset(self._defaults.keys() & given.keys())
        if replaced not in self._templates:
            common = {key: value for key, value in self._defaults.items() if key not in replaced}
            plain = changed_data(self._data, common)
            self._templates[replaced] = common, plain, _with_defaults(plain, self._keeps_solutions)
        common, plain, complete = self._templates[replaced]
        settings = sections_first(given)
        changed: dict[str, Any] = changed_data(plain, settings)
        if all(changed.get(section) is plain.get(section) for section in _DEFAULTS):
            changed |= {section: complete[section] for section in _DEFAULTS}
        else:
            changed = _with_defaults(changed, self._keeps_solutions)
        return {**common, **settings}, changed


def _content(data: Mapping[str, Any], settings: Mapping[str, Any], keeps_solutions: bool) -> Mapping[str, Any]:
    """Return the content of a job file with some settings, whose only output by default is the summary."""
    return _with_defaults(changed_data(data, settings), keeps_solutions)


def _with_defaults(content: Mapping[str, Any], keeps_solutions: bool) -> dict[str, Any]:
    completed = dict(content)
    for section, default in (_DEFAULTS | _KEEPING if keeps_solutions else _DEFAULTS).items():
        given = completed.get(section, {})
        if isinstance(given, Mapping):
            completed[section] = {**default, **given}
    return completed


def _title(number: int, parameters: Mapping[str, Any]) -> str:
    return ", ".join((f"case {number}", *texts_of(parameters)))
