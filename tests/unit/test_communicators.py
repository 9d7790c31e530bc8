"""A process with few communicators left refuses a run, and needs none of garbage."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.left_for_run import require_communicators
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutOfMemory


@pytest.fixture
def taken() -> Iterator[list[MPI.Intracomm]]:
    """All but 20 communicators of this process."""
    made = list[MPI.Intracomm]()
    with suppress(MPI.Exception):
        while True:
            made.append(MPI.COMM_SELF.Dup())
    for _ in range(20):
        made.pop().Free()
    yield made
    for own in made:
        own.Free()


@pytest.mark.usefixtures("taken")
def test_a_run_without_communicators_is_refused() -> None:
    given = job(
        mesh=box((1, 1, 1), hexahedra=True),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -1], "density": 200}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
    )
    with pytest.raises(OutOfMemory, match=r"keeps so many results that MPI has no communicators left.*\n.*Keep arrays"):
        hpcinv.run(given, progress=False)


def test_garbage_gives_its_communicators_back(taken: list[MPI.Intracomm]) -> None:
    class Cycle:
        def __init__(self) -> None:
            self.itself, self.own = self, [taken.pop() for _ in range(300)]

        def __del__(self) -> None:
            for own in self.own:
                own.Free()

    Cycle()
    require_communicators(MPI.COMM_SELF)
