"""The cache that runs share: killed compilations, damaged files, full disks, and who may have written them."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import CUBE, PATIENCE, Started, environment, hpcinv, write_job

from hpcinv.base.parallel import cache_files, ownership
from hpcinv.base.parallel.code_cache import refuse_foreign
from hpcinv.errors import OutputError

SMALL: Mapping[str, Any] = {
    **CUBE,
    "discretisation": {"displacement": 1},
    "quantities": [{"name": "stress", "of": "von_mises", "on": "block", "reduce": "mean"}],
    "output": {"fields": False, "mesh": []},
}
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")

# A compiler that notes what it compiles, and waits before that for as long as there is a file 'hold'.
COMPILER = """#!/bin/sh
for argument in "$@"; do case "$argument" in *.c) echo "$(basename "$argument")" >> {here}/compiled;; esac; done
while [ -e {here}/hold ]; do sleep 0.05; done
exec gcc "$@"
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    return write_job(tmp_path / "job.yaml", SMALL)


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The compiler above, for everything that the test starts with a cache of its own."""
    script = tmp_path / "cc"
    script.write_text(COMPILER.format(here=tmp_path))
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return script


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with what the small job needs."""
    here = tmp_path_factory.mktemp("kernels")
    done = hpcinv(1, "run", write_job(here / "job.yaml", SMALL), cwd=here, HPCINV_KERNELS=str(here / "all"))
    assert done.returncode == 0, done.stderr
    return here / "all"


@pytest.mark.release
def test_a_run_that_waits_takes_over_from_one_that_was_killed_while_compiling(
    job: Path, compiler: Path, tmp_path: Path
) -> None:
    hold = tmp_path / "hold"
    hold.touch()
    with Started(1, "run", job, "--output", "first", cwd=tmp_path) as first:
        wait_for(lambda: (tmp_path / "compiled").exists())
        with Started(1, "run", job, "--output", "second", cwd=tmp_path) as second:
            wait_for(lambda: any(map(has_lock_open, second.ranks())))
            first.kill()  # with its compiler
            hold.unlink()
            assert second.exit_code() == 0, second.text
    assert not list(tmp_path.glob("cache/hpcinv/*.partial"))


def has_lock_open(process: int) -> bool:
    try:
        return any(str(path.readlink()).endswith("cache.lock") for path in Path(f"/proc/{process}/fd").iterdir())
    except OSError:  # it has ended, or a file was closed meanwhile
        return False


def wait_for(condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.release
def test_runs_that_begin_together_compile_each_file_once(job: Path, compiler: Path, tmp_path: Path) -> None:
    with ThreadPoolExecutor() as pool:
        runs = [pool.submit(hpcinv, 1, "run", job, "--output", f"results-{i}", cwd=tmp_path) for i in range(2)]
        for done in (r.result() for r in runs):
            assert done.returncode == 0, done.stderr
    compiled = Counter((tmp_path / "compiled").read_text().split())
    assert {f"{name.stem}.c" for name in tmp_path.glob("cache/hpcinv/*.so")} == set(compiled)
    assert set(compiled.values()) == {1}


@pytest.mark.everyday("SIGTERM")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGUSR1"])
def test_a_signal_while_code_is_compiled_stops_the_run(name: str, job: Path, compiler: Path, tmp_path: Path) -> None:
    """mpirun forwards it to all processes, the compiler among them."""
    hold = tmp_path / "hold"
    hold.touch()
    with Started(1, "run", job, "--output", "run", cwd=tmp_path) as started:
        wait_for(lambda: (tmp_path / "compiled").exists())
        started.send(signal.Signals[name], [started.mpirun.pid])
        time.sleep(0.5)
        hold.unlink()
        assert started.exit_code() == 75, started.text
    assert "could not compile" not in started.text


@pytest.mark.release
def test_the_compiler_ends_with_its_run(job: Path, compiler: Path, tmp_path: Path) -> None:
    (tmp_path / "hold").touch()
    with Started(1, "run", job, "--output", "run", cwd=tmp_path) as started:
        wait_for(lambda: (tmp_path / "compiled").exists())
        running = {p: Path(f"/proc/{p}/cmdline").read_bytes() for p in started.ranks()}
        (rank,) = (p for p, line in running.items() if b"hpcinv" in line)
        started.send(signal.SIGKILL, [rank])
        assert started.exit_code() != 0
    wait_for(lambda: not any(str(compiler) in command for command in commands()))


def commands() -> list[str]:
    """Command lines of all processes."""
    commands = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # it has ended
            commands.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return commands


def truncate(kernel: Path) -> None:
    kernel.write_bytes(kernel.read_bytes()[:5000])


def change_a_byte(kernel: Path) -> None:
    content = bytearray(kernel.read_bytes())
    content[len(content) // 2] ^= 1
    kernel.write_bytes(content)


def give_away(kernel: Path) -> None:
    os.chown(kernel, 12345, -1)


DAMAGE: Mapping[str, Callable[[Path], object]] = {
    "truncated": truncate,
    "empty": lambda kernel: kernel.write_bytes(b""),
    "a byte changed": change_a_byte,
    "missing": Path.unlink,
    "writable by all": lambda kernel: kernel.chmod(0o666),
} | ({"of another user": give_away} if os.geteuid() == 0 else {})


def test_programs_that_cannot_be_relied_on_are_made_again(job: Path, kernels: Path, tmp_path: Path) -> None:
    shutil.copytree(kernels, tmp_path / "kernels")
    paths = sorted((tmp_path / "kernels").glob("*.npz"))
    assert len(paths) > len(DAMAGE)
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in paths}
    damaged = dict(zip(DAMAGE, paths, strict=False))
    for name, program in damaged.items():
        DAMAGE[name](program)
    done = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, HPCINV_KERNELS=str(tmp_path / "kernels"))
    assert done.returncode == 0, done.stderr
    for path in paths:
        content, time_made = before[path]
        assert path.read_bytes() == content
        assert (path.stat().st_mtime_ns != time_made) == (path in damaged.values())
        assert path.stat().st_uid == os.geteuid()
        assert not path.stat().st_mode & 0o022


