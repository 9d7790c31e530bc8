"""Command line: ``python -m hpcinv run | resume | study | sweep | mesh | …``; ``--help`` lists them all."""

from hpcinv.parallel.signals import end_if_noted, note_while_starting

if __name__ == "__main__":
    note_while_starting()  # before the slow imports below

import argparse
import io
import sys
import time

from hpcinv.errors import HpcinvError, OutOfMemory, OutputError
from hpcinv.parallel.early_exit import ProvenEnd, refuse_exit_without_end
from hpcinv.parallel.home import require_working_directory
from hpcinv.parallel.imports import imports_at_start, imports_explained, is_other_rank
from hpcinv.parallel.signals import CLOSED_OUTPUT, discard_output
from hpcinv.version import __version__

with imports_at_start():
    from hpcinv.cli.compare import add_compare
    from hpcinv.cli.compile import add_compile
    from hpcinv.cli.explain import add_explain
    from hpcinv.cli.export import add_export
    from hpcinv.cli.fit import add_fit
    from hpcinv.cli.identify import add_identify
    from hpcinv.cli.laws import add_laws
    from hpcinv.cli.mesh import add_mesh
    from hpcinv.cli.new import add_new
    from hpcinv.cli.report import add_report
    from hpcinv.cli.run import add_run
    from hpcinv.cli.show import add_show
    from hpcinv.cli.study import add_study, complete_action
    from hpcinv.cli.sweep import add_sweep
    from hpcinv.cli.validate import add_validate
    from hpcinv.files.untrusted import asked_for

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
    """Run one command and return its exit code; without arguments, those of this process, which ends with it."""
    sys.stdout = sys.stdout or io.StringIO()  # it may be closed
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file name may be no text
    options = _parser().parse_args(complete_action(sys.argv[1:] if arguments is None else arguments))
    end = ProvenEnd() if arguments is None and options.is_proven else None
    child = end.start() if end else 0
    if arguments is None and not child:
        refuse_exit_without_end()
    end_if_noted()
    try:
        if end and child:
            return end.wait(child)
        require_working_directory()
        with imports_explained(), asked_for(options):
            code: int = options.command(options)
        if sys.stdout:  # code of the job may have removed it
            sys.stdout.flush()
        if end:
            end.prove()
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
        print(f"{error.filename or 'standard output'}: cannot be written or read: {error.strerror}", file=sys.stderr)
        return OutputError.exit_code
    except KeyboardInterrupt:
        return 130
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hpcinv",
        description="Find the undeformed shape of a soft body from its deformed one.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.set_defaults(is_proven=False)
    commands = parser.add_subparsers(required=True, metavar="command")
    for add in (
        add_new,
        add_run,
        add_study,
        add_sweep,
        add_validate,
        add_explain,
        add_show,
        add_report,
        add_export,
        add_laws,
        add_fit,
        add_identify,
        add_mesh,
        add_compare,
        add_compile,
    ):
        add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
