"""Reference pages, gallery and verification, from registries, schema, command line, jobs, and what tests printed.

``python3 -m uv run python docs/generate.py`` writes the pages, with ``--check`` it compares them with the files.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import verification_table
import yaml

from hpcinv import __main__ as command_line
from hpcinv import errors
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import ARITHMETIC, members_of, metadata_in
from hpcinv.base.quantity.spatial_fields import VaryingQuantity
from hpcinv.cli.formula_guide import OPERATORS, PLACES, varying
from hpcinv.job.combinations import PARTS, REFUSED
from hpcinv.job.fibre_rules import FibreRule
from hpcinv.job.job import Job, json_schema
from hpcinv.output import run_report  # noqa: F401  (registers topics of lines)
from hpcinv.physics.closures import CLOSURES
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import MaterialLaw, laws
from hpcinv.physics.materials.isochoric import DILATATIONS
from hpcinv.physics.materials.moduli import Moduli
from hpcinv.solver.diagnosis import Diagnosis
from hpcinv.studies.study.study_spec import Study
from hpcinv.studies.sweep.sweep_spec import Sweep
from hpcinv.trust.certificate import TOPICS

DOCS = Path(__file__).parent
ROOT = DOCS.parent
NOTE = "<!-- Written by docs/generate.py: do not edit. -->"
COLUMNS = 3
"""of the gallery; more make thumbnails smaller"""
EXIT_CODES = {
    0: "success",
    1: "internal error",
    6: "the certificate fails",
    7: "the certificate has warnings or is not decided, with `--strict`",
    130: "Ctrl-C",
    141: "the output was closed",
}
INTERFACE = {
    "hpcinv": ("load", "run", "sweep"),
    "hpcinv.job.job": ("Job",),
    "hpcinv.output.result": ("Result",),
    "hpcinv.results.solution": ("Solution",),
    "hpcinv.studies.sweep.sweep_interface": ("Table",),
}


def pages() -> dict[Path, str]:
    """Return the text of each page by its path."""
    found = {
        "reference/laws.md": _laws(),
        "reference/effects.md": _effects(),
        "reference/job-keys.md": _job_keys(),
        "reference/batch-keys.md": _batch_keys(),
        "reference/functions.md": _functions(),
        "reference/commands.md": _commands(),
        "reference/combinations.md": _combinations(),
        "reference/closures.md": _closures(),
        "reference/exit-codes.md": _exit_codes(),
        "reference/certificate-lines.md": _certificate_lines(),
        "reference/api.md": _api(),
        "how-to/when-a-solve-fails.md": _failures(),
        "gallery.md": _gallery(),
        "verification/index.md": verification_table.page(),
    }
    return {DOCS / name: f"{NOTE}\n\n" + "\n".join(lines).strip() + "\n" for name, lines in found.items()}


def _laws() -> Iterator[str]:
    members = laws()
    yield "# Material laws"
    yield ""
    yield from _prose(
        """
        `ψ` is the energy per reference volume. The formulas are in the syntax of the law [formula](#formula),
        with the invariants of `C = FᵀF`: `I1`, `I2`, `J`, `I1_bar` and `I2_bar` of `J^(-2/3) C`,
        `I4_f = a0·C a0`, `I5_f = a0·C² a0` and `I8_f_s = a0·(C -
        I) b0` of families of fibres. The plots show the nominal stress of the values in the example: of a law
        without fibres in uniaxial, equibiaxial and planar tension; of a law with fibres, taken as
        incompressible, in uniaxial tension along its first family and normal to all of them.
        """
    )
    yield ""
    yield from _table(("law", "for"), [(f"[`{name}`](#{name})", _summary(law)) for name, law in members.items()])
    yield ""
    yield "## Volumetric energies"
    yield ""
    yield "A law with the key `volumetric` adds one of these; `kappa: incompressible` prescribes J = 1 instead."
    yield ""
    yield from _table(("`volumetric`", "energy"), [(f"`{n}`", f"`{energy}`") for n, (energy, _) in DILATATIONS.items()])
    for name, law in members.items():
        yield from _component(name, law, "law")
        yield "```{stress-plot} " + name
        yield "```"
        yield ""


def _effects() -> Iterator[str]:
    members = effects()
    yield "# Effects"
    yield ""
    yield "Loads and inelastic strains. Each serves forward and inverse analyses."
    yield ""
    yield from _table(
        ("effect", "what it does"), [(f"[`{name}`](#{name})", _summary(e)) for name, e in members.items()]
    )
    for name, effect in members.items():
        yield from _component(name, effect, "effect")


def _component(name: str, kind: type[Ingredient], tag: str) -> Iterator[str]:
    """Yield the section on a law or an effect."""
    yield ""
    yield f"## {name}"
    yield ""
    yield from _docstring(kind)
    example = kind.model_validate(kind.example)
    if isinstance(example, MaterialLaw):
        yield "```text"
        yield from textwrap.wrap(f"ψ = {example.energy_formula}", 88, break_long_words=False, subsequent_indent="    ")
        yield "```"
        yield ""
    rows = []
    for key in sorted(kind.model_fields, key=lambda key: key not in kind.__annotations__):  # inherited ones last
        if key != tag:
            info = kind.model_fields[key]
            quantity = metadata_in(Quantity, info.annotation, *info.metadata)
            notes = [quantity.bounds] if quantity is not None and quantity.bounds else []
            notes += ["may vary over the body"] if isinstance(quantity, VaryingQuantity) else []
            meaning = meanings(kind).get(key, "") + (f" ({'; '.join(notes)})" if notes else "")
            default = "needed" if info.is_required() else "" if info.default in (None, {}) else _code(info.default)
            rows.append((f"`{key}`", "" if quantity is None else quantity.unit or "1", default, meaning))
    yield from _table(("key", "unit", "default", "meaning"), rows)
    yield ""
    if issubclass(kind, MaterialLaw):
        match kind.replaceable:
            case (str(shear), bulk):
                offered = ", ".join(f"`{name}`" for name in Moduli.model_fields)
                yield f"Instead of `{shear}` and `{bulk}` a job may give any two of the elastic moduli {offered}."
                yield ""
            case (None, bulk):
                yield f"Instead of `{bulk}` a job may give `poisson` or `lame`."
                yield ""
    section = {"material": kind.example} if tag == "law" else {"effects": [kind.example]}
    yield "```yaml"
    yield yaml.safe_dump(section, sort_keys=False, default_flow_style=None, width=88, allow_unicode=True).rstrip()
    yield "```"
    yield ""
    if issubclass(kind, MaterialLaw) and kind.starting_values:
        yield "Starting values:"
        yield ""
        for material, values in kind.starting_values.items():
            text = yaml.safe_dump(dict(values.parameters), sort_keys=False, default_flow_style=True, width=1000).strip()
            yield f"- {material} ({values.of}): `{text}`. Source: {_linked(values.source)}."
        yield ""


def _job_keys() -> Iterator[str]:
    yield "# Keys of a job"
    yield ""
    yield from _prose(
        """
        All keys of a job file. `hpcinv schema` prints the same as JSON Schema, for editors. Quantities are
        numbers in SI or have a unit ([units](units.md)). Laws and effects have pages of their own:
        [laws](laws.md), [effects](effects.md).
        """
    )
    yield ""
    yield from _keys(json_schema(Job))


def _batch_keys() -> Iterator[str]:
    yield "# Keys of sweeps and studies"
    yield ""
    yield from _prose(
        """
        All keys of the files of a [sweep](../how-to/sweep.md) and a [study](../how-to/study.md). `hpcinv schema sweep`
        and `hpcinv schema study` print the same as JSON Schema. Values are set by dotted keys of the
        [job](job-keys.md), such as `effects[0].density`, or as whole sections.
        """
    )
    for kind in (Sweep, Study):
        yield ""
        yield f"## {kind.__name__.lower()}"
        yield ""
        yield from _keys(json_schema(kind), f"{kind.__name__.lower()}: ")


def _keys(schema: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the tables of the keys of a file and of its sections."""
    definitions = schema["$defs"]
    yield from _table(("key", "value", "default", "meaning"), _rows(schema, definitions))
    for section, name in _sections(schema, definitions).items():
        yield ""
        yield f"## {prefix}{section}"
        yield ""
        part = _object(definitions[name])
        yield _linked(" ".join(part.get("description", "").split())).replace("``", "`")
        yield ""
        yield from _table(("key", "value", "default", "meaning"), _rows(part, definitions))
        if section == "fibres":
            yield from _fibre_rules()


def _fibre_rules() -> Iterator[str]:
    for name, rule in members_of(FibreRule, "kind").items():
        schema = rule.model_json_schema()
        yield ""
        yield f"### rule: {name}"
        yield ""
        yield from _docstring(rule)
        yield from _table(("key", "value", "default", "meaning"), _rows(schema, schema.get("$defs", {})))


def _sections(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, str]:
    """Return the names of the definitions that keys of a job refer to, by heading."""
    found: dict[str, str] = {}
    for key, value in schema["properties"].items():
        for name in re.findall(r"'\$ref': '#/\$defs/(\w+)'", str(value)):
            is_section = key not in ("material", "effects") and "properties" in _object(definitions[name])
            if is_section and name not in found.values():
                found[f"{key}[]" if value.get("type") == "array" else key] = name
    for section, part in list(found.items()):
        for key, value in _object(definitions[part])["properties"].items():
            for name in re.findall(r"'\$ref': '#/\$defs/(\w+)'", str(value)):
                if "properties" in _object(definitions[name]) and name not in found.values():
                    found[f"{section}.{key}"] = name
    return found


def _object(part: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the mapping among the alternatives of a definition."""
    return next((p for p in (part, *part.get("anyOf", ())) if "properties" in p), part)


def _rows(part: Mapping[str, Any], definitions: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for key, value in part["properties"].items():
        needed = key in part.get("required", ())
        default = value.get("default")
        text = "needed" if needed else "" if default in (None, [], {}) or isinstance(default, dict) else _code(default)
        text = "`m`" if (key, default) == ("unit", 1) else text
        yield f"`{key}`", _kind(key, value, definitions), text, _linked(" ".join(value.get("description", "").split()))


def _kind(key: str, value: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Return in words which values a schema takes."""
    if key == "material":
        return "[law](laws.md)"
    if key == "effects":
        return "list of [effects](effects.md)"
    if "$ref" in value:
        part = definitions[value["$ref"].rsplit("/", 1)[1]]
        return _kind("", part, definitions) if "properties" not in _object(part) else "mapping, below"
    if "enum" in value:
        return ", ".join(_code(v) for v in value["enum"])
    if "const" in value:
        return _code(value["const"])
    if "anyOf" in value or "oneOf" in value:
        choices = [v for v in value.get("anyOf", value.get("oneOf")) if v.get("format") != ARITHMETIC]
        kinds = dict.fromkeys(_kind("", v, definitions) for v in choices)
        kinds.pop("null", None)
        if {"number", "text"} <= kinds.keys():
            kinds = {"quantity": None, **{k: None for k in kinds if k not in ("number", "text")}}
        return " or ".join(kinds)
    match value.get("type"):
        case "array" if "prefixItems" in value:
            return f"list of {len(value['prefixItems'])}"
        case "array":
            return f"list of: {_kind('', value.get('items', {}), definitions)}"
        case "object" if isinstance(value.get("additionalProperties"), dict):
            return f"mapping of names to: {_kind('', value['additionalProperties'], definitions)}"
        case "object" | None:
            return "mapping"
        case "string":
            return "text"
        case "boolean":
            return "`true` or `false`"
        case list() as types:
            return "text, number, `true` or `false`" if "boolean" in types else "formula"
        case kind:
            bounds = [f"{sign} {value[key]}" for key, sign in _BOUNDS.items() if key in value]
            return str(kind) + (f" {' and '.join(bounds)}" if bounds else "")


_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def _functions() -> Iterator[str]:
    yield "# Functions and names of formulas"
    yield ""
    yield "What [formulas](formulas.md) may contain; `hpcinv formulas` prints the same."
    yield ""
    yield f"Operators: `{OPERATORS}`. Numbers are SI, or have a unit each, such as `4.25 mm` or `963 kg/m^3`."
    yield f"Constants: {', '.join(f'`{name}` = {value:.16g}' for name, value in CONSTANTS.items())}."
    yield ""
    rows = [(f"`{name}`", str(f.arguments or "2 or more"), f.meaning) for name, f in FUNCTIONS.items()]
    yield from _table(("function", "values", "meaning"), rows)
    yield ""
    yield "## Names"
    yield ""
    yield from _table(
        ("place in a job", "its value", "names"),
        [(f"`{p.field}`", p.value, ", ".join(n if " " in n else f"`{n}`" for n in p.names)) for p in PLACES],
    )
    yield ""
    yield "## Quantities that may vary over the body"
    yield ""
    rows = []
    for kind, members in (("law", laws()), ("effect", effects())):
        rows += [(kind, f"[`{n}`]({kind}s.md#{n})", ", ".join(f"`{k}`" for k in keys)) for n, keys in varying(members)]
    yield from _table(("", "name", "keys"), rows)


def _commands() -> Iterator[str]:
    parser = command_line._parser()
    yield "# Commands"
    yield ""
    yield from _prose(
        """
        `hpcinv` and the name of a command, or `python -m hpcinv …`; `--help` of each says what follows. [Exit
        codes](exit-codes.md) are the same for all.
        """
    )
    for command in _leaves(parser):
        yield ""
        yield f"## {command.prog}"
        yield ""
        yield command.description or ""
        yield ""
        text, _, page = (command.epilog or "").partition("\n\nmore: docs/")
        yield "```text"
        yield textwrap.dedent(text.removeprefix("examples:\n")).rstrip()
        yield "```"
        yield ""
        if page:
            yield f"More: [{page}](../{page})."
            yield ""
        rows = []
        for action in command._actions:
            if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
                value = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
                choices = " | ".join(map(str, action.choices)) if action.choices else value
                takes = "" if action.nargs == 0 else f" {choices}"
                names = (
                    ", ".join(action.option_strings) + takes if action.option_strings else action.metavar or action.dest
                )
                meaning = (action.help or "") % {"default": action.default, "prog": command.prog}
                rows.append(
                    (f"`{names}`", meaning + (" (needed)" if action.required and action.option_strings else ""))
                )
        if rows:
            yield from _table(("argument", "meaning"), rows)


def _leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield the parsers of commands that do something."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in inner:
        for child in action.choices.values():
            yield from _leaves(child)
    if not inner:
        yield parser


def _exit_codes() -> Iterator[str]:
    kinds = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, errors.HpcinvError)]
    found = dict(EXIT_CODES)
    for code in sorted({kind.exit_code for kind in kinds} - found.keys()):
        texts = [
            (inspect.getdoc(k) or "").split("\n")[0].split(";")[0].removesuffix(".")
            for k in kinds
            if k.exit_code == code
        ]
        found[code] = "; ".join(text[:1].lower() + text[1:] for text in sorted(texts))
    yield "# Exit codes"
    yield ""
    yield from _prose(
        """
        Of every command, on all ranks. Errors are one message on standard error, which names the file, the
        place in it and what to do.
        """
    )
    yield ""
    yield from _table(("code", "meaning"), [(str(code), found[code].replace("``", "`")) for code in sorted(found)])


