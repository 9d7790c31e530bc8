"""Modules that are imported when something of them is first used: jobs know all formats without NumPy."""

import importlib
from typing import Any


class Later:
    """A module by its name, which is imported where an attribute of it is first asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(importlib.import_module(self._name), attribute)
