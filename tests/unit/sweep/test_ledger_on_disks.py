"""Ledgers on full, read-only, vanished and foreign directories, and without hard links."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.ledger_files import (
    DONE,
    KEY,
    OTHER,
    lines,
    shard_of,
    test_only_a_failed_case_is_tried_again,
)

from hpcinv.base.files import atomic
from hpcinv.errors import OutputError
from hpcinv.studies.batch.ledger.claims import CaseState
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.ledger.store import as_output_error, open_store

# What it says when the file system fails


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB of its own."""
    path = tmp_path / "disk"
    path.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", path], capture_output=True, check=False)
    if mount.returncode:
        pytest.skip("needs the right to mount a small disk")
    yield path
    subprocess.run(["umount", "-l", path], check=True)


def fill(disk: Path) -> Path:
    filler = disk / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1024))
    assert os.statvfs(disk).f_bfree == 0
    return filler


def everything(path: Path) -> set[Path]:
    return {p for p in path.rglob("*") if p.name != "filler"}


def test_a_full_disk_is_reported_and_leaves_nothing_behind(small_disk: Path) -> None:
    store = small_disk / "store"
    with Holder(store, beat=0.05) as me:
        ledger = Ledger(store, me)
        claim = ledger.claim(KEY)
        assert claim is not None
        before, filler = everything(small_disk), fill(small_disk)
        with pytest.raises(
            OutputError, match=r"\.jsonl(\.gz)?: No space left on device\n  Free space .* command continues"
        ):
            ledger.commit(claim, DONE)
        with pytest.raises(OutputError, match=r"00000002\.json: No space left"):
            ledger.claim(OTHER)
        assert {path for path in everything(small_disk) - before if path.stat().st_size} == set()
        beat = me.heartbeat.read_bytes()
        deadline = time.monotonic() + 20
        while me.heartbeat.read_bytes() == beat:  # others still see that we live
            assert time.monotonic() < deadline
            time.sleep(0.01)
        filler.unlink()
        assert ledger.commit(claim, DONE)
        assert ledger.claim(OTHER) is not None
    assert Ledger(store, Holder(store)).record(KEY) == DONE


def test_a_store_cannot_begin_on_a_full_disk(small_disk: Path) -> None:
    filler = fill(small_disk)
    with pytest.raises(OutputError, match="No space left"), Holder(small_disk / "store"):
        pass
    assert not [path for path in everything(small_disk) if path.is_file()]
    filler.unlink()
    with Holder(small_disk / "store"):
        pass


def test_a_store_that_may_only_be_read_can_be_read(small_disk: Path) -> None:
    store = small_disk / "store"
    with Holder(store) as me:
        ledger = Ledger(store, me)
        for key in (KEY, OTHER):
            claim = ledger.claim(key)
            assert claim is not None
            ledger.commit(claim, DONE)
        ledger.close()
        line = lines(store)[1]
        shard_of(store).write_bytes(lines(store)[0] + line.replace(b"0.1", b"0.2"))
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    reader = Ledger(store, Holder(store))
    assert dict(reader.records([KEY, OTHER])) == {KEY: DONE}
    with pytest.raises(OutputError, match=r"Read-only file system\n  Make it writable, or choose another 'store'"):
        Holder(store).__enter__()


def test_a_store_that_vanishes_is_reported_and_not_made_again(ledger: Ledger, store: Path) -> None:
    claim = ledger.claim(KEY)
    assert claim is not None
    shutil.rmtree(store)
    for fails in (
        lambda: ledger.commit(claim, DONE),
        lambda: ledger.claim("cd" + 18 * "0"),
        lambda: ledger.release(claim),
    ):
        with pytest.raises(
            OutputError, match=r"No such file or directory\n  Check whether its file system is still mo"
        ):
            fails()
    assert not store.exists()


def test_a_store_below_a_file_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/store: Not a directory"), Holder(tmp_path / "file" / "store"):
        pass


def test_a_directory_with_other_things_is_not_a_store(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputError, match="holds files that are not of a store"):
        open_store(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"thesis.tex"}