def _combinations() -> Iterator[str]:
    yield "# Combinations"
    yield ""
    yield from _prose(
        """
        Parts of a job that it cannot have together. The others meet: a test solves pairs of them on a few cells, and
        finds each refusal here.
        """
    )
    yield ""
    rows = [
        (PARTS[name].title, PARTS[other].title, text) for name, row in REFUSED.items() for other, text in row.items()
    ]
    yield from _table(("part", "not with", "message, after its place"), sorted(rows))


def _closures() -> Iterator[str]:
    yield "# Closures"
    yield ""
    yield from _prose(
        """
        A deformed shape does not determine its contact pressure. A `closure` of an
        [interface](../how-to/interfaces.md#contact-on-a-given-shape) or of a
        [contact](../how-to/contact.md#a-given-shape-on-an-obstacle) says what is assumed.
        """
    )
    yield ""
    words = {"without": "no", "with": "needed", "both": "possible"}
    rows = [
        (
            f"`{name}`",
            kind.assumes.replace("'", "`"),
            ", ".join(f"`{key}`" for key in kind.keys),
            words[kind.friction],
            f"no: {kind.leaves_open}" if kind.leaves_open else "yes",
        )
        for name, kind in CLOSURES.items()
    ]
    head = ("`closure`", "the pressure is the one for which", "keys", "`friction`", "may hold a part alone")
    yield from _table(head, rows)


