"""Every command with --untrusted on files that lead outside or are programs: none is executed, none read there."""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.warm_reader import WarmReader

from hpcinv.__main__ import _parser, main
from hpcinv.formats.readers import followed_includes
from hpcinv.job import mesh_contents
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader", "warm_checks")

_OPENED = 0x20  # IN_OPEN of inotify


class Watch:
    """Files that must not be opened, by any function of any process."""

    def __init__(self, files: list[Path]) -> None:
        self._system = ctypes.CDLL(None, use_errno=True)
        self._events = self._system.inotify_init1(os.O_NONBLOCK)
        self._files = {self._system.inotify_add_watch(self._events, os.fsencode(f), _OPENED): f for f in files}
        assert min(self._events, *self._files) >= 0, os.strerror(ctypes.get_errno())

    def opened(self) -> set[Path]:
        """Return what was opened since the last call."""
        try:
            content = os.read(self._events, 1 << 16)
        except BlockingIOError:
            return set()
        numbers = {int.from_bytes(content[at : at + 4], "little") for at in range(0, len(content), 16)}
        return {self._files[number] for number in numbers}

    def close(self) -> None:
        os.close(self._events)


JOB = """
mesh: {%s}
material: {law: neo-hookean, mu: 200 kPa, poisson: 0.3}
effects: [{effect: gravity, acceleration: [0, 0, -9.81], density: 100}]
supports: [{region: boundary, fix: [x, y, z]}]
"""
OBSTACLE = "{effect: contact, region: boundary, obstacle: {shape: surface, file: ../private/s.stl, unit: m}}"
NODES = "1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n"
DECK = (
    "*NODE%s\n*ELEMENT, TYPE=C3D4, ELSET=block\n1, 1, 2, 3, 4\n*NSET, NSET=base\n1, 2, 3\n"
    "*MATERIAL, NAME=a\n*HYPERELASTIC, NEO HOOKE\n1., 0.01\n*SOLID SECTION, ELSET=block, MATERIAL=a\n"
    "*BOUNDARY\nbase, 1, 3\n"
)
XDMF = (
    '<Xdmf><Domain><Grid><Topology TopologyType="Tetrahedron"><DataItem Format="HDF">../private/m.h5:/t</DataItem>'
    '</Topology><Geometry><DataItem Format="HDF">../private/m.h5:/g</DataItem></Geometry></Grid></Domain></Xdmf>'
)
MHD = (
    "ObjectType = Image\nNDims = 3\nDimSize = 4 4 4\nElementSpacing = 1 1 1\nElementType = MET_UCHAR\n"
    "ElementDataFile = %s\n"
)
NRRD = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 4 4 4\nspacings: 1 1 1\nencoding: raw\ndata file: %s\n"
PROGRAM = "from pathlib import Path\nPath({marker!r}).touch()\n{more}"
BUILD = """
def build(gmsh):
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], name="block")
    gmsh.model.mesh.generate(3)
"""


