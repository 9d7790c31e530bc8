"""Job files as YAML 1.2: ``1e6`` is a number, ``on`` and ``yes`` are text, ``010`` is ten, no key may stand twice.

PyYAML speaks YAML 1.1, in which none of this holds.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from hpcinv.errors import JobError
from hpcinv.spelling import did_you_mean


class _Loader(yaml.SafeLoader):
    """The core schema of YAML 1.2 (chapter 10.3 of its specification), with text as the only kind of key."""

    yaml_implicit_resolvers = {}  # noqa: RUF012  (PyYAML's own are those of YAML 1.1)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[str, Any]:  # type: ignore[override]
        mapping: dict[str, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key must be text", key.start_mark)
            if key.value in mapping:
                raise yaml.constructor.ConstructorError(None, None, f"'{key.value}' stands twice", key.start_mark)
            mapping[key.value] = self.construct_object(value, deep=True)
        return mapping

    def construct_scalar_of_core_schema(self, node: yaml.ScalarNode) -> bool | int | float | None:
        text = node.value.lower()
        if node.tag.endswith(":null"):
            return None
        if node.tag.endswith(":bool"):
            return bool(text == "true")
        if node.tag.endswith(":int"):
            return int(text, 0 if text[:2] in ("0o", "0x") else 10)
        return float(text.replace(".inf", "inf").replace(".nan", "nan"))


for _kind, _pattern in {
    "null": r"~|null|Null|NULL|",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    "float": r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
}.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(rf"(?:{_pattern})\Z"), None)
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_scalar_of_core_schema)


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        JobError: there is no such file, it cannot be read, or it is no mapping; syntax errors name the line.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except FileNotFoundError:
        others = [p.name for p in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
        raise JobError([f"{path}: no such file.{did_you_mean(path.name, others)}"]) from None
    except UnicodeDecodeError:
        raise JobError([f"{path}: is not a text file in UTF-8"]) from None
    except OSError as error:
        raise JobError([f"{path}: cannot be read: {error.strerror}"]) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        context = f" {error.context}" if error.context else ""
        raise JobError([f"{path}{line}: {error.problem or 'is no YAML'}{context}"]) from None
    except (yaml.YAMLError, RecursionError) as error:
        raise JobError([f"{path}: is no YAML: {error}"]) from None
    if not isinstance(data, dict):
        raise JobError([f"{path}: must hold keys and values, such as 'analysis: inverse'"])
    return data
