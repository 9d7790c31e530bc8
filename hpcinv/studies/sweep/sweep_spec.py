"""Sweep file: a job, and the axes along which it varies."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import ValidationInfo, field_validator

from hpcinv.base.files.untrusted import FileBeside, applies
from hpcinv.base.quantity.keys import JobKey
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import FileName, ListOf, Spec, raise_if_any
from hpcinv.base.reading.door import REFUSED
from hpcinv.studies.batch.axes import Axis, faults_between, number_of

MOST = 1_000_000
"""largest number of cases of a sweep, which can be checked within minutes"""


class Sweep(Spec):
    """Sweep: many cases of one job."""

    sweep: FileName = "sweep"
    """up to 100 letters, digits, dots, _, - (no dot or - first), naming the sweep; left out, the name of the file"""
    job: FileBeside
    """path from the sweep file to the job of all cases"""
    store: str | None = None
    """path from the sweep file to the store of all cases; left out, results/store in the working directory"""
    set: Mapping[JobKey, Any] = {}
    """values of all cases, unless an axis sets them"""
    warm_start: bool = True
    """whether a case begins with the solution of the nearest converged one; else with the unloaded body"""
    keep_solutions: bool = False
    """whether the solution of each case is kept; 'hpcinv sweep teach' learns the start of new jobs from them"""
    limit: Annotated[float, Quantity("s", above=0.0)] | None = None
    """wall time that a case may take, such as 10 min; one that takes longer has failed. Left out, there is none"""
    axes: ListOf[Axis]
    """every combination of their points is a case, the last axis changing fastest"""

    @property
    def branches(self) -> list[str]:
        """Names of the axes with branches, which are columns of the table."""
        return [axis.name for axis in self.axes if axis.branches is not None]

    @field_validator("store")
    @classmethod
    def _is_ours(cls, store: str | None, info: ValidationInfo) -> str | None:
        if store is not None and applies(info):
            raise ValueError(f"names a directory of results, which would be read, and is {REFUSED}; remove it")
        return store

    @field_validator("axes")
    @classmethod
    def _can_be_combined(cls, axes: tuple[Axis, ...]) -> tuple[Axis, ...]:
        if not axes:
            raise ValueError("must hold at least one axis")
        raise_if_any(faults_between(axes))
        if (cases := number_of(axes)) > MOST:
            raise ValueError(f"make {cases:,} cases, but a sweep can have no more than {MOST:,}; split it")
        return axes
