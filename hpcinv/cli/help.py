"""Help texts of commands: one sentence, examples, and the page of the documentation."""

import argparse
from typing import Any


def add_command(commands: Any, name: str, sentence: str, *, examples: str, page: str) -> argparse.ArgumentParser:
    """Add the parser of a command.

    Args:
        commands: sub-parsers of the command line, or of a command with actions.
        sentence: what the command does, with a full stop.
        examples: lines to type, one for each example.
        page: page of the documentation, as a path in ``docs``.
    """
    lines = "\n".join(f"  {line}" for line in examples.strip().splitlines())
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=sentence[0].lower() + sentence[1:].removesuffix("."),
        description=sentence,
        epilog=f"examples:\n{lines}\n\nmore: docs/{page}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser
