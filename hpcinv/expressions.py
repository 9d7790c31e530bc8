"""Formulas in job files, such as ``x < 1e-6 m`` or ``-k*y``: parsed and checked once, never executed as code."""

from __future__ import annotations

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from typing import TYPE_CHECKING, Any

from pydantic_core import core_schema

from hpcinv.functions import CONSTANTS, FUNCTIONS, numpy_functions
from hpcinv.measures import RELATIONS, Condition, Measure
from hpcinv.spelling import did_you_mean
from hpcinv.units import Dimension, as_float, parse_quantity

if TYPE_CHECKING:
    import numpy as np
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue

    from hpcinv.schema import Location

_LONGEST = 1000  # characters; keeps the parser's recursion shallow
_DEEPEST = 200  # operations inside each other: what evaluates a formula calls itself for each
_NUMBER_AND_UNIT = re.compile(
    r"(?<![\w.])((?>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?))\s*"
    r"((?!(?:and|or|not)\b)[^\W\d_]\w*|%|°)(?!\w*\s*\()(\s*(?:\^|\*\*))?"
)
_ARITHMETIC: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_LOGIC: dict[type[ast.AST], str] = {
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Gt: "greater",
    ast.GtE: "greater_equal",
    ast.And: "logical_and",
    ast.Or: "logical_or",
    ast.Not: "logical_not",
}


@dataclass(frozen=True)
class Expression:
    """A formula of numbers, units, named variables and the functions in ``FUNCTIONS``; equal if the text is.

    A number may carry one unit (``4.25 mm``); without one it is SI. Conditions are built with ``< <= > >= and or not``.

    Raises:
        ValueError: the text is no formula; the message says why.
    """

    source: str

    def __post_init__(self) -> None:
        _parse(self.source)

    def __str__(self) -> str:
        return self.source

    @property
    def names(self) -> frozenset[str]:
        """The variables that need a value."""
        tree, literals = _parse(self.source)
        called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}
        return frozenset(names - literals.keys() - CONSTANTS.keys())

    def check(self, known: dict[str, Dimension | None]) -> Dimension | bool | None:
        """Dimension of the value, True for a condition, None where a plain number leaves it open.

        Args:
            known: variables and their dimension, None for one that may have any.

        Raises:
            ValueError: another variable occurs, or quantities of different dimension are added or compared.
        """
        for name in sorted(self.names - known.keys()):
            raise ValueError(f"unknown name '{name}' in '{self}'.{did_you_mean(name, known)}")
        tree, literals = _parse(self.source)
        measures = {name: Measure(d) for name, d in (known | dict.fromkeys(CONSTANTS)).items()}
        measures |= {name: Measure(dimension) for name, (_, dimension) in literals.items()}
        functions = {name: f.measure for name, f in FUNCTIONS.items()} | RELATIONS
        try:
            value = _walk(tree, measures, functions, lambda number: Measure(None, number))
        except TypeError:  # a condition where a number belongs, or the other way round
            raise ValueError(f"'{self}' mixes up conditions and numbers") from None
        except ValueError as error:
            raise ValueError(f"'{self}' {error}") from None
        return True if isinstance(value, Condition) else value.dimension

    def expect(self, known: dict[str, Dimension | None], wanted: Dimension | bool | None) -> None:
        """Raise ``ValueError`` unless the value is as ``wanted``, in the terms of `check`; None takes any number."""
        found = self.check(known)
        is_open = found is None or wanted is None
        if found != wanted and (not is_open or True in (found, wanted)):
            example = ", such as x < 1 mm" if wanted is True else ""
            raise ValueError(f"must be {_kind(wanted)}{example}, but '{self}' is {_kind(found)}")

    def apply(
        self,
        values: Mapping[str, Any],
        functions: Mapping[str, Callable[..., Any]],
        number: Callable[[float], Any] = float,
    ) -> Any:
        """Value of the formula in any algebra.

        Args:
            values: of the variables.
            functions: those of ``FUNCTIONS`` by name, and the relations by their NumPy names, such as ``less``.
            number: makes a number of that algebra.
        """
        tree, literals = _parse(self.source)
        constants = CONSTANTS | {name: si for name, (si, _) in literals.items()}
        return _walk(tree, {**{name: number(c) for name, c in constants.items()}, **values}, functions, number)

    def evaluate(self, **values: np.ndarray | float) -> np.ndarray:
        """Value at many points at once, shaped as ``values`` broadcast together: floats, or bools for a condition.

        Where the formula has no finite value it gives NaN or infinity: that one rank meets one must not stop it alone.
        """
        import numpy as np

        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        shape = np.broadcast_shapes(*(a.shape for a in arrays.values()))
        with np.errstate(all="ignore"):
            return np.broadcast_to(np.asarray(self.apply(arrays, numpy_functions(), np.float64)), shape)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(
            cls._from_job, serialization=core_schema.plain_serializer_function_ser_schema(str)
        )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": ["string", "number"]}

    @classmethod
    def _from_job(cls, value: object) -> Expression:
        if isinstance(value, cls):
            return value
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"must be a formula or a number, not {value}")
        return cls(str(value))


