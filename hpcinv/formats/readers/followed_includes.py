"""Included files of decks are followed here only: in this process, or with ``--untrusted`` in a child with limits."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from hpcinv.base.parallel.children import run_child
from hpcinv.base.parallel.signals import ended_by_signals
from hpcinv.base.reading.deck_includes import FUNCTIONS
from hpcinv.base.reading.door import is_asked
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.reader_process import fault_found, reader_command

_MEMORY = 4 << 30
"""bytes that the child may take, enough for decks of 600 MB; raised, a hostile file fills the memory of the machine"""
_SECONDS = 120
"""of processor time: 1 GB of text takes less; raised, a hostile file takes longer to be refused"""
_WAITING = 5  # s on the clock for each second of processor time; on a busy machine, files are refused if lowered

_known: dict[Path, tuple[list[tuple[int, int]], list[str]]] = {}
"""times and sizes of a deck and of its included files, and the names of these"""


def followed(action: str, path: Path, *, isolated: bool | None = None) -> dict[str, Any]:
    """Return what a function of `deck_includes` finds in a deck.

    Args:
        action: one of its ``FUNCTIONS``.
        isolated: whether a child process follows the includes; by default with ``--untrusted``.

    Raises:
        Fault: the deck cannot be read, or the child does not survive it.
    """
    if is_asked() if isolated is None else isolated:
        return _followed_in_child(action, path)
    return FUNCTIONS[action](path)[0]


def included_files(action: str, path: Path, *, isolated: bool | None = None) -> list[str]:
    """Return the names of the files that a deck includes, relative to its directory; the rest as for `followed`."""
    place = path.absolute()
    if place in _known and _known[place][0] == _stamps(path, _known[place][1]):
        return _known[place][1]
    answer = followed(action, path, isolated=isolated)
    files: list[str] = answer["files"]
    if answer["is_whole"]:
        _known[place] = _stamps(path, files), files
    return files


def _stamps(path: Path, files: Sequence[str]) -> list[tuple[int, int]]:
    states = []
    for file in (path, *(path.parent / name for name in files)):
        try:
            state = file.stat()
        except OSError:
            states.append((0, 0))
        else:
            states.append((state.st_mtime_ns, state.st_size))
    return states


def _followed_in_child(action: str, path: Path) -> dict[str, Any]:
    head: dict[str, Any] = {}

    def receive(output: IO[bytes]) -> None:
        try:
            head.update(json.loads(output.readline()))
        except ValueError:  # it has crashed
            return

    command = reader_command(action, path, _MEMORY, _SECONDS)
    with ended_by_signals():
        done = run_child(command, receive=receive, seconds=_WAITING * _SECONDS)
    if fault := fault_found(head, done.returncode, done.stderr, "cannot be read", "Is the file complete?"):
        text, advice, _ = fault
        raise Fault(text, advice)
    return head
