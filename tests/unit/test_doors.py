"""Files of users are opened through one door, `hpcinv.base.reading.door`: the code is walked for other openings."""

import ast
import hashlib
import os
import re
import sys
import tracemalloc
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import hpcinv
from hpcinv.base.reading.door import PLACES, VARIABLE, Refused, admit, admitted, trusted
from hpcinv.job.resolved_job import file_digest

ROOT = Path(hpcinv.__file__).parent
DOORS = ("admitted", "trusted")
OF_A_PATH = ("open", "read_text", "read_bytes")
READERS = {
    *("open", "io.open", "gzip.open", "os.open", "importlib.util.spec_from_file_location", "runpy.run_path", "exec"),
    *("h5py.File", "adios2.Stream", "adios4dolfinx.read_function", "ctypes.CDLL", "pydicom.dcmread"),
    *("gmsh.open", "gmsh.merge", "gmsh.model.occ.importShapes", "occ.importShapes", "reader.SetFileName"),
    *("np.load", "np.loadtxt", "np.genfromtxt", "np.fromfile", "np.memmap", "pyvista.read", "SimpleITK.ReadImage"),
    *("ET.parse", "ET.iterparse", "zipfile.ZipFile", "openpyxl.load_workbook", "shutil.copy", "shutil.copyfile"),
}
"""functions that open a path, by their names in the code"""
NAMES = {*OF_A_PATH, *(reader.rpartition(".")[2] for reader in READERS)}
LIBRARIES = {
    *("SimpleITK", "adios2", "adios4dolfinx", "gmsh", "h5py", "openpyxl", "pydicom", "pyvista", "vtk", "vtkmodules"),
    *("basix", "cffi", "dolfinx", "emcee", "ffcx", "jax", "jinja2", "lib3mf", "manifold3d", "markupsafe", "matplotlib"),
    *("mpi4py", "numpy", "petsc4py", "pxr", "pydantic", "pydantic_core", "rich", "scipy", "torch", "ufl", "yaml"),
    "tesseract_core",
}
"""packages in use: the readers of the first line and of NumPy are among `READERS`, the others open no file of a user"""
OTHER_READERS = {
    *("configparser", "dbm", "fileinput", "linecache", "lzma", "mailbox", "netrc", "plistlib", "shelve", "sqlite3"),
    *("tarfile", "tomllib", "urllib", "wave", "zipimport"),
}
"""modules of Python with readers that are not in use"""
OWN = {
    "model/assembly/csr_tangent.py: _CODE": "code of the package",
    "model/assembly/taylor_residual.py: Path(str(m.__file__))": "code of the package",
    "model/assembly/tangent_product.py: _CODE": "code of the package",
    "studies/batch/grouptask.py: directory / _EVENTS": "a directory that this process has made",
    "studies/batch/grouptask.py: directory / _TASK": "a directory that this process has made",
    "studies/batch/ledger/log.py: file": "claims, whose directory no untrusted sweep can name",
    "studies/batch/ledger/records.py: file": "as above",
    "studies/batch/ledger/shards.py: path": "as above",
    "studies/batch/ledger/shards.py: self.path": "as above",
    "studies/batch/ledger/liveness.py: self._heartbeats / token": "as above",
    "studies/batch/ledger/store.py: mark": "as above",
    "cli/identify.py: directory / 'sections.yaml'": "just written",
    "cli/new.py: _GENERATORS / generator": "part of the package",
    "cli/sweep_submit.py: template": "an argument of the command, by default part of the package",
    "cli/sweep_submit.py: script": "just written",
    "studies/dossier/content.py: file": "part of the package",
    "base/files/atomic.py: path": "a directory, or a file that is written",
    "base/files/atomic.py: partial": "just written",
    "base/files/directory_lock.py: path": "locks, which are JSON",
    "base/files/directory_lock.py: self._path": "locks, which are JSON",
    "base/parallel/standard_output.py: os.devnull": "nothing",
    "base/mesh_formats/partitioned.py: path": "just written, or admitted with its directory",
    "mesh/io/gmsh_model.py: path": "just written",
    "geometry/imaging/shape_labels.py: scrap": "just written",
    "mesh/readers.py: scrap.name": "just written",
    "output/checkpoint.py: file": "checkpoints: 'resume --untrusted' reads none",
    "output/checkpoint.py: path / 'state.json'": "as above",
    "output/function_files.py: path": "as above, and starts of sweeps, which are refused in untrusted jobs",
    "output/console.py: path": "the terminal",
    "output/console.py: proc / str(process) / 'cmdline'": "of the system",
    "output/console.py: proc / str(process) / 'stat'": "of the system",
    "studies/sweep/reduced_basis.py: path / 'start.json'": "'solver.start' is refused in untrusted jobs",
    "base/quantity/plugins.py: Path(entry.path) / 'entry_points.txt'": "of the installation",
    "base/parallel/adios.py: 'libadios2_cxx_mpi.so.2.12'": "of the installation",
    "base/parallel/left_for_run.py: _MEMINFO": "of the system",
    "base/parallel/left_for_run.py: group / 'memory.current'": "of the system",
    "base/parallel/left_for_run.py: group / 'memory.max'": "of the system",
    "base/parallel/left_for_run.py: Path('/proc/self/cgroup')": "of the system",
    "base/parallel/c_code.py: Path('/proc/cpuinfo')": "of the system",
    "base/parallel/code_cache.py: path": "files of the cache, whose owner and seal are checked",
    "physics/points/interpreter.py: Path(__file__).with_name('interpreter.c')": "of hpcinv",
    "physics/points/program_files.py: io.BytesIO(content)": "programs, whose owner and seal are checked",
    "physics/points/program_files.py: path": "modules of hpcinv",
    "base/parallel/c_code.py: made": "just compiled",
    "base/parallel/c_code.py: path": "files of the cache, whose owner and seal are checked",
    "base/parallel/c_code.py: str(path)": "files of the cache, whose owner and seal are checked",
    "base/parallel/cache_files.py: directory / _LOCK": "of the cache",
    "base/parallel/cache_files.py: partial": "written",
    "base/parallel/malloc.py: None": "this process",
    "base/parallel/timings.py: '/proc/self/statm'": "of the system",
    "base/parallel/processes.py: Path('/proc/sys/kernel/random/boot_id')": "of the system",
    "base/parallel/processes.py: Path(f'/proc/{pid}/stat')": "of the system",
    "base/parallel/signals.py: os.devnull": "nothing",
    "base/parallel/petsc_calls.py: PETSc.__file__": "of the installation",
    "base/quantity/table_files.py: io.BytesIO(content)": "content that was admitted",
    "base/reading/isolated_reader.py: 'hpcinv'": "code of the package",
    "base/reading/isolated_reader.py: Path('/proc/self/statm')": "of the system",
    "base/reading/isolated_reader.py: os.devnull": "nothing",
    "pages/reports/page.py: files('hpcinv.pages.reports').joinpath('static', name)": "part of the package",
    "studies/study/directory.py: path / _MARK": "records, which are JSON, in a directory that an argument names",
    "studies/second_opinion/calculix.py: path": "just written by CalculiX",
    "studies/second_opinion/febio.py: log": "just written by FEBio",
    "studies/second_opinion/febio.py: path": "just written by FEBio",
    "studies/second_opinion/program_run.py: log": "just written by the other program",
    "studies/second_opinion/calculix_deck.py: plain": "just written",
    "studies/second_opinion/calculix_shell.py: plain": "just written",
    "geometry/workshop/cad_refit.py: str(brep)": "just written",
    "geometry/workshop/cad_refit.py: str(step)": "just written",
    "geometry/workshop/cad_refit.py: brep": "just written",
    "geometry/workshop/cad_refit.py: step": "just written",
}
"""what is opened by other ways, by module and expression, and why it may be"""


