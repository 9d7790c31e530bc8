"""Job, study and sweep files: YAML 1.2 with text as the only kind of key, read within limits of size.

``1e6`` is a number, ``on`` and ``yes`` are text, ``010`` is ten, and no key may stand twice. PyYAML's own loaders speak
YAML 1.1, in which none of this holds; only its parser is used. A file is refused before it can take more than a second
or two: by its bytes, and by its values while they are read, where an alias counts as all that it stands for.
"""

from __future__ import annotations

import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from hpcinv.errors import JobError
from hpcinv.quantity.suggestions import did_you_mean

MOST_BYTES = 8 * 2**20
"""of a file"""
MOST_VALUES = 250_000
"""keys, numbers, texts, lists and sections in a file; a text counts once more for each 1,000 characters"""
MOST_KEYS = 10_000
"""of one section"""
DEEPEST = 64
"""levels of lists and sections inside each other"""
LONGEST_TEXT = 100_000
"""characters of one key or text"""
LONGEST_NUMBER = 400
"""characters of one number: more than the largest double has digits"""

_PREFIX = "tag:yaml.org,2002:"
_Loader: Any = getattr(yaml, "CLoader", yaml.Loader)  # of which only the parser is used
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
    """What is wrong, and the line (from 1)."""

    def __init__(self, text: str, event: Any) -> None:
        super().__init__(text)
        self.text, self.line = text, event.start_mark.line + 1


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; callers must not change it.

    Raises:
        JobError: there is no such file, it cannot be read, it is larger than the limits of this module, or it is no
            mapping; syntax errors name the line.
    """
    try:
        str(path).encode()
        text = _content(path).decode()
    except UnicodeEncodeError:
        raise JobError([f"{path}: the name of the file is not UTF-8; rename it"]) from None
    except FileNotFoundError:
        others = [p.name for p in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        raise JobError([f"{path}: no such file.{did_you_mean(path.name, others)}"]) from None
    except UnicodeDecodeError:
        raise JobError([f"{path}: is not a text file in UTF-8"]) from None
    except OSError as error:
        raise JobError([f"{path}: cannot be read: {error.strerror}"]) from None
    except ValueError as error:  # a name with a null character
        raise JobError([f"{str(path)!r}: cannot be read: {error}"]) from None
    data = read_text(text, str(path))
    if not isinstance(data, dict):
        raise JobError([f"{path}: must hold keys and values, such as 'analysis: inverse'"])
    return data


def read_text(text: str, where: str) -> Any:
    """The value of a text in YAML; ``where`` names it in errors.

    Raises:
        JobError: it is no YAML, or larger than the limits of this module.
    """
    try:
        return _parsed(text)
    except _YamlFault as fault:
        raise JobError([f"{where}:{fault.line}: {fault.text}"]) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        context = f" {error.context}" if error.context else ""
        raise JobError([f"{where}{line}: {error.problem or 'is no YAML'}{context}"]) from None
    except yaml.YAMLError as error:
        reason = getattr(error, "reason", error)
        raise JobError([f"{where}: is no YAML: {reason}"]) from None


def _content(path: Path) -> bytes:
    """The bytes of a regular file that is not too large: a pipe may never end, and a run reads its job again."""
    found = path.stat()
    if stat.S_ISDIR(found.st_mode):
        raise JobError([f"{path}: cannot be read: it is a directory"])
    if not stat.S_ISREG(found.st_mode):
        raise JobError([f"{path}: cannot be read: it is no regular file (but a device or a pipe); write one"])
    with path.open("rb") as file:  # what is read counts: a file of /proc says that it has no bytes
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        size = max(found.st_size, len(content))
        raise JobError([f"{path}: has {size:,} bytes, and may have {MOST_BYTES:,}; large data belong into a mesh file"])
    return content


@lru_cache(maxsize=2)  # a file is read several times: to find out what it is, and for what is in it
def _parsed(text: str) -> Any:
    """The one document in a text."""
    document: Any = None
    found = 0
    events = yaml.parse(text, Loader=_Loader)
    for event in events:
        if isinstance(event, yaml.DocumentStartEvent):
            found += 1
            if found > 1:
                raise _YamlFault("begins a second document ('---'), and there may be only one", event)
            document = _Document(events).content()
    return document


@dataclass
class _Open:
    """A list or mapping whose end has not come yet; ``key`` is one of a mapping that still lacks its value."""

    content: list[Any] | dict[str, Any]
    anchor: str | None
    before: int
    key: str | None = None

    def put(self, value: Any, event: Any) -> None:
        if isinstance(self.content, list):
            self.content.append(value)
        elif self.key is not None:
            self.content[self.key] = value
            self.key = None
        else:
            raise _YamlFault("a key must be text", event)


class _Document:
    """Makes plain values of the events of one document, without recursion."""

    def __init__(self, events: Iterator[Any]) -> None:
        self.events = events
        self.anchors: dict[str, tuple[Any, int]] = {}  # the value, and how many values it stands for
        self.values = 0
        self.open: list[_Open] = []
        self.result: Any = None

    def content(self) -> Any:
        """The value of the document, whose start has been read."""
        for event in self.events:
            kind = type(event)
            if kind is yaml.ScalarEvent:
                self._count(1 + len(event.value) // 1000, event)
                self._scalar(event)
            elif kind in (yaml.SequenceEndEvent, yaml.MappingEndEvent):
                ended = self.open.pop()
                if ended.anchor is not None:
                    self.anchors[ended.anchor] = ended.content, self.values - ended.before
                self._put(ended.content, event)
            elif kind is yaml.AliasEvent:
                self._alias(event)
            elif kind is yaml.DocumentEndEvent:
                break
            else:
                self._count(1, event)
                self._begin(event)
        return self.result

    def _put(self, value: Any, event: Any) -> None:
        if self.open:
            self.open[-1].put(value, event)
        else:
            self.result = value

    @property
    def _awaits_key(self) -> bool:
        return bool(self.open) and isinstance(self.open[-1].content, dict) and self.open[-1].key is None

    def _count(self, more: int, event: Any) -> None:
        self.values += more
        if self.values > MOST_VALUES:
            aliases = ", each alias (*) counting as all that it stands for" if self.anchors else ""
            raise _YamlFault(
                f"more than {MOST_VALUES:,} values, which is the most that a file may have{aliases}", event
            )

    def _alias(self, event: Any) -> None:
        if event.anchor not in self.anchors:
            inside = any(container.anchor == event.anchor for container in self.open)
            text = "stands within what it stands for" if inside else "is of no anchor (&) before it"
            raise _YamlFault(f"the alias '*{event.anchor}' {text}", event)
        value, size = self.anchors[event.anchor]
        self._count(size, event)
        if self._awaits_key:
            raise _YamlFault("a key must be text", event)
        self._put(value, event)

    def _begin(self, event: Any) -> None:
        content: list[Any] | dict[str, Any]
        kind, content = ("map", {}) if isinstance(event, yaml.MappingStartEvent) else ("seq", [])
        if event.tag not in (None, "!", _PREFIX + kind):
            raise _not_allowed(event)
        if self._awaits_key:
            raise _YamlFault("a key must be text", event)
        if len(self.open) == DEEPEST:
            raise _YamlFault(f"more than {DEEPEST} levels of lists and sections inside each other", event)
        self.open.append(_Open(content, event.anchor, self.values - 1))

    def _scalar(self, event: Any) -> None:
        text = event.value
        if len(text) > LONGEST_TEXT:
            raise _YamlFault(f"a text of {len(text):,} characters; it may have {LONGEST_TEXT:,}", event)
        if not text.isascii() and re.search("[\ud800-\udfff]", text):  # escapes can make what is no text
            raise _YamlFault("a text that is not Unicode (surrogates)", event)
        if self._awaits_key:
            container = self.open[-1]
            if text in container.content:
                raise _YamlFault(f"'{_short(text)}' stands twice", event)
            if len(container.content) == MOST_KEYS:
                raise _YamlFault(f"more than {MOST_KEYS:,} keys in one section", event)
            container.key = text
            value: Any = text
        else:
            value = _scalar_of(event)
            self._put(value, event)
        if event.anchor is not None:
            self.anchors[event.anchor] = value, 1 + len(text) // 1000


def _scalar_of(event: Any) -> str | bool | int | float | None:
    """The value of a scalar by its tag; without one by the core schema, if it is plain."""
    text = event.value
    plain, quoted = event.implicit
    if event.tag in ("!", _PREFIX + "str") or (event.tag is None and not plain and quoted):
        return str(text)
    if event.tag is None:
        kind = None
        if text[:1] in _BEGIN:  # most texts begin otherwise
            kind = next((kind for kind, pattern in _PATTERNS.items() if pattern.fullmatch(text)), None)
    else:
        kind = event.tag.removeprefix(_PREFIX)
        if kind not in _PATTERNS:
            raise _not_allowed(event)
        if not any(_PATTERNS[k].fullmatch(text) for k in {kind, "int" if kind == "float" else kind}):
            raise _YamlFault(f"'{_short(text)}' is no !!{kind}", event)
    match kind:
        case None:
            return str(text)
        case "null":
            return None
        case "bool":
            return bool(text.lower() == "true")
    if len(text) > LONGEST_NUMBER:
        raise _YamlFault(f"a number of {len(text):,} characters; it may have {LONGEST_NUMBER}", event)
    if kind == "int":
        return int(text, 0 if text[:2] in ("0o", "0x") else 10)
    return float(
        int(text, 0) if text[:2] in ("0o", "0x") else text.lower().replace(".inf", "inf").replace(".nan", "nan")
    )


def _not_allowed(event: Any) -> _YamlFault:
    tag = event.tag.replace(_PREFIX, "!!", 1)
    return _YamlFault(f"the tag '{_short(tag)}' is not allowed here; leave it out", event)


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