def faults(
    formulas: Iterable[tuple[Location, Expression]], known: dict[str, Dimension | None], wanted: Dimension | bool | None
) -> Iterator[tuple[Location, str]]:
    """Place and reason of each formula that is not as `Expression.expect` wants it."""
    for where, formula in formulas:
        try:
            formula.expect(known, wanted)
        except ValueError as error:
            yield where, str(error)


def faults_with_constants(
    field: str,
    formulas: Iterable[Expression | None],
    constants: Iterable[str],
    known: dict[str, Dimension | None],
    wanted: Dimension | None,
) -> list[tuple[Location, str]]:
    """As `faults`, of the entries of a list ``field`` that may use the names in a field ``constants``."""
    taken = sorted({*known, *CONSTANTS} & set(constants))
    if taken:
        return [(("constants", name), "is already the name of something else") for name in taken]
    entries = (((field, i), f) for i, f in enumerate(formulas) if f is not None)
    return list(faults(entries, known | dict.fromkeys(constants), wanted))


@cache
def _parse(source: str) -> tuple[ast.expr, dict[str, tuple[float, Dimension]]]:
    """Syntax tree, and value and dimension of the numbers with units in it, which it holds as names."""
    if len(source) > _LONGEST:
        raise ValueError(f"a formula may have {_LONGEST} characters, not {len(source)}")
    literals: dict[str, tuple[float, Dimension]] = {}

    def take_out(match: re.Match[str]) -> str:
        number, unit, power = match.groups()
        if power:
            raise ValueError(f"'{match[0].strip()}…' is ambiguous in '{source}': write ({number} {unit})**…")
        name = f"_{len(literals)}"
        try:
            literals[name] = parse_quantity(f"{number} {unit}")
        except ValueError as error:
            raise ValueError(f"in '{source}': {error} A product is written {number}*{unit}.") from None
        return f"({name})"

    text = _NUMBER_AND_UNIT.sub(take_out, source).replace("^", "**").strip()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # such as 1and 2
            tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"'{source}' is not a formula") from None
    if _depth(tree) > _DEEPEST:
        raise ValueError(f"'{source}' has more than {_DEEPEST} operations inside each other; write it in parts")
    for node in ast.walk(tree):
        _refuse_unless_known(node, source, literals)
    return tree, literals


def _depth(tree: ast.expr) -> int:
    """Levels of a syntax tree, found without recursion."""
    depth, level = 0, [tree]
    while level:
        level = [inner for node in level for inner in ast.iter_child_nodes(node) if isinstance(inner, ast.expr)]
        depth += 1
    return depth


def _kind(found: Dimension | bool | None) -> str:
    return "a condition" if found is True else "a number" if found is None else str(found)


def _refuse_unless_known(node: ast.AST, source: str, literals: Mapping[str, Any]) -> None:
    match node:
        case ast.Constant(value=bool() | str() | bytes() | complex() | None):
            raise ValueError(f"'{source}' may hold numbers, not {node.value!r}")
        case ast.Constant(value=int() | float() as number) if not math.isfinite(as_float(number)):
            raise ValueError(f"'{source}' holds a number that is too large")
        case ast.Name(id=name) if name.startswith("_") and name not in literals:
            raise ValueError(f"unknown name '{name}' in '{source}'; names begin with a letter")
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                raise ValueError(f"unknown function '{name}' in '{source}'.{did_you_mean(name, FUNCTIONS)}")
            wanted = FUNCTIONS[name].arguments
            if len(arguments) != wanted if wanted else len(arguments) < 2:
                raise ValueError(
                    f"{name}() takes {wanted or 'two or more'} values, not {len(arguments)}, in '{source}'"
                )
        case ast.Constant() | ast.Name() | ast.Compare() | ast.BoolOp() | ast.BinOp() | ast.UnaryOp() | ast.Load():
            pass
        case _ if type(node) not in _ARITHMETIC and type(node) not in _LOGIC:
            sign = "; write <= or >= with a tolerance for ==" if isinstance(node, ast.Eq | ast.NotEq) else ""
            raise ValueError(f"'{source}' holds more than numbers, names, + - * / **, < > and functions{sign}")


def _walk(
    node: ast.AST,
    values: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    number: Callable[[float], Any],
) -> Any:
    def value(inner: ast.AST) -> Any:
        return _walk(inner, values, functions, number)

    match node:
        case ast.Constant(value=constant):
            return number(float(constant))  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name]
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return functions[name](*map(value, arguments))
        case ast.BinOp(left=left, op=op, right=right):
            return _ARITHMETIC[type(op)](value(left), value(right))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return functions["logical_not"](value(operand))
        case ast.UnaryOp(op=op, operand=operand):
            return _ARITHMETIC[type(op)](value(operand))
        case ast.BoolOp(op=op, values=operands):
            return reduce(functions[_LOGIC[type(op)]], map(value, operands))
        case ast.Compare(left=left, ops=ops, comparators=right):
            terms = [value(left), *map(value, right)]
            pairs = zip(ops, terms, terms[1:], strict=False)
            return reduce(functions["logical_and"], (functions[_LOGIC[type(op)]](a, b) for op, a, b in pairs))
    raise AssertionError(f"{ast.dump(node)} should have been refused")
