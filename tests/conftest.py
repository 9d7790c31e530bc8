"""What all tests share: the import order of the stack, mpirun on the path, and a directory that all ranks see."""

from __future__ import annotations

import functools
import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.batches import IN_BATCH, Batches, RankOfBatch
from helpers.parts import Part

from hpcinv.base.parallel.left_for_run import require_communicators
from hpcinv.base.parallel.runtime import MPI

ROOT = Path(__file__).parents[1]
UNIT = ROOT / "tests" / "unit"

# mpi-pytest starts "mpiexec" by name, and the one of this Python is in the same directory.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
# A rank that fails alone leaves the others waiting: let mpiexec end them, so that the test fails instead of hanging.
os.environ.setdefault("MPIEXEC_TIMEOUT", "300")
# Without byte code each of some thousand processes would compile all that it imports: twice its processor time.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = str(ROOT / ".pytest_cache" / "bytecode")
    sys.dont_write_bytecode = False


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--part K/N``."""
    parser.addoption("--part", metavar="K/N", help="run part K of N of the selected tests; auto/N: by the commits")


def pytest_configure(config: pytest.Config) -> None:
    """Start mpiexec once for several tests on the same number of ranks."""
    if part := config.getoption("--part"):
        config.pluginmanager.register(Part(part, ROOT))  # before the batches, which take what it leaves
    if "_PYTEST_MPI_CHILD_PROCESS" in os.environ:
        config.option.markexpr = ""  # the process that starts the ranks has chosen the test
    batches = Batches()
    if IN_BATCH in os.environ:
        config.pluginmanager.register(RankOfBatch())
    elif MPI.COMM_WORLD.size == 1:
        config.pluginmanager.register(batches)
    # The process that starts one test under mpiexec records the ranks as its children.
    records = os.environ.get("HPCINV_TEST_DURATIONS")
    if records and (IN_BATCH in os.environ or "_PYTEST_MPI_CHILD_PROCESS" not in os.environ):
        from helpers.recorder import Recorder  # it imports DOLFINx

        config.pluginmanager.register(Recorder(Path(records), batches.batch_of))
    if lines := os.environ.get("HPCINV_TEST_LINES"):
        from helpers.line_recorder import LineRecorder  # only `benchmarks/mutants.py --record` starts it

        config.pluginmanager.register(LineRecorder(Path(lines), batches.batch_of))


def pytest_xdist_auto_num_workers() -> int:
    """Two tests at a time, so that kernels compile side by side; the ranks of a parallel test share its one process."""
    return 0 if "_PYTEST_MPI_CHILD_PROCESS" in os.environ else min(2, os.cpu_count() or 1)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Let the second worker begin with the last file: each then rewrites the assertions of half of the files only."""
    report = yield
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1" and isinstance(collector, pytest.Directory):
        report.result.reverse()
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the files, which a worker may have collected in another order.

    Mark as fast what is in tests/unit, unless it is slow or starts several ranks: ``pytest -m fast``.
    """
    items.sort(key=lambda item: item.path)
    for item in items:
        if is_tested_on_other_ranks(item) or is_left_for_a_release(item):
            item.add_marker("release")
        if UNIT in item.path.parents and not any(item.iter_markers("slow")) and not any(item.iter_markers("parallel")):
            item.add_marker("fast")


def pytest_collection_finish() -> None:
    """Leave modules and tests, which stay, out of later collections of garbage: these are ten times as fast then.

    UFL keeps its cells: an element makes one with all its sides whenever it is asked, a tenth of a small run. Pictures
    have a sixth of their pixels.
    """
    if elements := sys.modules.get("basix.ufl"):
        kept = functools.cache(sys.modules["ufl.cell"].Cell)
        elements._ElementBase.cell = property(lambda element: kept(element._cellname))
    if drawing := sys.modules.get("hpcinv.pages.pictures.drawing"):
        drawing._PIXELS = SMALL_PICTURE
    gc.collect()
    gc.freeze()


SMALL_PICTURE = (400, 320)
"""Pixels of a view in tests that do not look at it; a whole one takes half a second."""


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Collect garbage if it holds most communicators: Python does so ever more rarely as objects that stay become more.

    A test leaves up to 24 of them in cyclic garbage. All ranks collect at once, since some destructors are collective.
    """
    require_communicators(MPI.COMM_WORLD)


def is_tested_on_other_ranks(item: pytest.Item) -> bool:
    """True for a test whose marker names another number of ranks last, which is the one of each day."""
    ranks = [mark.args[0] for mark in item.iter_markers("parallel") if mark.args and isinstance(mark.args[0], list)]
    # The markers that `ranks_of` reads are not attached yet.
    here = getattr(item, "callspec", None)
    return here is not None and any(here.params.get("_nprocs", allowed[-1]) != allowed[-1] for allowed in ranks)


def is_left_for_a_release(item: pytest.Item) -> bool:
    """True for a variant of a parametrized test that its marker ``everyday`` does not name."""
    here = getattr(item, "callspec", None)
    chosen = [name for mark in item.iter_markers("everyday") for name in mark.args]
    return bool(chosen) and here is not None and not any(name in here.id for name in chosen)


@pytest.fixture(autouse=True)
def handlers_of_signals() -> Iterator[None]:
    """Handlers as they were: commands run in this process leave signals ignored, and children would inherit that."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)}
    yield
    for number, handler in before.items():
        if handler is not None and signal.getsignal(number) is not handler:
            signal.signal(number, handler)


@pytest.fixture
def whole_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures with the pixels that users have."""
    monkeypatch.setattr("hpcinv.pages.pictures.drawing._PIXELS", (1000, 800))


@pytest.fixture
def ffcx_compiles() -> None:
    """Let FFCx compile what programs do not have, as an operator of a plugin."""


@pytest.fixture(autouse=True)
def nothing_else_needs_ffcx(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where FFCx would compile: each test of a feature shows that it needs no compiler."""
    kernels = sys.modules.get("hpcinv.physics.points.kernels")
    if kernels is None or "ffcx_compiles" in request.fixturenames:
        return

    def refuse(_comm: Any, _item: Any, missing: str, *_options: Any) -> Any:
        raise AssertionError(f"FFCx would compile this: {missing}")

    monkeypatch.setattr(kernels, "compiled_by_ffcx", refuse)


@pytest.fixture(scope="session", autouse=True)
def shared_by_workers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary directory that is the same for all workers of pytest-xdist."""
    directory = tmp_path_factory.getbasetemp()
    return directory.parent if "PYTEST_XDIST_WORKER" in os.environ else directory


@pytest.fixture
def comm() -> MPI.Intracomm:
    """All ranks of the test."""
    return MPI.COMM_WORLD


@pytest.fixture
def run_directory(tmp_path: Path, comm: MPI.Intracomm) -> Path:
    """A temporary directory that is the same on all ranks."""
    return comm.bcast(tmp_path)


@pytest.fixture
def meshes() -> Path:
    """The meshes that come with the project."""
    return ROOT / "meshes"


@pytest.fixture(scope="session")
def warm_process() -> Iterator[Any]:
    """The process whose forks read files."""
    from helpers.warm_reader import WarmReader  # it imports DOLFINx

    reader = WarmReader()
    yield reader
    reader.close()


@pytest.fixture
def warm_reader(warm_process: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are read by forks of a process with the libraries, for tests of what is in them."""
    from hpcinv.mesh.io import isolated

    monkeypatch.setattr(isolated, "run_isolated", warm_process)
