"""What a mesh generator lets a job choose, read from its text; nothing is executed."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hpcinv.quantities import QUANTITIES
from hpcinv.schema import Location, shown
from hpcinv.spelling import did_you_mean

type Value = float | int | bool | str


@dataclass(frozen=True)
class Parameter:
    """``read`` checks a value and converts it to SI, or raises ``ValueError``."""

    read: Callable[[object], Value]
    required: bool


def _expect[V: Value](kind: type[V], name: str) -> Callable[[object], V]:
    def read(value: object) -> V:
        if type(value) is not kind:  # True is an int, but no number
            raise ValueError(f"must be {name}, not {shown(value)}")
        return value

    return read


_READERS: Mapping[str, Callable[[object], Value]] = {
    **{name: quantity.parse for name, quantity in QUANTITIES.items()},
    "float": QUANTITIES["AnyQuantity"].parse,
    "int": _expect(int, "a whole number"),
    "bool": _expect(bool, "true or false"),
    "str": _expect(str, "text"),
}
"""Readers by the annotation of a parameter."""


def read_parameters(path: Path, given: Mapping[str, object]) -> tuple[dict[str, Value], list[tuple[Location, str]]]:
    """Parameters for the generator at ``path`` in SI, and what is wrong with those that were given.

    Raises:
        ValueError: the file is no generator, or not a valid one.
    """
    values: dict[str, Value] = {}
    problems: list[tuple[Location, str]] = []
    known = parameters_of(path)
    for name, value in given.items():
        if name not in known:
            problems.append(((name,), f"{path.name} has no such parameter.{did_you_mean(name, known)}"))
            continue
        try:
            values[name] = known[name].read(value)
        except ValueError as error:
            problems.append(((name,), str(error)))
    problems += [((n,), f"is needed by {path.name}") for n, p in known.items() if p.required and n not in given]
    return values, problems


def is_generator(path: Path) -> bool:
    return path.suffix in _FORMATS


def parameters_of(path: Path) -> dict[str, Parameter]:
    """Parameters of ``build()`` in a Python generator, or of ``DefineConstant`` in a gmsh script."""
    try:
        return _FORMATS[path.suffix](path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ValueError(f"{path.name} is not a text file in UTF-8") from None
    except SyntaxError as error:
        raise ValueError(f"{path.name}, line {error.lineno}: {error.msg}") from None


def _of_python(text: str) -> dict[str, Parameter]:
    functions = [n for n in ast.parse(text).body if isinstance(n, ast.FunctionDef) and n.name == "build"]
    if not functions:
        raise ValueError("a mesh generator must define build(gmsh, *, …), which this file does not")
    arguments = functions[-1].args
    positional = [*arguments.posonlyargs, *arguments.args]
    if not positional:
        raise ValueError("build() of a mesh generator must take gmsh as its first argument")
    bare = len(positional) - len(arguments.defaults)
    required = {a.arg: i < bare for i, a in enumerate(positional)}
    required |= {a.arg: d is None for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)}
    return {a.arg: Parameter(_reader(a), required[a.arg]) for a in (*positional[1:], *arguments.kwonlyargs)}


def _reader(argument: ast.arg) -> Callable[[object], Value]:
    match argument.annotation:
        case None:
            return _READERS["float"]
        case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)) if name in _READERS:
            return _READERS[name]
    kind = ast.unparse(argument.annotation)
    raise ValueError(f"'{argument.arg}' of build() is a {kind}; a job can give {', '.join(_READERS)}")


def _of_geo(text: str) -> dict[str, Parameter]:
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", re.sub(r'"[^"\n]*"', '""', text), flags=re.DOTALL)
    blocks = re.findall(r"DefineConstant\s*\[(.*?)\]\s*;", text, flags=re.DOTALL)
    names = (name for block in blocks for name in re.findall(r"(\w+)\s*(?:=|,|$)", re.sub(r"\{.*?\}", "0", block)))
    return {name: Parameter(_READERS["float"], required=False) for name in names if not name[0].isdigit()}


_FORMATS = {".py": _of_python, ".geo": _of_geo}
