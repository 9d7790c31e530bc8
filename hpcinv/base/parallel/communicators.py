"""Communicators of MPI: a process has 2,048 with MPICH, and DOLFINx crashes without one."""

import gc
from contextlib import suppress

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutOfMemory

_OF_A_RUN = 128
"""Number that must be left: ten times what a result keeps. Raised, fewer results fit into a process; lowered, runs that
take more crash."""


def require_communicators(comm: MPI.Intracomm) -> None:
    """Collect garbage, which holds communicators, if few of them are left; collective.

    Raises:
        OutOfMemory: on all ranks, if too few are left after that.
    """
    if _are_few(comm):
        gc.collect()
        if _are_few(comm):
            raise OutOfMemory(
                "this process keeps so many results that MPI has no communicators left for another run",
                "Keep arrays and numbers of results instead of the results, whose bodies hold communicators.",
            )


def _are_few(comm: MPI.Intracomm) -> bool:
    """Return whether one of the ranks has fewer communicators left than a run may take; collective."""
    made = list[MPI.Intracomm]()
    with suppress(MPI.Exception):
        made.extend(MPI.COMM_SELF.Dup() for _ in range(_OF_A_RUN))
    is_few = len(made) < _OF_A_RUN
    for own in made:
        own.Free()
    return bool(comm.allreduce(is_few, op=MPI.LOR))
