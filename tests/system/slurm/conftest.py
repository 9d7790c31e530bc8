"""The Slurm that the tests of this directory share; each worker of xdist that runs some of them has its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.batch import Batch
from helpers.cluster import Unavailable, cluster


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
