"""Parameters of mesh generators, read from the text of the generator without executing it."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from hpcinv.base.quantity.constants import constant, is_pure
from hpcinv.base.quantity.quantity import QUANTITIES
from hpcinv.base.quantity.schema import KeyPath, collected, shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension
from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.suffix import suffix_of

type ParameterValue = float | int | bool | str

MOST_DIVISIONS = 1_000_000
"""cells along one edge; more would be a mistake, and numbers beyond the integers of gmsh end it with a traceback"""
_LARGEST = 2**31 - 1  # of the integers of gmsh


@dataclass(frozen=True)
class GeneratorParameter:
    """A parameter of a mesh generator.

    Attributes:
        kind: its annotation, or empty.
        default: value of the default if that is a literal, otherwise ``None``.
    """

    kind: str
    required: bool
    default: ParameterValue | None = None

    def read(self, value: object) -> ParameterValue:
        """The value, checked and converted to SI; raises ``ValueError`` if it is invalid."""
        return _READERS[self.kind or "float"](value)

    def check_dimension(self, name: str, value: object, unit: float) -> None:
        """Raise ``ValueError`` for a value with a dimension if the generator does not define its unit.

        Without an annotation the unit is unknown; with one of any dimension it is SI, which is not valid for a
        generator that works in another length ``unit`` (m).
        """
        if self.kind not in _OF_ANY_DIMENSION or (self.kind and unit == 1.0) or not isinstance(value, str):
            return
        dimension = constant(value)[1]
        if is_pure(dimension):
            return
        fitting = [kind for kind, quantity in QUANTITIES.items() if quantity.dimension == dimension and kind != "Size"]
        kinds = " or ".join([*fitting, *(["Size"] if "Length" in fitting else [])])
        remedy = f"annotate it there ({name}: {kinds}), or " if kinds else ""
        raise ValueError(
            f"is given as '{value}', but build() does not define that {name} is {dimension}, nor its unit;"
            f" {remedy}give a plain number, which is passed unchanged"
        )


def _expect[V: ParameterValue](kind: type[V], name: str) -> Callable[[object], V]:
    def read(value: object) -> V:
        if type(value) is not kind:  # True is an int in Python, but not here
            raise ValueError(f"must be {name}, not {shown(value)}")
        return value

    return read


def _whole(value: object) -> int:
    if isinstance(value, str):
        number, dimension = constant(value)
        value = int(number) if is_pure(dimension) and number.is_integer() else value
    return _expect(int, "a whole number")(value)


def _int_of_gmsh(value: object) -> int:
    number = _whole(value)
    if abs(number) > _LARGEST:
        raise ValueError(f"must be at most {_LARGEST:,}, not {number:,}")
    return number


def _divisions(value: object) -> int:
    number = _whole(value)
    if not 1 <= number <= MOST_DIVISIONS:
        raise ValueError(f"must be at least 1 and at most {MOST_DIVISIONS:,}, not {number:,}")
    return number


_READERS: Mapping[str, Callable[[object], ParameterValue]] = {
    **{name: quantity.parse for name, quantity in QUANTITIES.items()},
    "Divisions": _divisions,
    "float": QUANTITIES["AnyQuantity"].parse,
    "int": _int_of_gmsh,
    "bool": _expect(bool, "true or false"),
    "str": _expect(str, "text"),
}
"""Functions that check and convert a value, by the annotation of the parameter."""

_OF_ANY_DIMENSION = ("", "float", "AnyQuantity")


def read_parameters(
    path: Path, given: Mapping[str, object], unit: float = 1.0
) -> tuple[dict[str, ParameterValue], list[tuple[KeyPath, str]]]:
    """Parameters (SI) for the generator at ``path``, and faults of the ``given`` ones with their places.

    Args:
        unit: length unit (m) of the generator.

    Raises:
        ValueError: the file is not a valid generator.
    """
    values: dict[str, ParameterValue] = {}
    problems: list[tuple[KeyPath, str]] = []
    known = parameters_of(path)
    for name, value in given.items():
        with collected(problems, name):
            if name not in known:
                raise ValueError(f"{path.name} has no such parameter.{did_you_mean(name, known)}")
            known[name].check_dimension(name, value, unit if suffix_of(path) == ".py" else 1.0)
            values[name] = known[name].read(value)
    problems += [((n,), f"is needed by {path.name}") for n, p in known.items() if p.required and n not in given]
    return values, problems


def converted_parameters(path: Path, given: Mapping[str, ParameterValue], unit: float) -> dict[str, ParameterValue]:
    """Parameters for a generator that works in a length ``unit`` (m), converted from SI, with defaults of others.

    Parameters annotated as lengths, areas or volumes are converted, and rounded to 13 digits: a mesh may change
    completely with the last bit of a length, and similar bodies should have similar meshes.

    Raises:
        ValueError: the default of such a parameter is not a literal number.
    """
    values = dict(given)
    for name, parameter in parameters_of(path).items():
        dimension = QUANTITIES[parameter.kind].dimension if parameter.kind in QUANTITIES else None
        if dimension is None or dimension != Dimension(length=dimension.length) or not dimension.length:
            continue
        value = given.get(name, parameter.default)
        if not isinstance(value, float | int):
            raise ValueError(f"needs a number for {name}, whose default in {path.name} is not a number")
        values[name] = float(f"{value / unit**dimension.length:.13g}")
    return values


@dataclass(frozen=True)
class Resolution:
    """Parameters that define the cell size of a generated mesh: each ``Size`` (m) and each number of ``Divisions``."""

    sizes: Mapping[str, float]
    divisions: Mapping[str, int]

    @property
    def parameters(self) -> dict[str, float | int]:
        return {**self.sizes, **self.divisions}

    def finer(self, factor: float) -> Resolution:
        """Resolution for cells ``factor`` times smaller; numbers of divisions are rounded up."""
        return Resolution(
            {name: size / factor for name, size in self.sizes.items()},
            {name: math.ceil(number * factor - 1e-6) for name, number in self.divisions.items()},
        )


def resolution_of(path: Path, given: Mapping[str, ParameterValue]) -> Resolution:
    """Resolution of the generator at ``path`` with ``given`` parameters (SI)."""
    sizes: dict[str, dict[str, float]] = {"Size": {}, "Divisions": {}}
    for name, parameter in parameters_of(path).items():
        value = given.get(name, parameter.default)
        if parameter.kind in sizes and isinstance(value, float | int):
            sizes[parameter.kind][name] = value
    return Resolution(sizes["Size"], {name: int(number) for name, number in sizes["Divisions"].items()})


def is_generator(path: Path) -> bool:
    return suffix_of(path) in _FORMATS


def parameters_of(path: Path) -> dict[str, GeneratorParameter]:
    """Parameters of ``build()`` in a Python generator or of ``DefineConstant`` in a gmsh script, by name."""
    try:
        return _FORMATS[suffix_of(path)](admitted(path).read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ValueError(f"{path.name} is not a text file in UTF-8") from None
    except SyntaxError as error:
        raise ValueError(f"{path.name}, line {error.lineno}: {error.msg}") from None
    except (RecursionError, MemoryError):
        raise ValueError(f"{path.name}: its expressions are nested too deeply") from None
    except OSError as error:
        raise ValueError(f"{path.name}: cannot be read: {error.strerror}") from None


@cache  # many jobs use the same generator
def _python_parameters(text: str) -> dict[str, GeneratorParameter]:
    functions = [n for n in ast.parse(text).body if isinstance(n, ast.FunctionDef) and n.name == "build"]
    if not functions:
        raise ValueError("a mesh generator must define build(gmsh, *, …)")
    arguments = functions[-1].args
    positional = [*arguments.posonlyargs, *arguments.args]
    if not positional:
        raise ValueError("build() of a mesh generator must take gmsh as its first argument")
    defaults = [*[None] * (len(positional) - len(arguments.defaults)), *arguments.defaults, *arguments.kw_defaults]
    return {
        a.arg: GeneratorParameter(_kind(a), default is None, _literal(default))
        for a, default in list(zip([*positional, *arguments.kwonlyargs], defaults, strict=True))[1:]
    }


def _literal(default: ast.expr | None) -> ParameterValue | None:
    try:
        value = None if default is None else ast.literal_eval(default)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):  # a name or a call
        return None
    return value if isinstance(value, float | int | bool | str) else None


def _kind(argument: ast.arg) -> str:
    match argument.annotation:
        case None:
            return ""
        case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)) if name in _READERS:
            return name
    kind = ast.unparse(argument.annotation)
    raise ValueError(f"'{argument.arg}' of build() is a {kind}; a job can give {', '.join(_READERS)}")


@cache
def _geo_parameters(text: str) -> dict[str, GeneratorParameter]:
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", re.sub(r'"[^"\n]*"', '""', text), flags=re.DOTALL)
    blocks = re.findall(r"DefineConstant\s*\[(.*?)\]\s*;", text, flags=re.DOTALL)
    names = (name for block in blocks for name in re.findall(r"(\w+)\s*(?:=|,|$)", re.sub(r"\{.*?\}", "0", block)))
    return {name: GeneratorParameter("float", required=False) for name in names if not name[0].isdigit()}


_FORMATS = {".py": _python_parameters, ".geo": _geo_parameters}
