"""What README and docs refer to is there: files, headings, commands and their options."""

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from hpcinv.__main__ import _parser
from hpcinv.cli.study import with_action

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("**/*.md")]


def anchor(heading: str) -> str:
    """The fragment by which a heading is linked."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading.strip().lower())
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


def headings(page: Path) -> set[str]:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return {anchor(heading) for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        file, _, fragment = target.partition("#")
        path = page.parent / file if file else page
        assert path.exists(), target
        assert not fragment or fragment in headings(path), target


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Parsers of the actions of a command, by name."""
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {} if not actions else dict(actions[0].choices)


def commands(page: Path) -> Iterator[tuple[argparse.ArgumentParser, str]]:
    """The parsers of the commands that a page tells to type, and the rest of each line."""
    for line in page.read_text().splitlines():
        for typed in re.findall(r"(?:python -m |uv run )hpcinv ([^`\n|#…]*)", line):
            parser, said = _parser(), with_action(typed.split())
            while said and (inner := subcommands(parser)):
                assert said[0] in inner, f"{page.name}: {typed}"
                parser = inner[said.pop(0)]
            yield parser, " ".join(said)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_and_options_exist(page: Path) -> None:
    for parser, rest in commands(page):
        known = {option for action in parser._actions for option in action.option_strings}
        # Options behind another program are its own.
        for option in re.findall(r"(?<!\S)(--[a-z][a-z-]+)", rest.split("&&")[0]):
            assert option in known, f"{parser.prog} has no {option}"


def test_the_readme_fits_on_two_screens() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 160
