"""Searches for cyclic garbage around imports."""

import subprocess
import sys

CODE = """
import gc
from hpcinv.parallel.garbage import imports_spared, paused

before = gc.get_freeze_count()
with imports_spared():
    assert not gc.isenabled()
    import colorsys
spared = gc.get_freeze_count()
assert gc.isenabled() and spared > before + 1000
with imports_spared():
    pass
assert gc.get_freeze_count() <= spared, "nothing was imported, and there may be garbage of a run"
gc.disable()
with paused():
    pass
assert not gc.isenabled()
"""


def test_imported_modules_are_not_searched() -> None:
    """In a process of its own, since they are not searched again until its end."""
    subprocess.run([sys.executable, "-c", CODE], check=True)
