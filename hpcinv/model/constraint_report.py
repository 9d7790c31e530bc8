"""What a solution says about the unknown numbers of a load or support."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from hpcinv.base.quantity.units import readable
from hpcinv.job.cavities import Cavity
from hpcinv.job.job import Job
from hpcinv.job.support import Motion, RemoteLoad


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


@dataclass(frozen=True)
class CavityReport(ConstraintReport):
    """A cavity whose pressure was unknown, in a solution. All in SI.

    Attributes:
        control: as it was given.
        pressure: that the solve found.
        volume: in the loaded body; unloaded_volume: in the unloaded body.
        residual: of its equation, relative to the larger volume.
        compliance: fall of the volume with the pressure of its gas or windkessel (m³/Pa), 0 with a given volume.
    """

    section: ClassVar[str] = "cavities"
    what: ClassVar[str] = "the pressure of a cavity"

    name: str
    control: Cavity
    pressure: float
    volume: float
    unloaded_volume: float
    residual: float
    compliance: float = 0.0

    @property
    def label(self) -> str:
        return self.name

    @property
    def note(self) -> str:
        return f"pressure {readable(self.pressure, 'Pa', 6)}, volume {readable(self.volume, 'm^3', 6)}"

    def as_data(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "control"}

    def given_in(self, job: Job) -> Job:
        return job.with_pressures({self.name: self.pressure})

    def posed_in(self, job: Job) -> Job:
        return job.model_copy(update={"cavities": {**job.cavities, self.name: self.control}})

    def shifted(self, step: Sequence[float]) -> CavityReport:
        return replace(self, pressure=self.pressure + float(step[0]))


@dataclass(frozen=True)
class RemoteReport(ConstraintReport):
    """A region under a remote load, in a solution. All in SI.

    Attributes:
        support: number of the support in the job.
        load: as it was given.
        motion: from the unloaded to the loaded body; its axis goes through the reference point.
        residual: force or moment that is not balanced, relative to the nodal forces on the region or their moments.
    """

    section: ClassVar[str] = "remote_loads"
    what: ClassVar[str] = "the motion under a remote load"
    count: ClassVar[int] = 6

    region: str
    support: int
    load: RemoteLoad
    motion: Motion
    residual: float

    @property
    def moved(self) -> str:
        """Displacement of the reference point as text."""
        return f"({', '.join(f'{c + 0.0:.4g}' for c in self.motion.move)}) m"

    @property
    def label(self) -> str:
        return self.region

    @property
    def note(self) -> str:
        return f"turned by {np.degrees(self.motion.rotate):.4g}°, moved by {self.moved}"

    def as_data(self) -> dict[str, Any]:
        motion = self.motion.model_dump(mode="json")
        return {"region": self.region, **self.load.model_dump(mode="json"), "motion": motion, "residual": self.residual}

    def given_in(self, job: Job) -> Job:
        return job.with_motions({self.support: self.motion})

    def posed_in(self, job: Job) -> Job:
        supports = list(job.supports)
        supports[self.support] = supports[self.support].model_copy(update={"motion": None, "remote": self.load})
        return job.model_copy(update={"supports": tuple(supports)})


def by_section(reports: Sequence[ConstraintReport]) -> Mapping[str, list[dict[str, Any]]]:
    """Return the data of reports by the section of the summary."""
    data: dict[str, list[dict[str, Any]]] = {}
    for report in reports:
        data.setdefault(report.section, []).append(report.as_data())
    return data


def of_kind[R: ConstraintReport](reports: Sequence[ConstraintReport], kind: type[R]) -> tuple[R, ...]:
    """Return the reports of one kind."""
    return tuple(report for report in reports if isinstance(report, kind))
