"""Options that several commands have, and types of their values."""

import argparse
from collections.abc import Callable
from pathlib import Path


def positive(text: str) -> int:
    """Return a whole number that is 1 or more."""
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return number


def port(text: str) -> int:
    """Return the number of a TCP port; 0 stands for any free one."""
    if not 0 <= (number := int(text)) <= 65535:
        raise argparse.ArgumentTypeError("must be 0 to 65535")
    return number


def file_ending(*suffixes: str) -> Callable[[str], Path]:
    """Return the type of files whose names end with one of the suffixes."""

    def path(text: str) -> Path:
        if not text.endswith(suffixes):
            raise argparse.ArgumentTypeError(f"'{text}' must end with {' or '.join(suffixes)}")
        return Path(text)

    return path


def add_ranks(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ranks",
        type=int,
        metavar="N",
        help="refuse to run on another number of ranks (a launcher can start N runs of one)",
    )
