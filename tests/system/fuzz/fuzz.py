"""Fuzzer of what `hpcinv` reads: mutated job files through ``hpcinv validate``, mutated meshes, images and surfaces
through its readers, and mutated files of other programs through ``hpcinv new job --from``.

    python tests/system/fuzz/fuzz.py --seconds 600 --seed 1 [--only jobs|meshes|scans|decks …] [--count 500 …]

Whatever comes, the answer must be an ``HpcinvError`` that names the file, or none; no other exception, no end of the
process, nothing that takes long. What breaks this is kept in a directory, and reported with its seed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1]), str(HERE.parents[2])]

from mutations import mutated_bytes, mutated_text  # noqa: E402

CORPUS = HERE / "corpus"
MESHES = HERE.parents[2] / "meshes"
PATIENCE = 60
"""seconds, many times what an answer takes: something that takes longer hangs"""


class Hangs(BaseException):
    """No answer after `PATIENCE`; none of what the package catches."""


def jobs(directory: Path) -> list[str]:
    """The texts of the corpus; what they refer to is put into ``directory``."""
    texts = []
    shutil.copy(MESHES / "box.py", directory)
    for path in sorted(CORPUS.iterdir()):
        if path.suffix == ".yaml":
            texts.append(path.read_text(encoding="utf-8"))
        shutil.copy(path, directory)
    return texts


def fault_of_job(path: Path) -> str | None:
    """What is wrong with the answer of ``hpcinv validate``, which runs in this process."""
    from hpcinv.__main__ import main

    def hangs(_number: int, _frame: FrameType | None) -> None:
        raise Hangs

    out, err = io.StringIO(), io.StringIO()
    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(PATIENCE)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(["validate", str(path)])
    except BaseException as error:
        return "".join(traceback.format_exception(error)[-4:])
    finally:
        signal.alarm(0)
    if code not in (0, 2) or "Traceback" in err.getvalue() or "Warning" in err.getvalue():
        return f"exit code {code}: {err.getvalue()}"
    if code and path.name not in err.getvalue():
        return f"does not name the file: {err.getvalue()}"
    return None


def run_jobs(directory: Path, source: random.Random, count: int | None, until: float) -> Iterator[tuple[bytes, str]]:
    """Job files with a wrong answer: first the corpus as it is, then mutated files."""
    texts = jobs(directory)
    for known in sorted(CORPUS.glob("*.yaml")):
        if (fault := fault_of_job(directory / known.name)) is not None:
            yield known.read_bytes(), f"{known.name}: {fault}"
    path = directory / "mutant.yaml"
    while (count is None or count > 0) and time.monotonic() < until:
        content = mutated_text(source, texts)
        path.write_bytes(content)
        TRIED["jobs"] += 1
        if (fault := fault_of_job(path)) is not None:
            yield content, fault
        count = None if count is None else count - 1


def meshes(directory: Path) -> list[Path]:
    """A small mesh in every format and version, with groups and data."""
    import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

    # isort: split
    import gmsh
    from helpers.mesh_data_files import block, write_msh, write_vtu, write_xdmf

    from hpcinv.base.parallel.runtime import MPI
    from hpcinv.mesh.distributed.partition import partitioned
    from hpcinv.mesh.distributed.partitioned import write_partitioned
    from hpcinv.mesh.mesh_files import save

    mesh = block(MESHES, hexahedra=False, degree=1)
    paths = [write_vtu(directory / "made.vtu", mesh), write_xdmf(directory / "made.xdmf", mesh)]
    paths += [write_msh(directory / f"{v}.msh", MESHES, True, 2, v) for v in (2.2, 4.1)]
    for name in ("own.vtu", "own.msh"):
        save(directory / name, mesh, mesh.points)
        paths.append(directory / name)
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(directory / "own.msh"))
    gmsh.option.setNumber("Mesh.Binary", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.write(str(directory / "binary22.msh"))
    gmsh.finalize()
    parts, _ = partitioned(mesh, 2)
    write_partitioned(directory / "parts.bp", MPI.COMM_SELF, parts)
    paths += [directory / "binary22.msh", directory / "parts.bp"]
    paths += [Path(shutil.copy(CORPUS / name, directory)) for name in ("inline.xdmf", "ascii.vtu")]
    assert all(_answer(path) == "" for path in paths), [(path, _answer(path)) for path in paths]
    return paths


def _answer(path: Path) -> str:
    """Read and check a mesh; what is wrong with the answer."""
    from helpers.mesh_cases import spec
    from pydantic import ValidationError

    from hpcinv.errors import HpcinvError
    from hpcinv.mesh.body import read_source
    from hpcinv.mesh.checks import check

    try:
        check(read_source(spec(path), path))
    except (HpcinvError, ValidationError) as error:  # the latter becomes a JobError where a job is read
        return "" if path.name in str(error) and len(str(error)) < 4000 else f"does not name the file: {error}"
    except BaseException as error:
        return "".join(traceback.format_exception(error)[-4:])
    return ""


def fault_of_mesh(path: Path) -> str | None:
    """What is wrong with the answer of the reader, in a process of its own, which a damaged file may end."""
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which do nothing here
        process = os.fork()
    if process == 0:
        os.close(read)
        null = os.open(os.devnull, os.O_WRONLY)
        told = os.dup(2)
        with tempfile.TemporaryFile() as printed:
            os.dup2(null, 1)
            os.dup2(printed.fileno(), 2)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(PATIENCE)
            fault = _answer(path)
            os.dup2(told, 2)
            printed.seek(0)
            text = printed.read().decode(errors="replace")
            if not fault and text.strip():
                fault = f"prints in addition to the message: {text[:2000]}"
        os.write(write, fault.encode()[:60_000])
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as answer:
        fault = answer.read().decode(errors="replace")
    _, status = os.waitpid(process, 0)
    if os.WIFSIGNALED(status):
        return f"the process ended by {signal.Signals(os.WTERMSIG(status)).name}"
    return fault or None


def run_meshes(directory: Path, source: random.Random, count: int | None, until: float) -> Iterator[tuple[bytes, str]]:
    """Mutated meshes with a wrong answer."""
    paths = meshes(directory)
    while (count is None or count > 0) and time.monotonic() < until:
        original = source.choice(paths)
        place = directory / "mutants"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        path = place / original.name
        if original.is_dir():
            shutil.copytree(original, path)
            victim = source.choice(sorted(path.iterdir()))
        else:
            shutil.copy(original, path)
            victim = path
            if (beside := original.with_suffix(".h5")).exists() and original.suffix == ".xdmf":
                shutil.copy(beside, place)
                victim = source.choice((path, place / beside.name))
        content = mutated_bytes(source, victim.read_bytes(), lines=victim.suffix not in (".h5",))
        victim.write_bytes(content)
        TRIED["meshes"] += 1
        if (fault := fault_of_mesh(path)) is not None:
            yield content, f"{original.name} ({victim.name}): {fault}"
        count = None if count is None else count - 1


def run_scans(directory: Path, source: random.Random, count: int | None, until: float) -> Iterator[tuple[bytes, str]]:
    """Mutated images and surfaces with a wrong answer."""
    from scans import Scans

    scans = Scans(directory)
    while (count is None or count > 0) and time.monotonic() < until:
        TRIED["scans"] += 1
        if (wrong := scans.fault_of_next(source)) is not None:
            yield wrong
        count = None if count is None else count - 1
    print(", ".join(f"{number} {answer}" for answer, number in scans.answers.items()))


def run_decks(directory: Path, source: random.Random, count: int | None, until: float) -> Iterator[tuple[bytes, str]]:
    """Mutated files of other programs with a wrong answer."""
    from decks import Decks

    decks = Decks(directory)
    while (count is None or count > 0) and time.monotonic() < until:
        TRIED["decks"] += 1
        if (wrong := decks.fault_of_next(source)) is not None:
            yield wrong
        count = None if count is None else count - 1
    print(", ".join(f"{number} {answer}" for answer, number in decks.answers.items()))


TRIED = {"jobs": 0, "meshes": 0, "scans": 0, "decks": 0}
"""how many mutants have been tried"""
KINDS: dict[str, Callable[[Path, random.Random, int | None, float], Iterator[tuple[bytes, str]]]] = {
    "jobs": run_jobs,
    "meshes": run_meshes,
    "scans": run_scans,
    "decks": run_decks,
}


def main() -> int:
    """Run for some time and keep what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, nargs="+", metavar="N", help="at most so many mutants of each kind")
    parser.add_argument("--only", nargs="+", choices=KINDS)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hpcinv-fuzz")
    options = parser.parse_args()
    options.keep.mkdir(parents=True, exist_ok=True)
    chosen = options.only or list(KINDS)
    counts = options.count or [None]
    if len(counts) not in (1, len(chosen)):
        parser.error(f"--count: one number, or {len(chosen)}")
    faults = 0
    for kind, count in zip(chosen, counts if len(counts) > 1 else counts * len(chosen), strict=True):
        source = random.Random(options.seed)
        with tempfile.TemporaryDirectory() as directory:
            until = time.monotonic() + options.seconds / len(chosen)
            for content, fault in KINDS[kind](Path(directory), source, count, until):
                faults += 1
                kept = options.keep / f"{kind}-{options.seed}-{faults}"
                kept.write_bytes(content)
                print(f"{kept}: {fault}\n", flush=True)
    print(f"{faults} wrong answers to {', '.join(f'{n} {kind}' for kind, n in TRIED.items())}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
