"""Base classes of the parts of a job file: strict immutable models, families of models, and readable errors."""

import importlib
import pkgutil
import re
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Self, TypeVar, Union, get_args, get_origin
from weakref import WeakValueDictionary

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError, core_schema

from hpcinv.base.quantity.constants import constant, is_pure
from hpcinv.base.quantity.docstrings import describe, meanings
from hpcinv.base.quantity.expressions import KeyPath as KeyPath
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import NUMBER
from hpcinv.errors import JobError

type Faults = Iterator[tuple[KeyPath, str]]
"""faults of a part of a job, with their places in it"""

T = TypeVar("T")
ListOf = Annotated[tuple[T, ...], Field(strict=False)]  # YAML lists become tuples


def _is_list(given: Any) -> Any:
    """Refuse a single value where three are needed; other types are checked after it."""
    if isinstance(given, str | int | float) and not isinstance(given, bool):
        shown_value = " ".join(str(given).split())[:40]
        raise ValueError(f"must be a list of three, such as [0, 0, {shown_value}], not {shown(given)}")
    return given


Triple = Annotated[tuple[T, T, T], BeforeValidator(_is_list), Field(strict=False)]
TextOrTexts = Annotated[
    ListOf[str],
    BeforeValidator(lambda v: [v] if isinstance(v, str) else v),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}),
]


def _is_identifier(name: str) -> str:
    if re.fullmatch(r"[A-Za-z_][\w-]*", name) is None:
        raise ValueError(f"{shown(name)} is not a name: use letters, digits, _ and -, beginning with a letter")
    return name


Name = Annotated[str, AfterValidator(_is_identifier)]
NAME_OF_FILE = r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,99}$"
FileName = Annotated[str, Field(pattern=NAME_OF_FILE)]
"""Name of results and of their directory; it cannot lead to another place ('..', slashes)."""


def name_from(path: Path) -> str:
    """Return the stem of a file as a `FileName`: letters without accents, and ``-`` for what is not allowed."""
    plain = unicodedata.normalize("NFKD", path.stem).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip(".-")[:100] or "job"


class Problems(ValueError):
    """Faults found by one validator, each with its place below the validated value."""

    def __init__(self, *faults: tuple[KeyPath, str]) -> None:
        super().__init__("; ".join(text for _, text in faults))
        self.faults = faults


def raise_if_any(faults: Iterable[tuple[KeyPath, str]]) -> None:
    """Raise `Problems` if there are any."""
    if problems := tuple(faults):
        raise Problems(*problems)


@contextmanager
def collected(problems: list[tuple[KeyPath, str]], *place: int | str) -> Iterator[None]:
    """Add the faults that are found in this context to ``problems``, with their place, instead of raising them."""
    try:
        yield
    except Problems as error:
        problems += [((*place, *inner_place), text) for inner_place, text in error.faults]
    except ValidationError as error:
        problems += [((*place, *inner_place), text) for inner_place, text in problems_in(error)]
    except ValueError as error:
        problems.append((place, str(error)))


def repeated(names: Sequence[str]) -> Iterator[int]:
    """Indices of the names that occur earlier in the sequence."""
    seen: set[str] = set()
    for i, name in enumerate(names):
        if name in seen:
            yield i
        seen.add(name)


