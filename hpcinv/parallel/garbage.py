"""Python's search for cyclic garbage, from which imported modules are spared.

It is triggered by the number of new objects, and looks at all of them again and again while modules are imported:
0.08 s of a start, and 0.03 s each time it happens in a run.
"""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused() -> Iterator[None]:
    """Context without searches."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@contextmanager
def imports_spared() -> Iterator[None]:
    """Context of imports, without searches; what there is at its end, if something was imported, is never searched.

    Garbage that was there before is never freed: the context is for imports at the start of a process.
    """
    before = len(sys.modules)
    with paused():
        yield
        if len(sys.modules) > before:
            gc.freeze()
