"""Shards of records: each process that finishes cases appends to two files of its own, which all others only read.

- ``ledger/records/TOKEN.jsonl``: a line for each record, JSON with a digest: key, round, claim, the numbers that tables
  show, and the place of the whole record in the other file.
- ``ledger/records/TOKEN.jsonl.gz``: the whole records, each a line in a member of its own of a gzip file.

No file is ever locked, and nothing is written in place. A record is there once its line in the first file is whole: the
second file is written before. A process that is killed, or whose disk is full, leaves an incomplete last line, which
readers leave out and which the next line of the same process overwrites. Writes are synchronous, so that a finished
case survives a power failure.
"""

import gzip
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from pydantic_core import from_json

from hpcinv.base.files.atomic import flush_directory
from hpcinv.studies.batch.ledger.case_record import (
    CaseRecord,
    OtherVersionError,
    is_sealed,
    refusing_other_versions,
    sealed,
    unsealed,
)
from hpcinv.studies.batch.ledger.store import as_output_error

_NAME, _BRIEFS, _WHOLE = "case", ".jsonl", ".jsonl.gz"
_CHUNK = 1 << 22  # bytes read at once
_WRITE_THROUGH = getattr(os, "O_DSYNC", os.O_SYNC)


class Place(NamedTuple):
    """Place of a record: round and claim, its process, and the bytes of its line."""

    round: int
    claim: int
    token: str
    start: int
    length: int


class Line(NamedTuple):
    """A line of a shard, and whether it is as it was written."""

    place: Place
    key: str
    is_whole: bool


class Shard:
    """Shard of this process; its files are made with the first record.

    Raises:
        OSError: from `add`, if the files cannot be written; what they held before is unchanged.
    """

    def __init__(self, directory: Path, token: str) -> None:
        self._briefs = _Appended(directory / f"{token}{_BRIEFS}")
        self._whole = _Appended(directory / f"{token}{_WHOLE}")
        self._token = token

    def add(self, key: str, number: int, claim: int, record: CaseRecord) -> Place:
        """Append the record of a claim of a round of a case; return its place."""
        whole = gzip.compress(record.encoded(), 1, mtime=0)
        at = [self._whole.append(whole), len(whole)]
        data = {"key": key, "round": number, "claim": claim, "at": at, "brief": record.brief().as_json()}
        line = sealed(_NAME, data)
        place = Place(number, claim, self._token, self._briefs.append(line), len(line))
        self._briefs.check()
        return place

    def close(self) -> None:
        self._briefs.close()
        self._whole.close()


@dataclass
class _Appended:
    """File that one process appends to; a write that failed is overwritten by the next one."""

    path: Path
    end: int = 0
    descriptor: int | None = None

    def append(self, content: bytes) -> int:
        """Append to the file, and return where; durable."""
        with as_output_error(self.path):
            if self.descriptor is None:
                made = 0 if self.end else os.O_CREAT | os.O_EXCL
                self.descriptor = os.open(self.path, os.O_WRONLY | _WRITE_THROUGH | made, 0o666)
                flush_directory(self.path.parent)
            written = 0
            while written < len(content):
                written += os.pwrite(self.descriptor, content[written:], self.end + written)
            start = self.end
            self.end += len(content)
            return start

    def check(self) -> None:
        """Raise ``OutputError`` if the file was removed since it was opened."""
        with as_output_error(self.path):
            if self.descriptor is not None and os.fstat(self.descriptor).st_nlink == 0:
                self.path.stat()

    def close(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None


class Shards:
    """Shards of all processes, as one process has read them."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._ends: dict[str, int] = {}  # of what has been read

    def tokens(self) -> list[str]:
        with as_output_error(self.directory):
            try:
                names = [entry.name for entry in os.scandir(self.directory)]
            except (FileNotFoundError, NotADirectoryError):
                return []
        return sorted(name.removesuffix(_BRIEFS) for name in names if name.endswith(_BRIEFS))

    def new_lines(self, token: str) -> Iterator[Line]:
        """Yield the lines that a process has completed since the last call; the last one again if it is damaged.

        Another machine may see the end of a line before its beginning.
        """
        path = self.path(token)
        with as_output_error(path):
            try:
                file = path.open("rb", buffering=0)
            except (FileNotFoundError, NotADirectoryError):
                return
            with file:
                file.seek(start := self._ends.get(token, 0))
                rest = b""
                while chunk := file.read(_CHUNK):
                    *lines, rest = (rest + chunk).split(b"\n")
                    for content in lines:
                        yield (line := _line(token, start, content + b"\n"))
                        start += len(content) + 1
                        if line.is_whole:
                            self._ends[token] = start

    def briefs(self, places: Mapping[str, Place]) -> Iterator[tuple[str, CaseRecord]]:
        """Yield key and brief record of whole lines, each file read once from its first line to its last one."""
        ordered = sorted(places.items(), key=lambda entry: entry[1][2:])
        for token, group in groupby(ordered, lambda entry: entry[1].token):
            path = self.path(token)
            with as_output_error(path), refusing_other_versions(path), path.open("rb", buffering=0) as file:
                begin, content = 0, b""
                for key, place in group:
                    if place.start + place.length > begin + len(content):
                        begin, content = place.start, os.pread(file.fileno(), _CHUNK + place.length, place.start)
                    line = content[place.start - begin : place.start - begin + place.length]
                    yield key, CaseRecord.from_json(from_json(line)[_NAME]["brief"])

    def whole(self, place: Place) -> CaseRecord:
        """Return the whole record at a place.

        Raises:
            ValueError: it is damaged.
            OtherVersionError: it is whole, but cannot be read here.
        """
        with as_output_error(path := self.path(place.token)), path.open("rb", buffering=0) as file:
            start, length = unsealed(_NAME, os.pread(file.fileno(), place.length, place.start))["at"]
        path = self.directory / f"{place.token}{_WHOLE}"
        with as_output_error(path):
            try:
                with path.open("rb", buffering=0) as file:
                    content = os.pread(file.fileno(), length, start)
            except FileNotFoundError:
                raise ValueError(f"{path} is missing") from None
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError("the digest does not match") from error
        return CaseRecord.decoded(content)

    def path(self, token: str) -> Path:
        return self.directory / f"{token}{_BRIEFS}"


_HEAD = re.compile(rb'\{"case": \{"key": "(\w+)", "round": (\d+), "claim": (\d+), ')


def _line(token: str, start: int, content: bytes) -> Line:
    """Return a line; if it is damaged, with key, round and claim as far as they can be read, else without a key.

    Raises:
        OtherVersionError: it is whole, but was written by a version whose lines cannot be read here.
    """
    head, is_whole = _HEAD.match(content), is_sealed(_NAME, content)
    if head is None:
        if is_whole:
            raise OtherVersionError("it has no 'key', 'round', 'claim'")
        return Line(Place(0, 0, token, start, len(content)), "", is_whole)
    key, number, claim = head.groups()
    return Line(Place(int(number), int(claim), token, start, len(content)), key.decode(), is_whole)