class Spec(BaseModel):
    """A part of a job: immutable, without unknown keys, and with strict types (text and true are not numbers)."""

    alternatives: ClassVar[tuple[str, ...]] = ()
    """alternative keys, exactly one in a part, for its JSON schema; `_contradictions` reports it otherwise"""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        defer_build=True,
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        _members.cache_clear()

    @classmethod
    def known_keys(cls) -> tuple[str, ...]:
        """All keys that this part of a job may have."""
        return tuple(cls.model_fields)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """JSON schema with the descriptions of the keys, and arithmetic instead of numbers."""
        json_schema = handler(schema)
        content = handler.resolve_ref_schema(json_schema)
        describe(content, cls)
        for key in plain_numbers(cls).keys() & content.get("properties", {}).keys():
            _also_arithmetic(content["properties"][key])
        if cls.alternatives:
            content["oneOf"] = [{"required": [key]} for key in cls.alternatives]
        return json_schema

    @classmethod
    def _place_written(cls, place: KeyPath, data: Any) -> KeyPath:
        """Return the place of a fault in ``data`` as it is written, if it has other keys than the fields."""
        return place

    def _completed(self, info: ValidationInfo) -> Self:
        """Return the part with the values of fields that can be read only with other fields, which are all valid."""
        return self

    def _contradictions(self, info: ValidationInfo) -> Faults:
        """Yield faults between fields that are valid by themselves; of ``info``, only the context may be read."""
        yield from ()

    @classmethod
    def is_read_by_fields(cls, data: Mapping[str, Any]) -> bool:
        """Return whether each field follows from its own entry in ``data`` alone, and nothing follows from several."""
        return has_validators(cls, "_validate")

    @model_validator(mode="wrap")
    @classmethod
    def _validate(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        """Reword errors here, where the keys of the part and their descriptions are known; find contradictions."""
        if isinstance(data, Mapping) and "on" in cls.model_fields:
            raise_if_any(_keys_of_yaml_1_1(data))
        try:
            part = handler(evaluated_constants(cls, data))
        except ValidationError as error:
            # A file that two fields have is refused once.
            faults = dict.fromkeys((cls._place_written(place, data), text) for place, text in problems_in(error, cls))
            lines: list[InitErrorDetails] = [
                {"type": PydanticCustomError(_PLAIN, "{text}", {"text": text}), "loc": place, "input": None}
                for place, text in faults
            ]
            raise ValidationError.from_exception_data(cls.__name__, lines) from None
        if part is not data:  # one that was validated before is complete
            part = part._completed(info)
        raise_if_any((cls._place_written(place, data), text) for place, text in part._contradictions(info))
        return part


@cache
def has_validators(kind: type[Spec], *names: str) -> bool:
    """Return whether a part has these validators of all its data, and no values that follow from several fields."""
    return kind._completed is Spec._completed and {*kind.__pydantic_decorators__.model_validators} == {*names}


def _keys_of_yaml_1_1(data: Mapping[Any, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield the fault of a key ``on`` that a program for YAML 1.1 has read, or written, as true."""
    for key in data:
        if key is True or key in ("true", "True"):
            text = "is what programs for YAML 1.1 make of the key 'on': write 'region', which is the same, or \"on\""
            yield (str(key),), text


@cache
def plain_numbers(kind: type[Spec]) -> Mapping[str, type[float | int]]:
    """Fields of a part of a job that are numbers without dimension (`float` or `int`), with their type."""
    numbers: dict[str, type[float | int]] = {}
    for name, field in kind.model_fields.items():
        own = {part for part in _union(field.annotation) if part is not NoneType}
        if own in ({float}, {int}) and all(
            type(mark).__module__.startswith("annotated_types") for mark in field.metadata
        ):
            numbers[name] = own.pop()
    return numbers


def _union(annotation: Any) -> Iterator[Any]:
    """The types of a union, without their annotations."""
    if get_origin(annotation) in (Union, UnionType):
        for part in get_args(annotation):
            yield from _union(part)
    elif get_origin(annotation) is Annotated:
        first, *marks = get_args(annotation)
        is_plain = all(isinstance(mark, FieldInfo) for mark in marks)
        yield from _union(first) if is_plain else (annotation,)
    else:
        yield annotation


def evaluated_constants(kind: type[Spec], data: Any) -> Any:
    """Data of a part of a job with the values of arithmetic, such as ``1/3``, in its plain numbers."""
    if not isinstance(data, Mapping):
        return data
    texts = {name: number for name, number in plain_numbers(kind).items() if _is_arithmetic(data.get(name))}
    if not texts:
        return data
    changed = dict(data)
    for name, number in texts.items():
        with suppress(ValueError):  # the message about a text instead of a number is better
            value, dimension = constant(data[name])
            if is_pure(dimension) and (number is float or value.is_integer()):
                changed[name] = number(value)
    return changed


def _is_arithmetic(value: object) -> bool:
    """Return whether a value is a text other than a number in quotes, which is a mistake."""
    return isinstance(value, str) and re.fullmatch(NUMBER, value.strip()) is None


def _also_arithmetic(schema: dict[str, Any]) -> None:
    """Let the JSON schema of a number accept a text, too."""
    choices = schema.get("anyOf", [schema])
    if any(choice.get("type") == "string" for choice in choices):
        return
    number = {key: schema.pop(key) for key in [*schema] if key not in ("title", "default", "description")}
    text = {"type": "string", "format": ARITHMETIC, "pattern": rf"^(?!\s*{NUMBER}\s*$)[\s(+-]*{NUMBER}.*[*/^+-]"}
    schema["anyOf"] = [*number.get("anyOf", [number]), text]


class OneOf:
    """Annotation of a field for one member of a family of specs, selected by the literal field ``tag``.

    The family is the annotated type, unless it is given. Members are looked up when a value is validated: defining a
    subclass registers it.
    """

    def __init__(self, tag: str, family: Any = None) -> None:
        self.tag, self.family = tag, family

    def choose(self, data: Any, info: core_schema.ValidationInfo[Any]) -> Any:
        """Validated member for ``data``."""
        family = self.family
        if isinstance(data, family):
            return data
        if not isinstance(data, Mapping):
            raise ValueError(f"must be a mapping with the key '{self.tag}', not {shown(data)}")
        name = data.get(self.tag)
        members = _members_with(family, self.tag, name)
        if not isinstance(name, str) or name not in members:
            fault = "is needed." if name is None else f"unknown {self.tag} {shown(name)}."
            raise Problems(((self.tag,), fault + did_you_mean(str(name), members)))
        return members[name].model_validate(data, context=info.context)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        self.family = self.family or source
        return core_schema.with_info_plain_validator_function(self.choose)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        choices = []
        for member in members_of(self.family, self.tag).values():
            choice = handler.resolve_ref_schema(handler(member.__pydantic_core_schema__))
            describe(choice, member)
            choice["required"] = [*dict.fromkeys([self.tag, *choice.get("required", ())])]
            choices.append(choice)
        return {"oneOf": choices}


def members_of(family: type[Spec], tag: str) -> dict[str, type[Any]]:
    """Concrete subclasses of ``family`` by the value of their literal field ``tag``, sorted.

    Raises:
        ValueError: two subclasses have the same value.
    """
    if family in _PACKAGES:
        _import_members(_PACKAGES[family])
    return dict(_members(family, tag))


_PACKAGES: dict[type[Any], str] = {}
"""packages whose modules define the members of families"""


def define_in(package: str, family: type[Spec]) -> None:
    """Let the members of a family be imported from the modules of a package when they are asked for.

    A member is best in a module of its name, with ``_`` instead of ``-``; else all modules are imported to find it.
    """
    _PACKAGES[family] = package


def _members_with(family: type[Spec], tag: str, name: object) -> Mapping[str, type[Any]]:
    """Return the members of a family that are imported: the one of a name, or all if there is none."""
    package = _PACKAGES.get(family, "")
    if package and isinstance(name, str) and name.replace("-", "_") in _modules_of(package):
        importlib.import_module(f"{package}.{name.replace('-', '_')}")
    members = _members(family, tag)
    is_member = isinstance(name, str) and name in members
    return members if is_member or not package else members_of(family, tag)


@cache
def _modules_of(package: str) -> frozenset[str]:
    path = importlib.import_module(package).__path__
    return frozenset(module.name for module in pkgutil.iter_modules(path))


@cache
def _import_members(package: str) -> None:
    import_modules(package, importlib.import_module(package).__path__)


@cache  # until a subclass is defined; a class of which nothing else is left disappears
def _members(family: type[Spec], tag: str) -> WeakValueDictionary[str, type[Any]]:
    members: dict[str, type[Spec]] = {}
    pending = family.__subclasses__()
    while pending:
        kind = pending.pop()
        pending += kind.__subclasses__()
        for name in get_args(kind.model_fields[tag].annotation) if tag in kind.model_fields else ():
            if name in members:
                both = " and ".join(f"{k.__qualname__} ({_file_of(k)})" for k in (members[name], kind))
                raise ValueError(f"{both} have the same {tag} '{name}'; rename one of them")
            members[name] = kind
    return WeakValueDictionary(sorted(members.items()))


def _file_of(kind: type[Any]) -> str:
    return getattr(sys.modules.get(kind.__module__), "__file__", None) or kind.__module__


def metadata_in[M](kind: type[M], *annotations: Any) -> M | None:
    """The first instance of ``kind`` in nested annotations such as ``tuple[Annotated[float, M()], …] | None``."""
    for annotation in annotations:
        if isinstance(annotation, kind):
            return annotation
        if (mark := metadata_in(kind, *get_args(annotation))) is not None:
            return mark
    return None


def import_modules(package: str, path: Iterable[str]) -> None:
    """Import all modules of a package, which registers their classes."""
    for module in pkgutil.iter_modules(path):
        importlib.import_module(f"{package}.{module.name}")


def dotted_key(location: KeyPath) -> str:
    """``("effects", 0, "density")`` as ``effects[0].density``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")


def shown(value: object) -> str:
    """A value for a message, shortened if it is long."""
    text = "nothing" if value is None else repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


ARITHMETIC = "arithmetic"
"""format, in the JSON schema, of a text instead of a number, such as 1/3"""

_PLAIN = "plain"  # the type of errors that have been reworded


_MOST_PROBLEMS = 50  # of one file in an error message
_LONGEST_PROBLEM = 1000  # characters of one message


def job_error(path: Path, error: ValidationError, spec: type[Spec]) -> JobError:
    """Error for a file whose content is not a valid ``spec``: a line for each of the first 50 problems."""
    problems = problems_in(error, spec)
    lines = [f"{path}: {dotted_key(where)}: {what}" for where, what in problems[:_MOST_PROBLEMS]]
    if (more := len(problems) - _MOST_PROBLEMS) > 0:
        lines.append(f"{path}: and {more:,} more problems like these")
    return JobError(*lines)


def problems_in(error: ValidationError, spec: type[Spec] | None = None) -> list[tuple[KeyPath, str]]:
    """Place and message of all errors; ``spec`` is the model whose keys the locations begin with.

    Messages are left empty from the 51st error on, to save time.
    """
    problems: list[tuple[KeyPath, str]] = []
    for line in error.errors(include_url=False):
        cause = line.get("ctx", {}).get("error")
        if isinstance(cause, Problems):
            problems += [((*line["loc"], *place), _shortened(text)) for place, text in cause.faults]
        else:
            text = _shortened(_reworded(line, spec)) if len(problems) < _MOST_PROBLEMS else ""
            problems.append((tuple(part for part in line["loc"] if part != "[key]"), text))
    return problems


def _shortened(text: str) -> str:
    """A message without its middle part if it is very long."""
    half = _LONGEST_PROBLEM // 2
    return text if len(text) <= _LONGEST_PROBLEM else f"{text[:half]} [...] {text[-half:]}"


def _reworded(line: ErrorDetails, spec: type[Spec] | None) -> str:
    fields = spec.known_keys() if spec and len(line["loc"]) == 1 else ()
    key = str(line["loc"][-1]) if line["loc"] else ""
    if line["type"] == "extra_forbidden":
        return f"unknown key.{did_you_mean(key, fields)}"
    text = _WORDS[line["type"]](line) if line["type"] in _WORDS else line["msg"]
    meaning = meanings(spec).get(key) if spec and key in fields else None
    return f"{text}: {meaning}" if meaning and line["type"] in _EXPLAINED else text


_EXPLAINED = ("missing", "string_pattern_mismatch")  # errors shown with the description of the key


def _must_be(kind: str) -> Callable[[ErrorDetails], str]:
    return lambda line: f"must be {kind}, not {shown(line['input'])}"


def _bound(relation: str, key: str) -> Callable[[ErrorDetails], str]:
    return lambda line: f"must be {relation} {line['ctx'][key]:g}, not {shown(line['input'])}"


def _choice(line: ErrorDetails) -> str:
    expected, value = line["ctx"]["expected"], line["input"]
    hint = did_you_mean(value, re.findall(r"'([^']*)'", expected), list_all=False) if isinstance(value, str) else ""
    return f"must be {expected}, not {shown(value)}" + (f".{hint}" if hint else "")


_WORDS: dict[str, Callable[[ErrorDetails], str]] = {
    _PLAIN: lambda line: line["ctx"]["text"],
    "value_error": lambda line: str(line["ctx"]["error"]),
    "missing": lambda line: "is needed",
    "too_long": lambda line: f"must have {line['ctx']['max_length']} entries, not {line['ctx']['actual_length']}",
    "string_pattern_mismatch": lambda line: f"{shown(line['input'])} is not allowed",
    "literal_error": _choice,
    "model_type": _must_be("a mapping of keys to values"),
    "dict_type": _must_be("a mapping of names to values"),
    "tuple_type": _must_be("a list"),
    "string_type": _must_be("text"),
    "bool_type": _must_be("true or false"),
    "int_type": _must_be("a whole number"),
    "float_type": _must_be("a number"),
    "finite_number": _must_be("a finite number"),
    "greater_than": _bound("greater than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("less than", "lt"),
    "less_than_equal": _bound("at most", "le"),
}
