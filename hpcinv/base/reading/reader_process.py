"""The process that reads a file from others: its command, and what it found, by its output and how it ended."""

import re
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hpcinv.base.reading.fault import shown

_COMPLAINT = re.compile(r"ERR\|\s*(?:\w+ \(0x[0-9a-f]+\): )?(.*?)\s*(?:\x1b\[0m)?$", re.MULTILINE)
_LONGEST = 400
"""characters of a message of VTK; raised, a damaged file may fill the screen"""

_PROGRAM = Path(__file__).with_name("isolated_reader.py")


def reader_command(action: str, path: Path, memory: int, seconds: int) -> list[str]:
    """Return the command that reads a file in a process of its own, within bytes of memory and processor time (s)."""
    return [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute()), str(memory), str(seconds)]


def fault_found(
    head: Mapping[str, Any], code: int, errors: bytes, failure: str, advice: str
) -> tuple[str, str, bool] | None:
    """Return text and advice on a fault, and whether a package is missing; ``None`` if the file was read.

    Args:
        head: first line of the output; empty if there is none.
        code: exit code of the process.
        errors: what it has printed on standard error.
        failure: text for a file that the process does not survive.
        advice: remedy for such a file.
    """
    complaints = [match[1] for match in _COMPLAINT.finditer(errors.decode(errors="replace"))]
    if "fault" in head and not complaints:
        text, remedy, is_missing = head["fault"]
        return text, remedy, is_missing
    if code or complaints or not head:
        reason = shown(complaints[0], _LONGEST) if complaints else ending(code)
        return f"{failure}: {reason}", advice, False
    return None


def ending(code: int) -> str:
    """Return how a process ended without an answer."""
    if code == -signal.SIGXCPU:
        return "that takes too long"
    if code == -signal.SIGKILL:
        return "that takes too long, or was ended by the system"
    return f"it crashed ({signal.Signals(-code).name})" if code < 0 else f"it ended with exit code {code}"