def _failures() -> Iterator[str]:
    yield "# What to do when a solve fails"
    yield ""
    yield "![A thick sphere where its solve stopped, and the given one](../pictures/failed.png)"
    yield ""
    yield "`hpcinv run jobs/hard/sphere-beyond-its-limit.yaml` ends with exit code 3 and says"
    yield ""
    yield "```"
    yield "stopped at load factor 0.685693 of 1: elements of the undeformed shape would invert or collapse"
    yield "  After 4 failed steps: to first order the load moves the body by 888 mm, most at (0.962, 0.192, 0.192) m;"
    yield "  65% of it is rigid: it is nearly free to move along (0.58, 0.58, 0.58)"
    yield "```"
    yield ""
    yield from _prose(
        """
        `status` and `advice` in [summary.json](../reference/summary.md) say the same. A run that reaches its load ends
        with a certificate, whose lines may fail too ([below](#when-the-certificate-does-not-pass)).
        """
    )
    yield ""
    yield "## Look first"
    yield ""
    yield from (
        "1. at the line `meshed part:`, with size, mass and load: is a"
        " [unit](../reference/units.md#size-mass-and-load) wrong?",
        "2. at the picture of the job, `hpcinv show job.yaml`: supports, loads and their directions;",
        "3. at the body where it stopped: `hpcinv show results/job`, or its [report](report.md).",
    )
    yield ""
    yield "## By diagnosis"
    yield ""
    yield from _prose(
        """
        A run has halved its load steps and tried its [rescue strategies](hard-cases.md) before it gives up, so smaller
        steps alone seldom help. Failed solves may take 500 factorizations in each direction
        (`solver: {patience: 500}`).
        """
    )
    yield ""
    yield from _table(("it says", "what to do"), [(kind.text, kind.advice) for kind in Diagnosis])
    yield ""
    yield "## When the certificate does not pass"
    yield ""
    yield from _prose(
        """
        A line that does not pass says what was seen, and below it what to do.
        [The lines](../reference/certificate-lines.md) have meanings and thresholds; more is on
        [stability](../theory/stability.md#the-verdicts) and
        [limit points](../theory/newton.md#limit-points).
        """
    )
    yield ""
    rows = [(topic.name, topic.remedy) for _, topic in sorted(TOPICS.items()) if topic.remedy]
    yield from _table(("line", "what to do"), rows)


