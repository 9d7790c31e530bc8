"""The Slurm that the tests of this directory share; each worker of xdist that runs some of them has its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.batch import Batch
from helpers.cluster import Unavailable, cluster
from helpers.slow_jobs import submit_slowly


@pytest.fixture(scope="session")
def slurm() -> Iterator[dict[str, str]]:
    """What a user of the cluster has in the environment."""
    try:
        with cluster() as environment:
            yield environment
    except Unavailable as why:
        pytest.skip(f"no Slurm: {why}")


@pytest.fixture
def batch(slurm: dict[str, str], tmp_path: Path) -> Iterator[Batch]:
    """A user of the cluster in a directory of their own, whose jobs end with the test."""
    user = Batch(slurm, tmp_path)
    yield user
    user.cancel()


@pytest.fixture(scope="session")
def limited(slurm: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Batch, str]]:
    """A job and its id, which Slurm stops ahead of its limit of a minute.

    Tests of sweeps ask for it, too, so that this minute passes while they wait for something else.
    """
    user = Batch(slurm, tmp_path_factory.mktemp("limited"))
    yield user, submit_slowly(user, "--time=1", "--signal=B:USR1@45")
    user.cancel()
