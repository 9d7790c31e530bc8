"""What a solution says about the unknown numbers of a load or support."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

from hpcinv.job.job import Job


class ConstraintReport(ABC):
    """Numbers that a solve found so that equations for them hold. All in SI.

    Attributes:
        section: of the summary.
        what: numbers of this kind, in messages.
        count: number of them.
        residual: of their equations, relative to their terms.
    """

    section: ClassVar[str]
    what: ClassVar[str]
    count: ClassVar[int] = 1
    residual: float

    @property
    @abstractmethod
    def label(self) -> str:
        """Name of the load or support, in lines of the certificate."""

    @property
    @abstractmethod
    def note(self) -> str:
        """What was found, as text."""

    @abstractmethod
    def as_data(self) -> dict[str, Any]:
        """Return JSON data for the summary."""

    @abstractmethod
    def given_in(self, job: Job) -> Job:
        """Return the job with the numbers that were found as given ones."""

    @abstractmethod
    def posed_in(self, job: Job) -> Job:
        """Return the job that `given_in` returned with the numbers as unknowns again."""

    def shifted(self, step: Sequence[float]) -> Self:
        """Return the report with its numbers changed by a step, as far as quantities ask for them."""
        return self


def by_section(reports: Sequence[ConstraintReport]) -> Mapping[str, list[dict[str, Any]]]:
    """Return the data of reports by the section of the summary."""
    data: dict[str, list[dict[str, Any]]] = {}
    for report in reports:
        data.setdefault(report.section, []).append(report.as_data())
    return data


def of_kind[R: ConstraintReport](reports: Sequence[ConstraintReport], kind: type[R]) -> tuple[R, ...]:
    """Return the reports of one kind."""
    return tuple(report for report in reports if isinstance(report, kind))


def of_section(reports: Sequence[ConstraintReport], section: str) -> tuple[Any, ...]:
    """Return the reports of a section of the summary, which are of one kind."""
    return tuple(report for report in reports if report.section == section)
