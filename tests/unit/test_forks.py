"""Forks of the stack end as processes of their own do."""

import signal
import subprocess
import time
from pathlib import Path

from helpers.command_line import environment
from helpers.forks import python_for


def test_output_exit_code_and_signals_are_those_of_a_process(tmp_path: Path) -> None:
    variables = environment()
    fork = [python_for(variables), "-m", "hpcinv", "validate"]
    (tmp_path / "wrong.yaml").write_text("analysis: sideways")
    done = subprocess.run([*fork, "wrong.yaml"], cwd=tmp_path, env=variables, capture_output=True, text=True)
    assert done.returncode == 2
    assert "sideways" in done.stdout + done.stderr

    # A job that never ends shows its process, which must end with the stand-in.
    (tmp_path / "endless.py").write_text(
        "import os, pathlib, time\npathlib.Path('process').write_text(str(os.getpid()))\ntime.sleep(300)\n"
    )
    (tmp_path / "job.yaml").write_text("plugins: [endless.py]")
    for number in (signal.SIGKILL, signal.SIGTERM):
        (tmp_path / "process").unlink(missing_ok=True)
        with subprocess.Popen([*fork, "job.yaml"], cwd=tmp_path, env=variables) as stand_in:
            while not (tmp_path / "process").exists() or not (tmp_path / "process").read_text():
                assert stand_in.poll() is None
                time.sleep(0.01)
            process = Path("/proc", (tmp_path / "process").read_text())
            assert process.exists()
            stand_in.send_signal(number)
            assert stand_in.wait(30) != 0
        while process.exists():
            time.sleep(0.01)


def test_environments_that_imports_read_have_processes_of_their_own() -> None:
    assert python_for(environment()) != python_for(environment(HPCINV_KERNELS="kernels"))
