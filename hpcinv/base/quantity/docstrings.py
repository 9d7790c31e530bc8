"""Docstrings of the fields of a class, read from its source on demand.

Pydantic would read them whenever a class is defined (``use_attribute_docstrings``): that was two fifths of the file
system calls at start-up, on every rank.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from typing import Any


@cache
def meanings(kind: type) -> Mapping[str, str]:
    """Docstrings of the fields by name, also of base classes; empty if the source is not available.

    Class variables, which a job cannot have, are left out.
    """
    inherited = {name: text for base in reversed(kind.__bases__) for name, text in meanings(base).items()}
    return inherited if kind.__module__ in _LIBRARIES else inherited | dict(_own(kind))


def describe(schema: dict[str, Any], kind: type) -> None:
    """Add the docstrings of the fields to the JSON schema of a class, where there is no description yet."""
    for key, text in meanings(kind).items():
        if key in schema.get("properties", {}):
            schema["properties"][key].setdefault("description", text)


_LIBRARIES = ("builtins", "abc", "pydantic.main")


def _own(kind: type) -> Iterator[tuple[str, str]]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    except (OSError, TypeError):
        return
    assert isinstance(tree, ast.ClassDef)
    for field, following in pairwise(tree.body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            if "ClassVar" in ast.unparse(field.annotation):
                continue
            match following:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    yield field.target.id, inspect.cleandoc(text)
