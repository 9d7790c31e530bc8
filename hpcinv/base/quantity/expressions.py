"""Formulas in job files, such as ``x < 1e-6 m`` or ``-k*y``: parsed and checked once, and never executed as code."""

from __future__ import annotations

import ast
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeGuard

from pydantic_core import core_schema

from hpcinv.base.quantity.dimensional_analysis import RELATIONS, Condition, TermDimension
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS, numpy_functions
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension, as_float, parse_quantity, parse_unit

if TYPE_CHECKING:
    import numpy as np
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo, ValidationInfo
    from pydantic.json_schema import JsonSchemaValue


LET = "let"
"""Section of a job with names for parts of its formulas, and its key in the validation context."""
_LONGEST = 20_000  # characters: fitted formulas have thousands, and the parser still takes milliseconds
_DEEPEST = 200  # nested operations: evaluation is recursive
_MANY = 32  # terms of a sum, above which they are added in pairs
_SHOWN = 200  # characters of a formula in a message
_SYMBOL = r"(?!(?:and|or|not)\b)[^\W\d_]\w*"
_NUMBER_AND_UNIT = re.compile(
    r"(?<![\w.])((?>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?))\s*"
    rf"({_SYMBOL}|%|°)(?!\w*\s*\()(\s*(?:\^|\*\*))?"
)
_FURTHER_UNIT = re.compile(
    r"(\s*[/·]\s*|\s+)((?!(?:and|or|not)\b)(?:cmH2O|[A-Za-zµμ][A-Za-zµμ_]*))(?![A-Za-z0-9_]|\s*\()"
    r"((?:\^|\*\*)-?\d+\b|⁻?[¹²³])?"
)
_SUPERSCRIPTS = str.maketrans("⁻¹²³", "-123")
_FURTHER = "_of_"  # begins the names of further units in a syntax tree
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

type KeyPath = tuple[int | str, ...]
"""keys and indices from the outside in, such as ``("effects", 0, "density")``"""