class Tree:
    """Directory ``download`` with poisoned files, directory ``private`` with files that are watched."""

    def __init__(self, root: Path) -> None:
        self.marker, self.download, private = root / "executed", root / "download", root / "private"
        self.download.mkdir()
        private.mkdir()
        for name in ("nodes.inp", "m.h5", "voxels.raw", "job.yaml", "summary.json", "field.csv", "s.stl"):
            (private / name).write_bytes(NODES.encode() if name == "nodes.inp" else bytes(64))
        self.box = self._box(root)
        shutil.copy(self.box, private / "box.msh")
        self.watch = Watch(list(private.iterdir()))
        (self.download / "table.csv").write_text("# mode: uniaxial\nstretch [-], nominal stress [MPa]\n1.1, 0.1\n")
        self._meshes()
        self._jobs()
        self._run()

    def _box(self, root: Path) -> Path:
        """A tetrahedron, as mesh and as its surface."""
        points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        cells, one = np.array([[0, 1, 2, 3]]), np.array([1])
        none = np.zeros((0, 3), dtype=np.int64)
        source = MeshSource(root / "box.msh", "tetrahedron", 1, points, np.arange(1, 5), cells, one, none, ())
        save(root / "download" / "box.msh", source, points)
        return root / "download" / "box.msh"

    def _meshes(self) -> None:
        here, call = self.download, f'SystemCall "touch {self.marker}";\n'
        texts = {
            "body.py": PROGRAM.format(marker=str(self.marker), more=BUILD),
            "body.geo": call + 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n',
            "nodes.inp": DECK % ", INPUT=../private/nodes.inp",
            "include.inp": "*INCLUDE, INPUT=../private/nodes.inp\n" + DECK % f"\n{NODES}".rstrip(),
            "include.bdf": "BEGIN BULK\nINCLUDE '../private/nodes.inp'\nENDDATA\n",
            "outside.xdmf": XDMF,
            "file.mhd": MHD % "../private/voxels.raw",
            "list.mhd": MHD % "LIST\n../private/voxels.raw",
            "pattern.mhd": MHD % "../private/voxels%d.raw 1 4 1",
            "file.nrrd": NRRD % "../private/voxels.raw",
        }
        for name, text in texts.items():
            (here / name).write_text(text)
        (here / "parts.bp").mkdir()
        (here / "parts.bp" / "mesh.json").write_text("{}")
        os.link(here / "box.msh", here / "good.msh")
        (here / "link.msh").symlink_to("../private/box.msh")

    def _jobs(self) -> None:
        good = JOB % "file: good.msh"
        texts = {
            "plugin.yaml": f"{good}plugins: [body.py]\n",
            "start.yaml": f"{good}solver: {{start_shape: nodes.inp}}\n",
            "teach.yaml": f"{good}solver: {{start: ../private}}\n",
            "petsc.yaml": f"{good}solver: {{petsc: {{snes_view: 'ascii:{self.marker}'}}}}\n",
            "obstacle.yaml": good.replace("effects: [", f"effects: [{OBSTACLE}, "),
            **{f"mesh-{name}.yaml": JOB % f"file: {name}" for name in MESHES},
            **{f"image-{name}.yaml": JOB % f"image: {name}, labels: {{a: 1}}, size: 1 mm" for name in IMAGES},
        }
        for name, text in texts.items():
            (self.download / name).write_text(text)
            axes = "axes: [{grid: {material.mu: [1 MPa, 2 MPa]}}]\n"
            (self.download / f"sweep-{name}").write_text(f"job: {name}\n{axes}")
            series = (
                "series: [{name: a, vary: {discretisation.displacement: [1, 2]}}]\nmeasure: [errors.round_trip.max]\n"
            )
            (self.download / f"study-{name}").write_text(f"job: {name}\n{series}")
        (self.download / "link.yaml").symlink_to("../private/job.yaml")
        (self.download / "sweep-link.yaml").write_text(f"job: link.yaml\n{axes}")
        (self.download / "study-link.yaml").write_text(f"job: link.yaml\n{series}")

    def _run(self) -> None:
        """Directories of runs: their job lies elsewhere, their shape is a program's or a link, their summary a link."""
        summary = {"status": "converged", "solutions": [{"direction": "inverse"}], "job": {}, "quantities": {}}
        for name in ("given", "shape", "parts"):
            run = self.download / f"run-{name}"
            run.mkdir()
            (run / "summary.json").write_text(json.dumps(summary))
            (run / "job.yaml").write_text(JOB % "file: box.msh")
            origin = {"job": str(self.download.parent / "private" / "job.yaml"), "untrusted": False}
            (run / "origin.json").write_text(json.dumps(origin))
        (self.download / "run-shape" / "shape.msh").symlink_to("../../private/box.msh")
        shutil.copytree(self.download / "parts.bp", self.download / "run-parts" / "shape.bp")
        (self.download / "run-link").mkdir()
        (self.download / "run-link" / "summary.json").symlink_to("../../private/summary.json")


MESHES = ("body.py", "body.geo", "nodes.inp", "include.inp", "include.bdf", "outside.xdmf", "parts.bp", "link.msh")
IMAGES = ("file.mhd", "list.mhd", "pattern.mhd", "file.nrrd")
JOBS = (
    *("plugin.yaml", "start.yaml", "teach.yaml", "petsc.yaml", "obstacle.yaml"),
    *(f"mesh-{name}.yaml" for name in MESHES),
    *(f"image-{name}.yaml" for name in IMAGES),
)
SWEEPS = (*(f"sweep-{name}" for name in JOBS), "sweep-link.yaml")
STUDIES = (*(f"study-{name}" for name in JOBS), "study-link.yaml")
FEW = ("plugin.yaml", "start.yaml", "mesh-nodes.inp.yaml")
FEW_SWEEPS = ("sweep-plugin.yaml", "sweep-mesh-nodes.inp.yaml", "sweep-link.yaml")
RUNS = ("run-shape", "run-parts", "run-link")

COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "new": (
        ("new job --from {} --unit m --stress-unit MPa out.yaml", "nodes.inp", "include.inp"),
        ("new liver --image {} --label liver=1 out.yaml", *IMAGES),
    ),
    "run": (("run {} --output out", *JOBS),),
    "resume": (("resume {}", *RUNS),),
    "study run": (("study run {} --output out", "study-plugin.yaml", "study-link.yaml"),),
    "study status": (("study status {} --output out", "study-plugin.yaml", "study-link.yaml"),),
    "sweep plan": (("sweep plan {}", *SWEEPS),),
    **{
        f"sweep {action}": ((f"sweep {action} {{}}", *FEW_SWEEPS),)
        for action in ("run", "retry", "status", "table", "statistics", "indices")
    },
    "sweep teach": (("sweep teach {} --output start", *FEW_SWEEPS),),
    "sweep plot": (("sweep plot {} height --over material.mu", *FEW_SWEEPS),),
    "sweep submit": (("sweep submit {} --ntasks 1 --dry-run", *FEW_SWEEPS),),
    "validate": (("validate {}", *JOBS, *STUDIES),),
    "explain": (("explain {}", *JOBS),),
    "show": (("show {} --output out.png", *JOBS, *MESHES, *IMAGES),),
    "report": (("report {}", "run-link", *FEW_SWEEPS),),
    "dossier": (("dossier {}", "run-link"),),
    "export": (
        ("export {} --to out.stl", *RUNS),
        ("export {} --to out.msh", *RUNS),
        ("export {} --to out.msh --shape deformed", "run-given"),
        ("export {} --to out.step --refit 1mm", "run-shape"),
        ("export {} --deck out.inp", *RUNS),
    ),
    "second-opinion": (("second-opinion {}", *RUNS),),
    "laws": (("laws --from abaqus {} --stress-unit MPa", "nodes.inp", "include.inp"),),
    "fit": (("fit {} --law neo-hookean", "table.csv"),),
    "identify": (("identify {}", *FEW),),
    "serve": (("serve {} --port 0", *FEW),),
    "mesh from-image": (
        ("mesh from-image {} out.msh --size 5mm --label a=1", *IMAGES),
        ("mesh from-image {}", *IMAGES),
    ),
    "mesh from-surface": (("mesh from-surface {} out.msh --size 5mm --unit mm", "link.stl"),),
    "mesh from-cad": (("mesh from-cad {} out.msh --size 5mm", "link.step"),),
    "mesh show": (("mesh show {} --output out.png", *MESHES, *IMAGES),),
    "mesh partition": (("mesh partition {} out.bp --parts 1", *MESHES, *FEW),),
    "mesh gather": (("mesh gather {} out.msh", "parts.bp"),),
    "compare": (("compare {} good.msh", *MESHES, *IMAGES, *RUNS), ("compare good.msh {}", "body.py", "nodes.inp")),
}
"""arguments of each command that takes --untrusted, and the poisoned files on which it is tried"""
NAMED = ("link.msh", "link.stl", "link.step", "table.csv")
"""files that the user names himself, and that lead nowhere else: they are read, and nothing is refused"""


@pytest.fixture
def warm_checks(warm_process: WarmReader, monkeypatch: pytest.MonkeyPatch) -> None:
    """Contents of files are checked, and includes are followed, in forks of the reader, too."""
    monkeypatch.setattr(followed_includes, "run_child", warm_process.run)
    monkeypatch.setattr(mesh_contents, "subprocess", SimpleNamespace(run=warm_process.run))


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tree]:
    root = tmp_path_factory.mktemp("tree")
    (root / "download").mkdir()
    (root / "download").rmdir()
    result = Tree(root)
    yield result
    result.watch.close()


def ended(*arguments: str) -> object:
    """Return the exit code of a command; those that start ranks end by an exception."""
    try:
        return main([*arguments])
    except SystemExit as end:
        return end.code


def leaves(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    subparsers = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not subparsers:
        yield name, parser
    for action in subparsers:
        for word, inner in action.choices.items():
            yield from leaves(inner, f"{name} {word}".strip())


def test_every_command_with_files_takes_untrusted_and_is_tried() -> None:
    for name, parser in leaves(_parser()):
        takes_files = any(action.type is Path for action in parser._actions)
        assert ("--untrusted" in parser._option_string_actions) == takes_files, name
        assert (name in COMMANDS) == takes_files, name


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_opens_a_door(
    command: str, tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for template, *poisons in COMMANDS[command]:
        for poison in poisons:
            words = template.replace("good.msh", str(tree.download / "good.msh")).split()
            arguments = [str(tree.download / poison) if word == "{}" else word for word in words]
            code = ended(*arguments, "--untrusted")
            error = capfd.readouterr().err
            assert not tree.marker.exists(), arguments
            opened = tree.watch.opened()
            if poison not in NAMED:
                assert not opened, (arguments, error)
                assert code == 2, (arguments, error)
                assert "--untrusted" in error, (arguments, error)
                assert "Traceback" not in error


@pytest.mark.parametrize("poison", ["nodes.inp", "file.mhd"])
def test_the_watch_sees_what_is_opened(
    poison: str, tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --untrusted private files are opened, in this process or in the one that reads images."""
    monkeypatch.chdir(tmp_path)
    arguments = {"nodes.inp": ["laws", "--from", "abaqus", "--stress-unit", "MPa"], "file.mhd": ["mesh", "from-image"]}
    ended(*arguments[poison], str(tree.download / poison))
    assert tree.watch.opened()