def _certificate_lines() -> Iterator[str]:
    yield "# Lines of the certificate"
    yield ""
    yield from _prose(
        """
        Errors are relative to the largest displacement. [The certificate](../how-to/certificate.md) explains verdicts
        and levels, and [what to do](../how-to/when-a-solve-fails.md#when-the-certificate-does-not-pass) is on a page of
        its own.
        """
    )
    yield ""
    rows = [(t.name, t.meaning, t.computed, t.thresholds, t.costs) for _, t in sorted(TOPICS.items())]
    yield from _table(("line", "what it means", "what is computed", "warning; fail", "costs"), rows)


def _api() -> Iterator[str]:
    yield "# Python interface"
    yield ""
    yield from _prose(
        """
        What `import hpcinv` offers, and what its functions return. Quantities are in SI units. [From
        Python](python.md) has an example.
        """
    )
    for module, names in INTERFACE.items():
        for name in names:
            member = getattr(importlib.import_module(module), name)
            yield ""
            yield f"## {'hpcinv' if name == 'Job' else module}.{name}"
            yield ""
            if not inspect.isclass(member):
                member = (
                    member
                    if isinstance(member, FunctionType)
                    else importlib.import_module("hpcinv.studies.sweep.sweep_interface").sweep
                )
                yield from _signature(member, name)
                yield from _docstring(member)
                continue
            yield from _docstring(member)
            for key, attribute in vars(member).items():
                of = attribute.fget if isinstance(attribute, property) else attribute
                if key.startswith(("_", "model_")) or not inspect.isfunction(of) or not inspect.getdoc(of):
                    continue
                yield f"### {name}.{key}"
                yield ""
                yield from _signature(of, key, is_property=isinstance(attribute, property))
                yield from _docstring(of)


