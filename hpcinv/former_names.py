"""Former names of packages that laws, effects, mesh generators and batch scripts of users import."""

import importlib
import sys
from collections.abc import Sequence
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

_MOVED = {
    "batch": "studies.batch",
    "effects": "physics.effects",
    "kinematics": "physics.kinematics",
    "materials": "physics.materials",
    "quantity": "base.quantity",
    "sweep": "studies.sweep",
}


class _Loader(Loader):
    def __init__(self, name: str) -> None:
        self._name = name
        self._spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # Python has replaced it

    def get_code(self, name: str) -> CodeType | None:
        """Return the code of a module that is run as a program by ``python -m``."""
        spec = find_spec(self._name)
        loader: Any = spec and spec.loader
        code: CodeType | None = loader.get_code(self._name)
        return code


class _Finder:
    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        top, _, rest = name.partition(".")
        package, dot, module = rest.partition(".")
        if top != "hpcinv" or package not in _MOVED:
            return None
        present = f"hpcinv.{_MOVED[package]}{dot}{module}"
        if (spec := find_spec(present)) is None:
            return None
        found = ModuleSpec(
            name, _Loader(present), origin=spec.origin, is_package=spec.submodule_search_locations is not None
        )
        found.has_location = True
        return found


def find_former_names() -> None:
    """Let imports find the packages by their former names, as the same modules."""
    sys.meta_path.insert(0, _Finder())  # before the finder that would load them a second time
