"""Command line: ``python -m hpcinv run | resume | study | sweep | mesh | …``; ``--help`` lists them all."""

from hpcinv.base.parallel.signals import end_if_noted, note_while_starting
from hpcinv.base.parallel.standard_output import explain_output

if __name__ == "__main__":
    note_while_starting()  # before the slow imports below

import argparse
import importlib
import io
import os
import sys
import time
from contextlib import AbstractContextManager

from hpcinv.base.parallel.early_exit import refuse_exit_without_end
from hpcinv.base.parallel.home import require_working_directory
from hpcinv.base.parallel.imports import imports_at_start, imports_explained, is_other_rank, is_text
from hpcinv.base.parallel.signals import CLOSED_OUTPUT, discard_output
from hpcinv.errors import HpcinvError, OutOfMemory, OutputError
from hpcinv.version import __version__

# Pydantic would search all installed packages for plugins of its own.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

COMMANDS = {
    "new": "new",
    "run": "run",
    "resume": "run",
    "study": "study",
    "sweep": "sweep",
    "validate": "validate",
    "schema": "validate",
    "explain": "explain",
    "show": "show",
    "report": "report",
    "dossier": "dossier",
    "export": "export",
    "second-opinion": "second_opinion",
    "laws": "laws",
    "effects": "laws",
    "formulas": "laws",
    "fit": "fit",
    "identify": "identify",
    "serve": "serve",
    "mesh": "mesh",
    "compare": "compare",
    "compile": "compile",
    "completion": "completion",
}
"""module of each command in `hpcinv.cli`, which has a function ``add_MODULE``"""

EPILOG = """examples:
  hpcinv new liver liver.yaml
  mpirun -n 2 hpcinv run liver.yaml
  hpcinv run --help

more: docs/index.md

exit codes: 0 success, 1 internal error, 2 wrong job, mesh or output directory, 3 the load was not reached,
4 no usable checkpoint, 5 a system part is missing, 6 the certificate fails, 7 it has warnings or is
not decided (--strict), 75 stopped by SIGTERM or SIGUSR1 (resume it), 130 Ctrl-C,
141 the output was closed"""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code; without arguments, this process's, which ends with it."""
    sys.stdout = sys.stdout or io.StringIO()  # it may be closed
    explain_output()
    typed = sys.argv[1:] if arguments is None else arguments
    with imports_at_start():
        parser = _parser(*typed[:1])
        if not typed:
            parser.print_help(sys.stderr)
            return 2
        try:
            options = parser.parse_args(complete_action(typed))
        except SystemExit:  # after --help, whose text may wait to be written
            if not _is_written():
                return OutputError.exit_code
            raise
        except OutputError as error:
            print(error, file=sys.stderr)
            return error.exit_code
        from hpcinv.base.files.untrusted import asked_for
    if arguments is None:
        refuse_exit_without_end()
    end_if_noted()
    return _run(options, typed, asked_for(options))


def _run(options: argparse.Namespace, typed: list[str], untrusted: AbstractContextManager[None]) -> int:
    """Run the command of the options; return its exit code, also of an error, which is printed."""
    try:
        require_working_directory()
        if typed[0] != "validate":  # which reports each of its files
            _require_text(typed)
        with imports_explained(), untrusted:
            code: int = options.command(options)
        if sys.stdout:  # code of the job may have removed it
            sys.stdout.flush()
    except HpcinvError as error:
        if is_other_rank():
            time.sleep(1.0)  # some launchers end all ranks when one ends: let rank 0 print first
        else:
            print(error, file=sys.stderr)
        return error.exit_code
    except MemoryError as error:
        print(OutOfMemory.describing(error), file=sys.stderr)
        return OutOfMemory.exit_code
    except BrokenPipeError:
        discard_output()
        return CLOSED_OUTPUT
    except OSError as error:
        print(f"{error.filename or 'a file'}: cannot be written or read: {error.strerror}", file=sys.stderr)
        return OutputError.exit_code
    except KeyboardInterrupt:
        return 130
    return code


def _is_written() -> bool:
    """Return whether all output is written; print why it is not."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        discard_output()
    except OutputError as error:
        print(error, file=sys.stderr)
        return False
    return True


def _require_text(arguments: list[str]) -> None:
    """Raise ``OutputError`` for an argument that is not UTF-8, such as a name of a file from an old system."""
    for argument in arguments:
        if not is_text(argument):
            name = argument.encode(errors="backslashreplace").decode()
            raise OutputError(f"{name}: the name of the file is not UTF-8; rename it")


def complete_action(arguments: list[str]) -> list[str]:
    """Return the arguments of the command line with ``study FILE`` completed to ``study run FILE``."""
    if arguments[:1] != ["study"] or {"run", "status", "-h", "--help"}.intersection(arguments[1:2]):
        return arguments
    return ["study", "run", *arguments[1:]]


def _parser(command: str = "") -> argparse.ArgumentParser:
    """Return the parser of one command, importing its modules only, or of all if there is no such command.

    ``--version`` needs no modules.
    """
    parser = argparse.ArgumentParser(
        prog="hpcinv",
        description="Find the undeformed shape of a soft body from its deformed one.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=__version__)
    if command == "--version":
        return parser
    from hpcinv.cli.help import CommandParser

    commands = parser.add_subparsers(required=True, metavar="command", parser_class=CommandParser)
    is_alone = command in COMMANDS and command != "completion"  # which completes the others
    modules = [COMMANDS[command]] if is_alone else dict.fromkeys(COMMANDS.values())
    for name in modules:
        getattr(importlib.import_module(f"hpcinv.cli.{name}"), f"add_{name}")(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