@dataclass(frozen=True)
class Expression:
    """A formula of numbers, units, named variables and the functions in ``FUNCTIONS``; compared as text.

    A number may have a unit (``4.25 mm``, ``963 kg/m^3``); without one it is SI. A variable with the name of a further
    unit (``m``) prevails. Conditions are built with ``< <= > >= and or not``.

    Args:
        definitions: names in the formula that are defined by other formulas, with these: each after the names that it
            uses. Each is evaluated once, however often it occurs.

    Raises:
        ValueError: the text is not a formula; the message is the reason.
    """

    source: str
    definitions: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        depths: dict[str, int] = {}
        for name, text in (*self.definitions, ("", self.source)):
            depths[name] = _depth(_parse(text)[0], depths)
        if depths[""] > _DEEPEST:
            raise ValueError(f"{_quoted(self.source)} has more than {_DEEPEST} nested operations; write it in parts")

    @classmethod
    def using(cls, source: str, known: Mapping[str, Expression]) -> Expression:
        """A formula that may use the names of ``known`` formulas, with their definitions."""
        definitions: dict[str, str] = {}
        for name in sorted((_names(source) | _further_units(source)) & known.keys()):
            definitions |= dict(known[name].definitions)
            definitions[name] = known[name].source
        return cls(source, tuple(definitions.items()))

    def __str__(self) -> str:
        return self.source

    @property
    def whole(self) -> str:
        """The formula with the definitions that it uses; equal texts are equal formulas."""
        given = "; ".join(f"{name} = {text}" for name, text in self.definitions)
        return f"{self.source} where {given}" if given else self.source

    @property
    def names(self) -> frozenset[str]:
        """The variables that need a value."""
        texts = (self.source, *(text for _, text in self.definitions))
        return frozenset().union(*map(_names, texts)) - {name for name, _ in self.definitions}

    @property
    def further_units(self) -> frozenset[str]:
        """Symbols of compound units, such as ``m`` in ``963 kg/m^3``, which are variables where there are such."""
        texts = (self.source, *(text for _, text in self.definitions))
        return frozenset().union(*map(_further_units, texts))

    @property
    def has_units(self) -> bool:
        return any(_parse(text)[1] for text in (self.source, *(text for _, text in self.definitions)))

    def check(self, known: dict[str, Dimension | None], plain: Dimension | None = None) -> Dimension | bool | None:
        """Dimension of the value, True for a condition, None if plain numbers leave it undetermined.

        Args:
            known: variables and their dimension, None for any dimension.
            plain: dimension of plain numbers, None for any dimension.

        Raises:
            ValueError: the formula has an unknown variable, or adds or compares quantities of different dimensions.
        """
        self._check_names(known)
        measures: dict[str, Any] = {name: TermDimension(d) for name, d in (known | dict.fromkeys(CONSTANTS)).items()}
        functions = {name: f.measure for name, f in FUNCTIONS.items()} | RELATIONS
        for name, text in (*self.definitions, ("", self.source)):
            tree, literals = _parse(text)
            place = f" ('{name}' of 'let')" if name else ""
            own = measures | {literal: TermDimension(dimension) for literal, (_, dimension) in literals.items()}
            own |= {n: measures.get(unit, own[n]) for n, unit in _further(literals)}
            _refuse_ambiguous(text, measures)
            try:
                measures[name] = _walk(tree, own, functions, lambda number: TermDimension(plain, number))
            except TypeError:  # a condition instead of a number, or the reverse
                raise ValueError(f"{_quoted(text)}{place} mixes up conditions and numbers") from None
            except ValueError as error:
                raise ValueError(f"{_quoted(text)}{place} {error}") from None
        value = measures[""]
        return True if isinstance(value, Condition) else value.dimension

    def _check_names(self, known: Mapping[str, Dimension | None]) -> None:
        defined: list[str] = []
        for name, text in (*self.definitions, ("", self.source)):
            for unknown in sorted(_names(text) - known.keys() - set(defined)):
                place = f" ('{name}' of 'let')" if name else ""
                hint = did_you_mean(unknown, (*known, *defined))
                raise ValueError(f"unknown name '{unknown}' in {_quoted(text)}{place}.{hint}")
            defined.append(name)

    def expect(self, known: dict[str, Dimension | None], wanted: Dimension | bool | None) -> None:
        """Raise ``ValueError`` unless `check` returns ``wanted``; None accepts any number."""
        dimension = self.check(known)
        is_open = dimension is None or wanted is None
        if dimension != wanted and (not is_open or True in (dimension, wanted)):
            example = ", such as x < 1 mm" if wanted is True else ""
            raise ValueError(f"must be {_kind(wanted)}{example}, but {_quoted(self.source)} is {_kind(dimension)}")

    def apply(
        self,
        values: Mapping[str, Any],
        functions: Mapping[str, Callable[..., Any]],
        number: Callable[[float], Any] = float,
    ) -> Any:
        """Value of the formula in any algebra.

        Args:
            functions: the ``FUNCTIONS`` by name, and the relations by their NumPy names, such as ``less``.
        """
        values_by_name: dict[str, Any] = {name: number(constant) for name, constant in CONSTANTS.items()} | dict(values)
        for name, text in (*self.definitions, ("", self.source)):
            tree, literals = _parse(text)
            own = (
                values_by_name | {literal: number(si) for literal, (si, _) in literals.items()}
                if literals
                else values_by_name
            )
            if literals:
                own |= {n: values_by_name[unit] for n, unit in _further(literals) if unit in values_by_name}
            values_by_name[name] = _walk(tree, own, functions, number)
        return values_by_name[""]

    def evaluate(self, **values: np.ndarray | float) -> np.ndarray:
        """Values at many points, of the common shape of ``values``: floats, or bools for a condition.

        Values that are not finite are NaN or infinity, never an exception: that would stop one rank alone.
        """
        import numpy as np

        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        shape = np.broadcast_shapes(*(a.shape for a in arrays.values()))
        with np.errstate(all="ignore"):
            return np.broadcast_to(np.asarray(self.apply(arrays, numpy_functions(), np.float64)), shape)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(
            cls.read,
            serialization=core_schema.plain_serializer_function_ser_schema(cls.plain, info_arg=True),
        )

    def plain(self, info: SerializationInfo) -> str:
        """Return the text in a job, with definitions if the context asks for them."""
        return self.whole if writes_definitions(info) else self.source

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": ["string", "number"]}

    @classmethod
    def read(cls, value: object, info: ValidationInfo) -> Expression:
        """Return the formula that a job has, with the definitions in the context; ``ValueError`` if it is none."""
        if isinstance(value, cls):
            return value
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise ValueError(f"must be a formula or a number, not {value}")
        return cls.using(str(value), definitions_in(info))


