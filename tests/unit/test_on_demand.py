"""What plugs into the core by name."""

import ast
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from hpcinv.errors import SystemPartMissing
from hpcinv.on_demand import FUNCTIONS, on_demand


@pytest.mark.parametrize("place", FUNCTIONS.values())
def test_every_function_or_class_exists(place: str) -> None:
    module, _, function = place.partition(":")
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text())
    assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def test_a_missing_package_of_the_project_is_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    class Finder:
        def find_spec(self, name: str, *_: object) -> None:
            if name.startswith(missing):
                raise ModuleNotFoundError(name, name=name)

    missing = FUNCTIONS["mesh of a vessel"].rpartition(".")[0]
    for name in [name for name in sys.modules if name.startswith(missing)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    with pytest.raises(SystemPartMissing, match=rf"mesh of a vessel needs {missing}\.\w+, which this installation"):
        on_demand("mesh of a vessel")
