"""Reader of job, study and sweep files: YAML 1.2 with text keys only, within limits of size.

``1e6`` is a number, ``on`` and ``yes`` are text, ``010`` is ten, and duplicate keys are errors. PyYAML's loaders
implement YAML 1.1, which differs in all of this; only its parser is used. A file that would take more than a second or
two is refused, by its bytes, and by the number of its values, where an alias counts as all values that it represents.
"""

import re
import stat
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import JobError

MOST_BYTES = 8 * 2**20
"""bytes of a file"""
MOST_VALUES = 250_000
"""keys, numbers, texts, lists and sections in a file; a text counts once more for each 1,000 characters"""
MOST_KEYS = 10_000
"""keys of one section"""
DEEPEST = 64
"""nested levels of lists and sections"""
LONGEST_TEXT = 100_000
"""characters of one key or text"""
LONGEST_NUMBER = 400
"""characters of one number; the largest double has fewer digits"""

_PREFIX = "tag:yaml.org,2002:"
_Loader: Any = getattr(yaml, "CLoader", yaml.Loader)  # only its parser is used
_PATTERNS = {
    "null": re.compile(r"~|null|Null|NULL|"),
    "bool": re.compile(r"true|True|TRUE|false|False|FALSE"),
    "int": re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    "float": re.compile(
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
    ),
}
"""The core schema of YAML 1.2 (chapter 10.3 of its specification)."""

_BEGIN = frozenset("~nNtTfF+-.0123456789") | {""}


class _YamlFault(Exception):
    """Fault of a file, with its line (from 1)."""

    def __init__(self, text: str, event: Any) -> None:
        super().__init__(text)
        self.text, self.line = text, event.start_mark.line + 1


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the mapping in a YAML file; callers must not modify it.

    Raises:
        JobError: the file does not exist, cannot be read, exceeds the limits of this module, or is not a mapping;
            syntax errors name the line.
    """
    try:
        str(path).encode()
        if suffix_of(path) in FORMATS and path.is_file():
            raise JobError(f"{path}: is a mesh; give the job that names it as mesh.file ('hpcinv new' writes jobs)")
        text = _content(path).decode()
    except UnicodeEncodeError:
        raise JobError(f"{path}: the name of the file is not UTF-8; rename it") from None
    except FileNotFoundError:
        others = [p.name for p in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        raise JobError(f"{path}: no such file.{did_you_mean(path.name, others)}") from None
    except UnicodeDecodeError:
        raise JobError(f"{path}: is not a text file in UTF-8") from None
    except OSError as error:
        raise JobError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # a name with a null character
        raise JobError(f"{str(path)!r}: cannot be read: {error}") from None
    data = read_text(text, str(path))
    if not isinstance(data, dict):
        raise JobError(f"{path}: must contain keys and values, such as 'analysis: inverse'")
    return data


def read_text(text: str, where: str) -> Any:
    """Value of a text in YAML; errors begin with ``where``.

    Raises:
        JobError: the text is not valid YAML, or exceeds the limits of this module.
    """
    try:
        return _parsed(text)
    except _YamlFault as fault:
        raise JobError(f"{where}:{fault.line}: {fault.text}") from None
    except yaml.MarkedYAMLError as error:
        raise JobError(_syntax_error(error, text, where)) from None
    except yaml.YAMLError as error:
        reason = getattr(error, "reason", error)
        raise JobError(f"{where}: is not valid YAML: {reason}") from None


_REMEDIES = {
    "tab": "indent with spaces",
    "flow": "close each '{' by '}' and each '[' by ']', with commas between the entries",
    "quoted": "close the quotation mark",
    "mapping values": "put a text that contains ': ' in quotation marks, and indent the keys of a mapping alike",
    "':'": "write 'key: value'",
    "start any token": "put a text that begins with such a character in quotation marks",
    "expected key": "write 'key: value', with all keys of a mapping indented alike",
}


def _syntax_error(error: yaml.MarkedYAMLError, text: str, where: str) -> str:
    """Return the message for a syntax error: what it is, its line, and what to do."""
    mark, begin = error.problem_mark or error.context_mark, error.context_mark
    line = f":{mark.line + 1}" if mark else ""
    problem = " ".join(filter(None, [error.problem or "is not valid YAML", error.context]))
    if error.problem_mark and text[error.problem_mark.index : error.problem_mark.index + 1] == "\t":
        problem = problem.replace("character that cannot", "a tab character that cannot")
    remedy = next((f"; {remedy}" for part, remedy in _REMEDIES.items() if part in problem), "")
    if mark and begin and begin.line != mark.line:
        problem += f", which begins in line {begin.line + 1}"
    return f"{where}{line}: {problem}{remedy}"


def _content(path: Path) -> bytes:
    """Bytes of a regular file of limited size; a pipe may never end, and a run reads its job twice."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise JobError(f"{path}: cannot be read: it is a directory")
    if not stat.S_ISREG(status.st_mode):
        raise JobError(f"{path}: cannot be read: it is a device or a pipe; use a regular file")
    with admitted(path).open("rb") as file:  # not the size from stat, which is 0 for files of /proc
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        size = max(status.st_size, len(content))
        raise JobError(f"{path}: has {size:,} bytes, and may have {MOST_BYTES:,}; large data belong in a mesh file")
    return content


@lru_cache(maxsize=2)  # a file is read several times: first for its kind, then for its content
def _parsed(text: str) -> Any:
    document: Any = None
    documents = 0
    events = yaml.parse(text, Loader=_Loader)
    for event in events:
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
            if documents > 1:
                raise _YamlFault("begins a second document ('---'), but only one is allowed", event)
            document = _Document(events).content()
    return document