def definitions_in(info: ValidationInfo) -> Mapping[str, Expression]:
    """Definitions of the section 'let' in the validation context."""
    definitions: Mapping[str, Expression] = (info.context or {}).get(LET, {})
    return definitions


def writes_definitions(info: SerializationInfo) -> bool:
    """True if formulas are written with the definitions that they use, as for the comparison of jobs."""
    return bool((info.context or {}).get(LET))


def faults(
    formulas: Iterable[tuple[KeyPath, Expression]], known: dict[str, Dimension | None], wanted: Dimension | bool | None
) -> Iterator[tuple[KeyPath, str]]:
    """Place of each formula that does not satisfy `Expression.expect`, and the reason."""
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
) -> list[tuple[KeyPath, str]]:
    """`faults` of the entries of a list ``field`` that may use the names in a field ``constants``."""
    entries = [((field, i), f) for i, f in enumerate(formulas) if f is not None]
    defined = {name for _, formula in entries for name, _ in formula.definitions}
    taken = sorted({*known, *CONSTANTS, *defined} & set(constants))
    if taken:
        owner = {name: f"a formula (let.{name})" for name in defined}
        return [(("constants", n), f"is already the name of {owner.get(n, 'something else')}") for n in taken]
    return list(faults(entries, known | dict.fromkeys(constants), wanted))


@cache
def _names(source: str) -> frozenset[str]:
    tree, literals = _parse(source)
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called}
    return frozenset(names - literals.keys() - CONSTANTS.keys())


@cache
def _further_units(source: str) -> frozenset[str]:
    return frozenset(unit for _, unit in _further(_parse(source)[1]))