LIMITED = """
import resource, runpy
import hpcinv.base.parallel.runtime
resource.setrlimit(resource.RLIMIT_FSIZE, (900_000, 900_000))
runpy.run_module("hpcinv", run_name="__main__")
"""


def test_a_full_disk_leaves_the_work_to_numpy(job: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands in for it, and one that fails for the compiler, which does not say why."""
    script = tmp_path / "limited.py"
    script.write_text(LIMITED)
    # Python would keep byte code that is cut off.
    env = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1", "CC": "false"}
    done = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, script=script, **env)
    assert done.returncode == 0, done.stderr
    assert "the compiler cannot write to" in done.stdout
    assert "File too large: NumPy evaluates laws and loads" in done.stdout
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "cache").rglob("*.so"))


def test_a_cache_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "full").touch()
    reason = "(Not a directory|File exists)"
    with pytest.raises(cache_files.NotWritten, match=rf"the cache .* cannot be written: {reason}"):
        cache_files.publish(tmp_path / "full" / "points_0.npz", b"")


def test_without_locks_files_are_made_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "lockf", none)
    with cache_files.locked(tmp_path, "hpcinv_0"), cache_files.locked(tmp_path, "hpcinv_0"):
        pass


HOLD = """
import sys
from pathlib import Path
from hpcinv.base.parallel.cache_files import locked
with locked(Path(sys.argv[1]), "a"):
    print("holds", flush=True)
    sys.stdin.read()
"""


def test_a_lock_is_of_one_file_and_is_waited_for_with_patience(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path], env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        other.send_signal(signal.SIGSTOP)
        with cache_files.locked(tmp_path, "b", patience=1e9):
            pass
        with cache_files.locked(tmp_path, "a", patience=0.2):  # it is stopped: no longer waited for
            pass
        other.send_signal(signal.SIGCONT)
        other.kill()


def test_partly_published_files_are_removed_later(tmp_path: Path) -> None:
    old, new = tmp_path / ".k.so.here-1.partial", tmp_path / ".k.so.here-2.partial"
    for path in (old, new):
        path.touch()
    os.utime(old, (0, 0))
    with cache_files.locked(tmp_path, "k"):
        assert not old.exists()
        assert new.exists()


def everybody(directory: Path) -> None:
    directory.chmod(0o777)


def sticky(directory: Path) -> None:
    directory.chmod(0o1777)


def a_group(directory: Path) -> None:
    os.chown(directory, -1, 12345)
    directory.chmod(0o775)


def another_user(directory: Path) -> None:
    os.chown(directory, 12345, -1)


def everybody_above(directory: Path) -> None:
    directory.parent.chmod(0o777)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (everybody, "it can be written by everybody"),
        (sticky, "it can be written by everybody"),
        pytest.param(a_group, "it can be written by the group number 12345", marks=as_root),
        pytest.param(another_user, "it belongs to the user number 12345", marks=as_root),
        (everybody_above, "above it can be written by everybody"),
    ],
)
def test_a_directory_that_another_user_could_have_written_is_refused(change: Any, reason: str, tmp_path: Path) -> None:
    directory = tmp_path / "shared" / "kernels"
    cache_files.make_directory(directory)
    refuse_foreign("HPCINV_KERNELS", directory)
    change(directory)
    with pytest.raises(OutputError) as refused:
        refuse_foreign("HPCINV_KERNELS", directory)
    assert f"HPCINV_KERNELS {directory}: " in str(refused.value)
    assert reason in str(refused.value)
    assert "HPCINV_TRUST_KERNELS=1" in str(refused.value)


def test_a_cache_that_another_user_could_have_written_is_refused_unless_trusted(
    job: Path, kernels: Path, tmp_path: Path
) -> None:
    cache = tmp_path / "cache" / "hpcinv"
    shutil.copytree(kernels, cache)
    cache.chmod(0o777)
    env = {"XDG_CACHE_HOME": str(cache.parent)}
    refused = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, **env)
    assert refused.returncode == 2
    assert refused.stderr.count(f"the cache {cache}: it can be written by everybody") == 1
    assert not (tmp_path / "results").exists()
    wrong = hpcinv(1, "run", job, cwd=tmp_path, HPCINV_TRUST_KERNELS="yes", **env)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("HPCINV_TRUST_KERNELS=yes: must be 1")
    done = hpcinv(1, "run", job, "--output", "results", cwd=tmp_path, HPCINV_TRUST_KERNELS="1", **env)
    assert done.returncode == 0, done.stderr


def test_a_cache_is_made_for_its_user_alone_to_write(tmp_path: Path) -> None:
    before = os.umask(0o000)
    try:
        cache_files.make_directory(tmp_path / "new" / "kernels")
        assert os.umask(0o000) == 0o000
    finally:
        os.umask(before)
    for path in (tmp_path / "new", tmp_path / "new" / "kernels"):
        assert not ownership.foreign_writer(path.stat())
