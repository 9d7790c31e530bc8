"""Packages that only images need, as not every installation has them."""

import importlib
from typing import Any

from hpcinv.base.reading.fault import IMAGING
from hpcinv.errors import SystemPartMissing


def package(name: str, use: str) -> Any:
    """Import a package; raise ``SystemPartMissing`` with its ``use`` if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise SystemPartMissing(f"{use}, which is not installed", IMAGING) from None
