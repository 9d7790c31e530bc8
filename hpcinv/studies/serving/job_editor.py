"""A job whose page writes chosen regions and places back into its file."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from hpcinv.base.files.atomic import write_output
from hpcinv.base.reading.door import admitted
from hpcinv.errors import HpcinvError, JobError
from hpcinv.job.job import parse
from hpcinv.job.yaml_reader import read_text, read_yaml
from hpcinv.pages.reports.job_text import place_of_entries
from hpcinv.studies.serving.http_server import HttpServer, Reply

SAVE = "save"
"""last part of the address to which the page sends entries"""
SECTIONS = ("regions", "quantities")
_LONGEST = 10_000  # characters of an entry; a rule of a region has some hundred


class JobEditor:
    """Server of the page of a job, on this machine only; each address has a token.

    Args:
        path: of the job.
        page: HTML of the job, which sends its entries to `SAVE`.
        token: first part of the path of each request.
    """

    def __init__(self, path: Path, page: bytes, port: int, token: str) -> None:
        self._path, self._page, self._token = path.resolve(), page, token
        self._lock = threading.Lock()
        self._server = HttpServer("127.0.0.1", port, self._respond)

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"{self._server.address}/{self._token}/"

    def close(self) -> None:
        """Stop listening."""
        self._server.close()

    def _respond(self, method: str, path: str, body: bytes | None, _is_there: Callable[[], bool]) -> Reply:
        if (method, path) == ("GET", f"/{self._token}/"):
            return Reply(200, self._page, "text/html; charset=utf-8")
        if (method, path) != ("POST", f"/{self._token}/{SAVE}"):
            return _answer(404, "the address lacks the token that 'hpcinv show --edit' printed")
        try:
            entries = _entries(body)
            with self._lock:
                self._write(entries)
        except HpcinvError as error:
            return _answer(400, str(error))
        return _answer(200, f"written into {self._path.name}")

    def _write(self, entries: Sequence[tuple[str, str]]) -> None:
        """Write entries into the file as it is now.

        Raises:
            JobError: the job would not be valid, or would change elsewhere; the file is unchanged.
            OutputError: the file cannot be written.
        """
        expected = dict(read_yaml(self._path))
        text = admitted(self._path).read_bytes().decode()
        newline = "\r\n" if "\r\n" in text else "\n"
        text = text.replace("\r\n", "\n")
        for section in SECTIONS:
            if added := [entry for name, entry in entries if name == section]:
                text = place_of_entries(text, section).with_entries(added)
                expected[section] = _joined(section, added, expected.get(section))
        written = read_text(text, str(self._path))
        if written != expected:
            raise JobError(f"{self._path.name}: has a form into which nothing can be written: paste the line yourself")
        parse(written, self._path)
        write_output(self._path, text.replace("\n", newline).encode())


def _joined(section: str, added: Sequence[str], old: Any) -> Any:
    """Return the content of a section with entries before it.

    Raises:
        JobError: an entry is not valid by itself, or its name is taken.
    """
    values = [read_text(f"{{{entry}}}" if section == "regions" else entry, f"{section}: {entry}") for entry in added]
    if not all(isinstance(value, Mapping) and value for value in values):
        raise JobError(f"{section}: an entry must have a name")
    return [*values, *(old or [])] if section == "quantities" else _with_regions(values, old or {})


def _with_regions(added: Sequence[Mapping[str, Any]], kept: Mapping[str, Any]) -> dict[str, Any]:
    """Return regions with others before them; raise ``JobError`` if a name is taken."""
    regions = dict[str, Any]()
    for name, rule in chain(*(value.items() for value in added)):
        if name in kept or name in regions:
            raise JobError(f"regions: there is a region '{name}': choose another name")
        regions[name] = rule
    return {**regions, **kept}


def _entries(body: bytes | None) -> list[tuple[str, str]]:
    """Return sections and texts of the entries in a request.

    Raises:
        JobError: the request is not valid.
    """
    try:
        data = json.loads(body or b"")
        entries = [(str(section), str(text)) for section, text in data["entries"]]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise JobError('the request is not JSON of the form {"entries": [[section, text]]}') from None
    for section, text in entries:
        if section not in SECTIONS or not text.isprintable() or len(text) > _LONGEST:
            raise JobError(f"an entry must be one line of {' or '.join(SECTIONS)}")
    if not entries:
        raise JobError("there is nothing to write")
    return entries


def _answer(code: int, message: str) -> Reply:
    return Reply(code, json.dumps({"message": message}).encode())
