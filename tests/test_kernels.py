"""A run that was killed while it compiled a kernel must not stop those that come after it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from command_line import CUBE, ROOT, environment, hpcinv, write_job

HOLD = "import hpcinv.kernels, sys; print('holds', flush=True); sys.stdin.read()"


def test_what_a_killed_compilation_left_is_compiled_again(tmp_path: Path) -> None:
    job = write_job(
        tmp_path / "job.yaml", CUBE, discretisation={"displacement": 1}, output={"fields": False, "mesh": []}
    )
    cache = tmp_path / "cache" / "fenics"
    assert hpcinv(1, "run", job, "--output", "first", cwd=tmp_path, XDG_CACHE_HOME=str(cache.parent)).returncode == 0
    (ready, *_) = sorted(cache.glob("libffcx_forms_*.c.cached"))
    source = ready.with_suffix("")
    ready.unlink()
    source.write_text("/* as far as it came")
    again = hpcinv(2, "run", job, "--output", "second", cwd=tmp_path, XDG_CACHE_HOME=str(cache.parent))
    assert again.returncode == 0, again.stderr
    assert ready.exists()


def test_kernels_that_another_run_may_be_compiling_are_left_alone(tmp_path: Path) -> None:
    env = environment(XDG_CACHE_HOME=str(tmp_path))
    unfinished = tmp_path / "fenics" / "libffcx_forms_0123.c"
    with subprocess.Popen(
        [sys.executable, "-c", HOLD], env=env, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "holds\n"
        unfinished.write_text("")
        subprocess.run([sys.executable, "-c", "import hpcinv.kernels"], env=env, cwd=ROOT, check=True)
        assert unfinished.exists()
        other.communicate("")
    subprocess.run([sys.executable, "-c", "import hpcinv.kernels"], env=env, cwd=ROOT, check=True)
    assert not unfinished.exists()
