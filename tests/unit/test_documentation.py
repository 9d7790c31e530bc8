"""What README and docs refer to is there: files, headings, commands and their options; jobs in them are valid."""

import argparse
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.schemas import refusals

from hpcinv.__main__ import _parser, complete_action
from hpcinv.job.job import Job, parse
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.physics.effects import effects
from hpcinv.studies.study.study_plan import load_study
from hpcinv.studies.sweep.sweep_plan import load_sweep

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("**/*.md")]


def anchor(heading: str) -> str:
    """The fragment by which a heading is linked."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading.strip().lower())
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


def headings(page: Path) -> set[str]:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return {anchor(heading) for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)}


def wrong_links(page: Path) -> Iterator[str]:
    """Links of a page to files and headings that are not there."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        file, _, fragment = target.partition("#")
        path = page.parent / file if file else page
        if not path.exists() or (fragment and fragment not in headings(path)):
            yield f"{page.relative_to(ROOT)}: {target}"


def test_links_lead_somewhere() -> None:
    assert not [link for page in PAGES for link in wrong_links(page)]


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Parsers of the actions of a command, by name."""
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {} if not actions else dict(actions[0].choices)


def commands(page: Path, whole: argparse.ArgumentParser) -> Iterator[tuple[argparse.ArgumentParser, str]]:
    """The parsers of the commands that a page gives, and the rest of each line."""
    for line in page.read_text().splitlines():
        for typed in re.findall(r"(?:python -m |uv run )hpcinv ([^`\n|#…]*)", line):
            parser, said = whole, complete_action(typed.split())
            while said and (inner := subcommands(parser)):
                assert said[0] in inner, f"{page.name}: {typed}"
                parser = inner[said.pop(0)]
            yield parser, " ".join(said)


def test_commands_and_options_exist() -> None:
    whole = _parser()
    for parser, rest in (command for page in PAGES for command in commands(page, whole)):
        known = {option for action in parser._actions for option in action.option_strings}
        # Options behind another program are its own.
        for option in re.findall(r"(?<!\S)(--[a-z][a-z-]+)", rest.split("&&")[0]):
            assert option in known, f"{parser.prog} has no {option}: {rest}"


def test_the_readme_fits_on_two_screens() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) <= 140
    assert max(map(len, lines)) <= 120


def every_command(parser: argparse.ArgumentParser, names: tuple[str, ...] = ()) -> Iterator[Any]:
    for name, inner in subcommands(parser).items():
        yield pytest.param(inner, id=" ".join((*names, name)))
        yield from every_command(inner, (*names, name))


@pytest.mark.parametrize("parser", list(every_command(_parser())))
def test_help_has_a_sentence_examples_and_a_page(parser: argparse.ArgumentParser) -> None:
    """`hpcinv.cli.help.add_command` makes such a parser."""
    assert re.fullmatch(r"[A-Z][^.]*(\.\S[^.]*)*\.", parser.description or ""), "one sentence"
    examples, _, page = (parser.epilog or "").partition("more: docs/")
    assert (ROOT / "docs" / page.strip()).is_file()
    typed = [shlex.split(line) for line in examples.splitlines() if re.match(r" *(mpirun -n \d+ )?hpcinv ", line)]
    assert typed
    for words in typed:
        arguments = words[words.index("hpcinv") + 1 :]
        names = parser.prog.split()[1:]
        assert arguments[: len(names)] == names
        redirected = arguments.index(">") if ">" in arguments else None
        _parser().parse_args(complete_action(arguments[:redirected]))


def test_generated_pages_are_what_the_generator_writes() -> None:
    command = [sys.executable, str(ROOT / "docs" / "generate.py"), "--check"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stdout + ended.stderr + "run: python3 -m uv run python docs/generate.py"


def test_outputs_that_pages_show_are_of_scripts_and_tests_that_exist() -> None:
    kept = list((ROOT / "docs").glob("**/printed/*.txt"))
    assert kept
    for file in kept:
        command = file.read_text().splitlines()[0]
        program = r"(?:(?:mpirun -n \d )?python|pytest -n 0 (?:-m '' )?-s)"
        named = re.match(rf"\$ python3 -m uv run {program} (?:(\S+\.py)|-m (\S+))", command)
        assert named, file
        assert (ROOT / (named[1] or f"{named[2].replace('.', '/')}.py")).is_file(), command


def sweeps_and_studies() -> list[Any]:
    """Sweep and study files in all pages."""
    blocks = []
    for page in PAGES:
        for number, block in enumerate(re.findall(r"^```yaml\n(.*?)^```", page.read_text(), re.M | re.S), start=1):
            if re.match(r"(sweep|study):", block):
                blocks.append(pytest.param(block, id=f"{page.relative_to(ROOT)}:{number}"))
    return blocks


@pytest.mark.parametrize("block", sweeps_and_studies())
def test_sweeps_and_studies_in_the_pages_are_valid(block: str, tmp_path: Path) -> None:
    """Their jobs belong to the project."""
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs")
    file = tmp_path / "jobs" / "of-a-page.yaml"
    file.write_text(block)
    assert refusals(read_yaml(file)) == []
    plan: Any = load_sweep(file) if block.startswith("sweep:") else load_study(file)
    assert plan.cases if block.startswith("sweep:") else plan.runs


def fragments() -> Iterator[Any]:
    """The parts of jobs in all pages, and whether they name files that only the reader has."""
    for page in PAGES:
        matches = re.findall(
            r"^(<!-- with files of the reader -->\n)?(?:<!-- file: \S+ -->\n)?( *)```yaml\n(.*?)^ *```",
            page.read_text(),
            re.M | re.S,
        )
        for number, (mark, _, block) in enumerate(matches, start=1):
            if not re.match(r" *(sweep|study):", block):
                yield pytest.param(textwrap.dedent(block), bool(mark), id=f"{page.relative_to(ROOT)}:{number}")


@pytest.mark.parametrize(("block", "has_files"), list(fragments()))
def test_jobs_in_the_pages_are_valid(block: str, has_files: bool, tmp_path: Path) -> None:
    """A fragment is completed by a body of its own, and by families of fibres of the names that it refers to."""
    file = tmp_path / "job.yaml"
    file.write_text(block)
    fragment = read_yaml(file)
    assert fragment.keys() <= Job.model_fields.keys()
    if has_files:
        return
    box = {"file": "../meshes/box.py", "parameters": {"nx": 1, "ny": 1, "nz": 1}}
    gravity = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000.0, "density_in": "reference"}
    sheet = {"file": "../meshes/sheet.py", "shell": {"thickness": "1 mm"}}
    is_of_shell = any(effects()[effect["effect"]].only_of_kind for effect in fragment.get("effects", ()))
    body = sheet if is_of_shell else box
    whole = {"mesh": body, "material": {"law": "neo-hookean", "young": "1 kPa", "poisson": 0.3}, **fragment}
    if not any((ROOT / "jobs" / str(whole["mesh"].get(key))).exists() for key in ("file", "image")):
        whole["mesh"] = body  # the file stands for one of the reader
    family = {"direction": [1, 0, 0], "given_on": "reference"}
    named = ("fibre", "fibres", "sheet", "fibre1", "fibre2", "radial", "hoop", "axial")
    whole["fibres"] = dict.fromkeys(named, family) | whole.get("fibres", {})
    whole.setdefault("supports", [{"region": "x0", "fix": ["x", "y", "z"]}])
    if "states" not in whole:
        whole.setdefault("effects", [gravity])
    parse(whole, ROOT / "jobs" / "fragment.yaml")
    assert refusals(whole) == []