def _signature(function: Any, name: str, *, is_property: bool = False) -> Iterator[str]:
    signature = inspect.signature(function)
    shown = [
        p.replace(default=_Default(p.default)) if p.default is not p.empty else p for p in signature.parameters.values()
    ]
    text = str(signature.replace(parameters=[p for p in shown if p.name != "self"])).replace("'", "")
    yield "```python"
    if is_property:
        yield f"{name}: {text.partition('-> ')[2]}"
    else:
        yield f"{name}{text}"
    yield "```"
    yield ""


class _Default:
    """A default value as it is written."""

    def __init__(self, value: Any) -> None:
        is_plain = isinstance(value, str | int | float | bool | tuple | None)
        self._text = repr(value) if is_plain else "…"

    def __repr__(self) -> str:
        return self._text


def _docstring(of: Any) -> Iterator[str]:
    """Yield a docstring in Markdown; sections such as ``Args:`` become lists."""
    section = False
    for line in (inspect.getdoc(of) or "").replace("``", "`").splitlines():
        text = _linked(line)
        if re.fullmatch(r"[A-Z]\w+:", text):
            section = text not in ("Returns:", "Example:")
            yield f"**{text[:-1]}**"
            yield ""
        elif section and (match := re.match(r"    (\w[\w, *]*): (.*)", text)):
            yield f"- `{match[1]}`: {match[2]}"
        elif text.startswith("    "):
            yield f"  {text.strip()}" if section else text.strip()
        else:
            yield text
    yield ""


