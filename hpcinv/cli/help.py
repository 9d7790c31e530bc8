"""Help texts of commands: one sentence, examples, and the page of the documentation."""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any


class CommandParser(argparse.ArgumentParser):
    """Parser of a command, which refuses unknown arguments itself: with its own usage and the nearest options."""

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> tuple[Any, list[str]]:  # type: ignore[override]
        """Parse arguments as ``ArgumentParser`` does; exits with code 2 if there are unknown ones."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            hints = "".join(dict.fromkeys(self._hints(unknown)))
            self.error(f"unrecognized arguments: {' '.join(unknown)}{f'.{hints}' if hints else ''}")
        return options, []

    def _hints(self, unknown: Sequence[str]) -> Iterator[str]:
        from hpcinv.base.quantity.suggestions import did_you_mean

        names = [option[2:] for option in self._option_string_actions if option.startswith("--")]
        for argument in unknown:
            if argument.startswith("--"):
                yield did_you_mean(argument[2:].partition("=")[0], names, list_all=False).replace("'", "'--", 1)


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