IMPORTS = re.compile(r"^ *(?:from ([\w.]+) import |import (\w+)(?:\.\w+)*(?: as \w+)?$)", re.M)


@cache
def code() -> dict[str, str]:
    """Return the text of each module."""
    return {str(module.relative_to(ROOT)): module.read_text("utf-8") for module in sorted(ROOT.rglob("*.py"))}


def calls() -> Iterator[tuple[str, ast.Call]]:
    """Yield the calls of each module that names a function of `NAMES`; parsing all modules takes five times as long."""
    named = re.compile(rf"\b(?:{'|'.join(NAMES)})\(")
    for module, text in code().items():
        for node in ast.walk(ast.parse(text)) if named.search(text) else ():
            if isinstance(node, ast.Call):
                yield module, node


def passes_a_door(text: str) -> bool:
    return any(f"{door}(" in text for door in DOORS)


def opened_by(call: ast.Call) -> str:
    """Return the expression that a call opens for reading; empty text if it opens nothing."""
    function = call.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name not in NAMES:
        return ""
    words = [ast.unparse(argument) for argument in (*call.args, *(key.value for key in call.keywords))]
    if any(word[:1] == "'" and set(word[1:-1]) & set("wax") and set(word[1:-1]) <= set("wax+bt") for word in words):
        return ""  # for writing
    if ast.unparse(function) in READERS:
        return next((word for word in words if passes_a_door(word)), words[0])
    if (
        isinstance(function, ast.Attribute)
        and function.attr in OF_A_PATH
        and ast.unparse(function.value) not in ("store", "self._log")
    ):
        return ast.unparse(function.value)
    return ""


