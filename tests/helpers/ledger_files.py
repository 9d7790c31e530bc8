"""Files of a ledger that tests write and read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.claims import CaseState
from hpcinv.studies.batch.ledger.ledger import Ledger

KEY, OTHER = "ab" + 18 * "0", "ab" + 18 * "1"
DONE = CaseRecord("converged", "", {"quantities": {"length": 0.1}}, 1.5, 1)
FAILED = CaseRecord("a limit points of the path", "more steps", {}, 0.1, 1, OTHER)


def shard_of(store: Path) -> Path:
    """The only file with lines on records."""
    [path] = (store / "ledger" / "records").glob("*.jsonl")
    return path


def lines(store: Path) -> list[bytes]:
    return shard_of(store).read_bytes().splitlines(keepends=True)


def committed(store: Path) -> dict[tuple[str, int, int], bytes]:
    """The complete lines of all shards by key, round and claim."""
    content = b"".join(path.read_bytes() for path in (store / "ledger" / "records").glob("*.jsonl"))
    cases = {line: json.loads(line)["case"] for line in content.splitlines(keepends=True) if line.endswith(b"\n")}
    return {(case["key"], case["round"], case["claim"]): line for line, case in cases.items()}


def damage(store: Path, key: str) -> None:
    """Change a byte in the line of a case."""
    for path in (store / "ledger" / "records").glob("*.jsonl"):
        lines = path.read_bytes().splitlines(keepends=True)
        changed = [line.replace(b"converged", b"convergeD", 1) if key.encode() in line else line for line in lines]
        path.write_bytes(b"".join(changed))


def entries(store: Path) -> list[dict[str, Any]]:
    """The entries of the log, in their order."""
    files = sorted((store / "ledger" / "log").glob("[!.]*"))
    return [json.loads(path.read_bytes())["entry"] for path in files]


def earlier_file(store: Path, kind: str = "record-1.json") -> Path:
    """A file of a ledger of one file for each case, in a store of the first format."""
    directory = store / "ledger" / KEY[:2]
    directory.mkdir(parents=True, exist_ok=True)
    (store / "store.json").write_text('{"format": "hpcinv store 1"}')
    return directory / f"{KEY}.{kind}"


def test_only_a_failed_case_is_tried_again(ledger: Ledger, store: Path) -> None:
    assert not ledger.retry(KEY)
    first = ledger.claim(KEY)
    assert first is not None
    assert not ledger.retry(KEY)
    first.run.mkdir(parents=True)
    ledger.commit(first, FAILED)
    assert ledger.retry(KEY)
    assert not ledger.retry(KEY)
    assert ledger.states([KEY])[KEY] == CaseState("open")
    assert ledger.record(KEY) is None
    second = ledger.claim(KEY)
    assert second is not None
    assert (second.round, second.attempt, second.died) == (2, 1, 0)
    assert not any(ledger.directory(KEY).iterdir())
    assert not ledger.commit(first, DONE)  # too late: that round is over
    assert ledger.commit(second, DONE)
    assert not ledger.retry(KEY)
    assert ledger.record(KEY) == DONE
    kept = [json.loads(line)["case"]["brief"]["status"] for line in lines(store)]
    assert kept == [FAILED.status, DONE.status]


def finished(ledger: Ledger, meanwhile: Ledger) -> None:
    claim = meanwhile.claim(KEY)
    assert claim is not None
    assert meanwhile.commit(claim, FAILED)
