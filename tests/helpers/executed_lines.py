"""Which lines of `hpcinv` a process executes, with `sys.monitoring`: loaded at the start of Python, before pytest.

The variable ``HPCINV_TEST_LINES`` names a directory. Processes of pytest ask for the lines of each test
(`helpers.line_recorder`). Others, which tests have started, append their lines to a file there while they run, so that
a killed process loses none. Module and class bodies are left out: they run once in a process, whatever the test.
"""

import os
import sys
from types import CodeType
from typing import Any

DIRECTORY = "HPCINV_TEST_LINES"
"""Environment variable: directory of the records."""
TEST = "PYTEST_CURRENT_TEST"
"""Environment variable that pytest sets, and its children inherit: ``ID (PHASE)``."""
PACKAGE = "/hpcinv/"
_IN_FUNCTION = 0x01
"""CO_OPTIMIZED: the code of a function has it, the body of a module or class has not."""

Lines = dict[str, set[int]]
"""Numbers of lines by the path of the file, from ``hpcinv`` on."""

executed: Lines = {}
"""What was executed since the last `restarted`; empty in a process that writes."""
_names: dict[str, str] = {}
_file = -1


def _started(code: CodeType, _offset: int) -> Any:
    """Watch the lines of a function of the package at its first call."""
    place = code.co_filename.rfind(PACKAGE)
    if place >= 0 and code.co_flags & _IN_FUNCTION:
        _names[code.co_filename] = name = code.co_filename[place + 1 :]
        executed.setdefault(name, set())
        monitoring.set_local_events(monitoring.COVERAGE_ID, code, monitoring.events.LINE)
    return monitoring.DISABLE


def _line(code: CodeType, number: int) -> Any:
    name = _names[code.co_filename]
    if _file < 0:
        executed.setdefault(name, set()).add(number)
    else:
        os.write(_file, b"%s %d\n" % (name.encode(), number))
    return monitoring.DISABLE


monitoring = sys.monitoring


def restarted() -> Lines:
    """Return the lines executed since the last call, and forget them."""
    global executed
    lines, executed = executed, {}
    monitoring.restart_events()
    return {name: numbers for name, numbers in lines.items() if numbers}


def _write_for_test() -> None:
    """Write from now on, for the test that the environment names; a fork of a process has the lines of its own."""
    global _file
    test = os.environ.get(TEST, "").rpartition(" (")[0]
    if test:
        path = os.path.join(os.environ[DIRECTORY], f"{os.getpid()}.lines")  # noqa: PTH118 (pathlib is loaded late)
        _file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        os.write(_file, f"\n{test}\n".encode())


def start() -> None:
    """Begin, in any process that has the variable."""
    monitoring.use_tool_id(monitoring.COVERAGE_ID, "executed lines")
    monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.PY_START, _started)
    monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.LINE, _line)
    monitoring.set_events(monitoring.COVERAGE_ID, monitoring.events.PY_START)
    if sys.orig_argv[1:3] != ["-m", "pytest"]:  # the ranks of a test ask for the lines of each
        _write_for_test()
    os.register_at_fork(after_in_child=_write_for_test)