def _further(literals: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Names of further units in a syntax tree, with their symbols."""
    return ((name, name.removeprefix(_FURTHER)) for name in literals if name.startswith(_FURTHER))


def _refuse_ambiguous(source: str, variables: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` for a division by a number with a compound unit: ``1/2 kg/m`` may mean two things."""
    for match in _DIVISOR.finditer(source):
        further = _FURTHER_UNIT.match(source, match.end())
        if further and further[2] not in variables and _is_unit(further[2]):
            raise ValueError(f"divides by a number with a compound unit: write /({match[1]} {match[2]}{further[0]}…)")


_DIVISOR = re.compile(r"/\s*" + _NUMBER_AND_UNIT.pattern)


@cache
def _is_unit(symbol: str) -> bool:
    if symbol in FUNCTIONS or symbol == "J":  # the volume ratio
        return False
    try:
        parse_unit(symbol)
    except ValueError:
        return False
    return True


@cache
def _parse(source: str) -> tuple[ast.expr, dict[str, tuple[float, Dimension]]]:
    """Syntax tree, and value and dimension of the numbers with units, which the tree contains as names."""
    if len(source) > _LONGEST:
        raise ValueError(f"a formula may have {_LONGEST} characters, not {len(source)}")
    text, literals = _named_literals(source)
    text = text.replace("^", "**").strip()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # such as 1and 2
            tree = ast.parse(text, mode="eval").body
    except (RecursionError, MemoryError):
        raise ValueError(f"{_quoted(source)} has too many operations; write it in parts (let)") from None
    except (SyntaxError, ValueError):
        raise ValueError(f"{_quoted(source)} is not a formula") from None
    for node in ast.walk(tree):
        _refuse_unless_known(node, source, literals)
    return tree, literals


def _named_literals(source: str) -> tuple[str, dict[str, tuple[float, Dimension]]]:
    """The formula with a name for each number with a unit and for each further unit; their values and dimensions."""
    literals: dict[str, tuple[float, Dimension]] = {}
    parts: list[str] = []
    position = 0
    for match in _NUMBER_AND_UNIT.finditer(source):
        number, unit, power = match.groups()
        if power:
            raise ValueError(f"'{match[0].strip()}…' is ambiguous in {_quoted(source)}: write ({number} {unit})**…")
        name = f"_{len(literals)}"
        try:
            literals[name] = parse_quantity(f"{number} {unit}")
        except ValueError as error:
            raise ValueError(f"in {_quoted(source)}: {error} A product is written {number}*{unit}.") from None
        parts += [source[position : match.start()], f"({name})"]
        position = match.end()
        while (further := _FURTHER_UNIT.match(source, position)) and _is_unit(further[2]):
            operation, symbol, exponent = further.groups()
            name = f"{_FURTHER}{symbol}"
            literals[name] = parse_quantity(f"1 {symbol}")
            power = re.sub(r"[\^*]", "", exponent or "1").translate(_SUPERSCRIPTS)
            parts.append(f"{'/' if operation.strip() == '/' else '*'}{name}**({power})")
            position = further.end()
    return "".join([*parts, source[position:]]), literals


def _depth(tree: ast.expr, known_depths: Mapping[str, int] = MappingProxyType({})) -> int:
    """Depth of a syntax tree, found without recursion; a sum of any number of terms counts as one level.

    Args:
        known_depths: depths of defined names.
    """
    deepest, depth, level = 0, 0, [tree]
    while level:
        depth += 1
        operands: list[ast.expr] = []
        for node in level:
            if isinstance(node, ast.Name):
                deepest = max(deepest, depth + known_depths.get(node.id, 0))
            elif _is_sum(node):
                operands += [term for _, term in _terms(node)]
            else:
                operands += [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
        level = operands
    return max(deepest, depth)


def _is_sum(node: ast.AST) -> TypeGuard[ast.BinOp]:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)


def _terms(node: ast.BinOp) -> list[tuple[bool, ast.expr]]:
    """Terms of ``a + b - c`` in order, with True for those that are added."""
    first: ast.expr = node
    terms = []
    while _is_sum(first):
        terms.append((isinstance(first.op, ast.Add), first.right))
        first = first.left
    return [(True, first), *reversed(terms)]


def _sum(terms: list[tuple[bool, Any]]) -> Any:
    """Sum of terms; many terms are added in pairs, so that the depth of the result is logarithmic in their number."""
    while len(terms) > _MANY:
        pairs = zip(terms[::2], terms[1::2], strict=False)
        odd = terms[-1:] if len(terms) % 2 else []
        terms = [(sign, a + b if sign == other else a - b) for (sign, a), (other, b) in pairs] + odd
    total = terms[0][1]
    for is_added, term in terms[1:]:
        total = total + term if is_added else total - term
    return total


def _quoted(source: str) -> str:
    """A formula in quotes for a message, shortened if it is long."""
    return f"'{source}'" if len(source) <= _SHOWN else f"'{source[: _SHOWN - 23]} … {source[-20:]}'"


def _kind(dimension: Dimension | bool | None) -> str:
    return "a condition" if dimension is True else "a number" if dimension is None else str(dimension)


def _refuse_unless_known(node: ast.AST, source: str, literals: Mapping[str, Any]) -> None:
    match node:
        case ast.Constant(value=bool() | str() | bytes() | complex() | None):
            raise ValueError(f"{_quoted(source)} may hold numbers, not {node.value!r}")
        case ast.Constant(value=int() | float() as number) if not math.isfinite(as_float(number)):
            raise ValueError(f"{_quoted(source)} holds a number that is too large")
        case ast.Name(id=name) if name.startswith("_") and name not in literals:
            raise ValueError(f"unknown name '{name}' in {_quoted(source)}; names begin with a letter")
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            _check_call(name, len(arguments), source)
        case ast.Constant() | ast.Name() | ast.Compare() | ast.BoolOp() | ast.BinOp() | ast.UnaryOp() | ast.Load():
            pass
        case _ if type(node) not in _ARITHMETIC and type(node) not in _LOGIC:
            sign = "; write <= or >= with a tolerance for ==" if isinstance(node, ast.Eq | ast.NotEq) else ""
            raise ValueError(f"{_quoted(source)} holds more than numbers, names, + - * / **, < > and functions{sign}")


def _check_call(name: str, arguments: int, source: str) -> None:
    if name not in FUNCTIONS:
        raise ValueError(f"unknown function '{name}' in {_quoted(source)}.{did_you_mean(name, FUNCTIONS)}")
    wanted = FUNCTIONS[name].arguments
    if arguments != wanted if wanted else arguments < 2:
        raise ValueError(f"{name}() takes {wanted or 'two or more'} values, not {arguments}, in {_quoted(source)}")


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
        case ast.BinOp() if _is_sum(node):
            return _sum([(is_added, value(term)) for is_added, term in _terms(node)])
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