def _gallery() -> Iterator[str]:
    """Yield thumbnails in columns, then the jobs without a picture."""
    drawn: list[str] = []
    others: list[tuple[str, ...]] = []
    for path in sorted((ROOT / "jobs").glob("*.yaml")):
        head = [line[2:] if line.startswith("# ") else line[1:] for line in _comment(path.read_text())]
        fields = dict(re.findall(r"^(Command|Run time) +(.*(?:\n {3,}.*)*)", "\n".join(head), re.MULTILINE))
        if "Command" not in fields:
            continue
        question = " ".join(" ".join(head).split("Shows")[0].split("Equations")[0].split())
        command = f"`{fields['Command'].splitlines()[0]}`"
        time = " ".join(fields.get("Run time", "").split()).partition(" from")[0]
        picture = f"pictures/gallery/{path.stem}.png"
        if (DOCS / picture).exists():
            drawn.append(f"[![{path.stem}]({picture})]({picture})<br>{question}<br>{command}<br>{time}")
        else:
            others.append((question, command, time))
    yield "# Gallery"
    yield ""
    yield from _prose(
        """
        The jobs in `jobs/`, each with its question, its command, and the time from command to prompt on 2 cores with
        compiled kernels (none: not measured). `hpcinv show results/NAME` draws such pictures.
        """
    )
    yield ""
    rows = [drawn[start : start + COLUMNS] for start in range(0, len(drawn), COLUMNS)]
    yield from _table(("",) * COLUMNS, [row + [""] * (COLUMNS - len(row)) for row in rows])
    yield ""
    yield "## Studies, sweeps and large meshes"
    yield ""
    yield from _table(("", "command", "time"), others)


def _comment(text: str) -> list[str]:
    """Return the lines of the comment at the head of a file."""
    lines = text.splitlines()
    return lines[: next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))]


def _prose(text: str) -> list[str]:
    return inspect.cleandoc(text).splitlines()


def _table(head: Sequence[str], rows: Any) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    for row in rows:
        yield f"| {' | '.join(' '.join(_outside_formulas(cell).split()) for cell in row)} |"


def _outside_formulas(cell: str) -> str:
    return cell.replace("|", "\\|")


def _code(value: Any) -> str:
    return f"`{_plain(value)}`"


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_plain(v) for v in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _linked(text: str) -> str:
    """Make DOIs links."""
    return re.sub(
        r"doi:(10\.\d+/[^\s,;]*[^\s,;:.])",
        lambda m: f"[doi:{m[1]}](https://doi.org/{m[1].replace('(', '%28').replace(')', '%29')})",
        text,
    )


def _summary(kind: type) -> str:
    return _linked(" ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())).replace("``", "`")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare with the files, and write nothing")
    check = parser.parse_args().check
    stale = [path for path, text in pages().items() if not path.exists() or path.read_text() != text]
    for path in stale:
        if check:
            print(f"{path.relative_to(ROOT)}: is not what docs/generate.py writes")
    if not check:
        for path, text in pages().items():
            path.write_text(text)
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
