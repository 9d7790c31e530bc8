"""Command of the process that reads a file from others (`hpcinv.base.reading.isolated_reader`)."""

import sys
from pathlib import Path

from hpcinv.base import reading

_PROGRAM = Path(reading.__file__).with_name("isolated_reader.py")


def reader_command(action: str, path: Path, memory: int, seconds: int) -> list[str]:
    """Return the command that reads a file in a process of its own, within bytes of memory and processor time (s)."""
    return [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute()), str(memory), str(seconds)]