@pytest.mark.parametrize("mark", ['{"format": "hpcinv store 99"}', "{}", ""])
def test_a_store_of_another_format_is_refused(tmp_path: Path, mark: str) -> None:
    (tmp_path / "store.json").write_text(mark)
    with pytest.raises(OutputError, match=r"store\.json: the format is .*, not hpcinv store 2"):
        open_store(tmp_path)

    with pytest.raises(OutputError, match=r"store\.json: the format is .*, not hpcinv store 2\n  Use the version"):
        ledger_of(tmp_path)


def test_a_store_that_is_not_there_has_only_open_cases(tmp_path: Path) -> None:
    reader = Ledger(tmp_path / "none", Holder(tmp_path / "none"))
    assert reader.states([KEY]) == {KEY: CaseState("open")}
    assert reader.record(KEY) is None
    assert not (tmp_path / "none").exists()


# File systems with manners of their own


def test_ledger_files_are_created_without_hard_links(
    ledger: Ledger, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    file = store / "ledger" / "claim"  # not of the log
    assert atomic.create(file, b"1")
    assert not atomic.create(file, b"2")
    assert not atomic.publish(file, b"3")
    assert file.read_bytes() == b"1"
    test_only_a_failed_case_is_tried_again(ledger, store)
    assert len(lines(store)) == 2


def test_without_hard_links_a_claim_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_links(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    flush, flushed = os.fsync, 0

    def full(descriptor: int) -> None:
        nonlocal flushed
        flushed += 1
        if flushed == 2:  # the first was the partial file
            raise OSError(28, "No space left on device")
        flush(descriptor)

    monkeypatch.setattr(os, "link", no_links)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        atomic.create(tmp_path / "claim", b"1")
    assert not any(tmp_path.iterdir())


def test_a_link_that_was_made_despite_an_error_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As NFS does when the server's answer is lost and the request repeated."""
    link = os.link

    def repeated(source: Path, target: Path) -> None:
        link(source, target)
        link(source, target)

    monkeypatch.setattr(os, "link", repeated)
    assert atomic.create(tmp_path / "claim", b"1")
    assert not atomic.create(tmp_path / "claim", b"2")
    assert (tmp_path / "claim").read_bytes() == b"1"


def test_any_other_error_of_a_link_is_raised_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise OSError(122, "Disk quota exceeded")

    monkeypatch.setattr(os, "link", fails)
    with pytest.raises(OutputError, match=r"Disk quota exceeded\n  Free space there"), as_output_error(tmp_path):
        atomic.publish(tmp_path / "record", b"1")
    assert not any(tmp_path.iterdir())


# What it costs


class Calls:
    """Counts the operations on files of a store that Python does; a write through a descriptor counts too."""

    def __init__(self, store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        for name in ("open", "link", "unlink", "scandir", "stat", "mkdir", "pwrite", "pread", "fsync"):
            monkeypatch.setattr(os, name, self._counting(getattr(os, name)))
        monkeypatch.setattr(io, "open", self._counting(io.open))

    def _counting(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*arguments: Any, **options: Any) -> Any:
            self.count += 1
            return function(*arguments, **options)

        return counted


def test_a_case_of_a_block_takes_three_operations(ledger: Ledger, store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [f"{number % 256:02x}{number:018x}" for number in range(300)]
    [first] = ledger.claim_all(keys[:1])
    ledger.commit(first, DONE)
    calls = Calls(store, monkeypatch)
    claims = ledger.claim_all(keys)
    assert len(claims) == 299
    assert calls.count <= 12
    calls.count = 0
    for claim in claims:
        assert ledger.commit(claim, DONE)
    assert calls.count == 3 * 299  # two lines, and a look for a successor
    calls.count = 0
    states = ledger_of(store).states(keys)
    assert sum(state.name == "finished" for state in states.values()) == 300
    assert calls.count <= 12
    assert sum(path.is_file() for path in (store / "ledger").rglob("*")) == 4
