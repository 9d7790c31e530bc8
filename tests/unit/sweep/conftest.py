"""Fixtures of several files: a store, and its ledger."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return tmp_path / "results" / "store"


@pytest.fixture
def ledger(store: Path) -> Iterator[Ledger]:
    with Holder(store) as me:
        yield Ledger(store, me)
