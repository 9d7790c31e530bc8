"""Parallel tests: only the door writes the state of a model."""

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def only_the_door_writes() -> Iterator[None]:
    """Raise where something else writes mesh, unknowns, load factors or supports."""
    from helpers.door_guard import guarded

    with guarded():
        yield