def openings() -> Iterator[str]:
    for module, call in calls():
        if (text := opened_by(call)) and not passes_a_door(text):
            yield f"{module}: {text}"


def test_files_are_opened_through_the_door_alone() -> None:
    found = set(openings())
    others = sorted(found - OWN.keys())
    assert not others, f"open these by hpcinv.base.reading.door, or say in OWN whose they are: {others}"
    assert OWN.keys() == found, "these are not opened any more"


def test_no_other_library_reads_files() -> None:
    """A new package is noticed here: add its readers to `READERS`."""
    found = (match for text in code().values() for match in IMPORTS.finditer(text))
    imported = {(match[1] or match[2]).partition(".")[0] for match in found}
    imported.remove("paraview")  # by the script that is written for it
    assert imported - sys.stdlib_module_names - {"hpcinv"} == LIBRARIES
    assert not imported & OTHER_READERS


@pytest.fixture
def named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory that the user of --untrusted has named, next to one that is private."""
    for name in ("named", "private"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
    monkeypatch.setenv(VARIABLE, "1")
    monkeypatch.setenv(PLACES, "[]")
    admit(tmp_path / "named")
    return tmp_path / "named"


def test_files_below_a_named_directory_are_admitted(named: Path) -> None:
    (named / "deeper").mkdir()
    for path in (named / "file", named / "deeper" / "no-such-file", named / "deeper" / ".." / "file"):
        assert admitted(path) == path
    assert admitted(named / "file", named / "deck") == named / "file"


def test_files_elsewhere_are_refused(named: Path) -> None:
    (named / "link").symlink_to(named.parent / "private" / "file")
    for path in (named / ".." / "private" / "file", named / "link", named.parent / "named-too", Path("/etc/hostname")):
        with pytest.raises(Refused, match=r"leads out of .* refused with --untrusted"):
            admitted(path)
    with pytest.raises(Refused, match="leads out of the directory of the file"):
        admitted(named / "file", named / "deeper" / "deck")


def test_programs_are_refused_wherever_they_are(named: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Refused, match="can execute code, and is refused with --untrusted"):
        trusted(named / "file")
    monkeypatch.setenv(VARIABLE, "0")
    assert trusted(named / "file") == named / "file"
    assert admitted(Path("/etc/hostname")) == Path("/etc/hostname")


def test_the_digest_of_a_large_file_takes_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "large.vtu"
    path.write_bytes(b"<VTKFile/>")
    os.truncate(path, 64 * 2**20)
    tracemalloc.start()
    digest = file_digest(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8 * 2**20
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
