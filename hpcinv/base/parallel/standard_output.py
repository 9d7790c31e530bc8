"""Standard output that raises ``OutputError`` where it cannot be written, as to a full disk, and can be muted."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.errors import OutputError


class _ExplainedOutput(io.TextIOWrapper):
    """Text whose writes and flushes may raise ``OutputError``; ``BrokenPipeError`` stays."""

    def write(self, text: str) -> int:
        with _explained():
            return super().write(text)

    def flush(self) -> None:
        with _explained():
            super().flush()


@contextmanager
def _explained() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"standard output: cannot be written: {error.strerror or error}") from None


def explain_output() -> None:
    """Let this process's standard output raise ``OutputError``, and escape what its encoding lacks.

    What other programs have put there, such as pytest, stays.
    """
    output = sys.stdout
    if isinstance(output, io.TextIOWrapper):
        output.reconfigure(errors="backslashreplace")  # a file name may be no text
    if type(output) is not io.TextIOWrapper or output is not sys.__stdout__:
        return
    encoding, buffered, through = output.encoding, output.line_buffering, output.write_through
    explained = _ExplainedOutput(output.detach(), encoding, "backslashreplace", None, buffered, through)
    sys.stdout = sys.__stdout__ = explained  # type: ignore[misc]


@contextmanager
def muted_output() -> Iterator[None]:
    """Context that discards the standard output of this process, also of libraries in C."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
