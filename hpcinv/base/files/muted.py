"""Standard output of libraries in C."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


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