class _Document:
    """Conversion of the events of one document to plain values; recursion is limited by `DEEPEST`."""

    def __init__(self, events: Iterator[Any]) -> None:
        self.events = events
        self.anchors: dict[str, tuple[Any, int]] = {}  # the value, and its number of values
        self.values = 0
        self.open: list[str | None] = []  # anchors of the lists and sections that are being read

    def content(self) -> Any:
        """Value of the document, whose start event has been read."""
        value = self._value(next(self.events))
        next(self.events)  # the end of the document
        return value

    def _value(self, event: Any) -> Any:
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event)
        count_before = self.values
        value = self._scalar(event) if isinstance(event, yaml.ScalarEvent) else self._container(event)
        if event.anchor is not None:
            self.anchors[event.anchor] = value, self.values - count_before
        return value

    def _scalar(self, event: Any) -> str | bool | int | float | None:
        self._check_text(event)
        return _scalar_of(event)

    def _container(self, event: Any) -> list[Any] | dict[str, Any]:
        self._count(1, event)
        kind = "map" if isinstance(event, yaml.MappingStartEvent) else "seq"
        if event.tag not in (None, "!", _PREFIX + kind):
            raise _not_allowed(event)
        if len(self.open) == DEEPEST:
            raise _YamlFault(f"more than {DEEPEST} nested levels of lists and sections", event)
        self.open.append(event.anchor)
        content = self._section() if kind == "map" else [self._value(entry) for entry in self._up_to_end()]
        self.open.pop()
        return content

    def _section(self) -> dict[str, Any]:
        content: dict[str, Any] = {}
        for event in self._up_to_end():
            if not isinstance(event, yaml.ScalarEvent):
                raise _YamlFault("a key must be text", event)
            self._check_text(event)
            key = event.value
            if key in content:
                raise _YamlFault(f"duplicate key '{_short(key)}'", event)
            if len(content) == MOST_KEYS:
                raise _YamlFault(f"more than {MOST_KEYS:,} keys in one section", event)
            if event.anchor is not None:
                self.anchors[event.anchor] = key, 1 + len(key) // 1000
            content[key] = self._value(next(self.events))
        return content

    def _up_to_end(self) -> Iterator[Any]:
        """Events up to the end of a list or section; what is in them is read meanwhile."""
        for event in self.events:
            if isinstance(event, yaml.CollectionEndEvent):
                return
            yield event

    def _count(self, more: int, event: Any) -> None:
        self.values += more
        if self.values > MOST_VALUES:
            aliases = ", each alias (*) counting as all values that it represents" if self.anchors else ""
            raise _YamlFault(f"more than {MOST_VALUES:,} values, the limit for a file{aliases}", event)

    def _alias(self, event: Any) -> Any:
        if event.anchor not in self.anchors:
            text = "is inside its own anchor (&)" if event.anchor in self.open else "has no anchor (&) before it"
            raise _YamlFault(f"the alias '*{event.anchor}' {text}", event)
        value, size = self.anchors[event.anchor]
        self._count(size, event)
        return value

    def _check_text(self, event: Any) -> None:
        text = event.value
        self._count(1 + len(text) // 1000, event)
        if len(text) > LONGEST_TEXT:
            raise _YamlFault(f"a text of {len(text):,} characters; it may have {LONGEST_TEXT:,}", event)
        if not text.isascii() and re.search("[\ud800-\udfff]", text):  # escapes can produce invalid text
            raise _YamlFault("a text that is not Unicode (surrogates)", event)


def _scalar_of(event: Any) -> str | bool | int | float | None:
    """Value of a scalar by its tag, or by the core schema if it is plain and has no tag."""
    text, kind = event.value, _kind_of(event)
    if kind == "str":
        return str(text)
    if kind == "null":
        return None
    if kind == "bool":
        return bool(text.lower() == "true")
    if len(text) > LONGEST_NUMBER:
        raise _YamlFault(f"a number of {len(text):,} characters; it may have {LONGEST_NUMBER}", event)
    if text[:2] in ("0o", "0x"):
        return int(text, 0) if kind == "int" else float(int(text, 0))
    return int(text) if kind == "int" else float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


def _kind_of(event: Any) -> str:
    """Return what a scalar is: ``str``, or the name of a pattern."""
    text, (plain, quoted) = event.value, event.implicit
    if event.tag in ("!", _PREFIX + "str") or (event.tag is None and not plain and quoted):
        return "str"
    if event.tag is None:
        if text[:1] not in _BEGIN:  # the first characters of all patterns
            return "str"
        return next((kind for kind, pattern in _PATTERNS.items() if pattern.fullmatch(text)), "str")
    kind = str(event.tag.removeprefix(_PREFIX))
    if kind not in _PATTERNS:
        raise _not_allowed(event)
    if not any(_PATTERNS[k].fullmatch(text) for k in {kind, "int" if kind == "float" else kind}):
        raise _YamlFault(f"'{_short(text)}' is not a valid !!{kind}", event)
    return kind


def _not_allowed(event: Any) -> _YamlFault:
    tag = event.tag.replace(_PREFIX, "!!", 1)
    return _YamlFault(f"the tag '{_short(tag)}' is not allowed here; leave it out", event)


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_study(path: Path) -> bool:
    """Return whether a file is a study rather than a job; raises ``JobError`` if it cannot be read."""
    return "series" in read_yaml(path)


def is_sweep(path: Path) -> bool:
    """Return whether a file is a sweep rather than a job or a study; raises ``JobError`` if it cannot be read."""
    return "axes" in read_yaml(path)
