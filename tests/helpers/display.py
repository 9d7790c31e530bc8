"""A display in memory for programs that draw in windows."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator


@contextlib.contextmanager
def display() -> Iterator[dict[str, str]]:
    """Yield the environment of programs that draw on a new display.

    ``xvfb-run`` would wait for a signal that processes of the tests may have blocked.
    """
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1400x900x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    try:
        number = server.stdout.readline().strip()
        assert number.isdigit(), f"Xvfb ended with exit code {server.poll()}"
        yield os.environ | {"DISPLAY": f":{number}"}
    finally:
        server.terminate()
        server.wait(30)
