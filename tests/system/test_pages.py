"""Shell and Python blocks of README, first pages and guides, typed where the files are that a reader has.

Short pages run their commands in the process of the test. Numbers of ranks, parts and cells are made smaller. A page
says above a block which of its commands are not typed here, and why: ``<!-- not typed: PATTERN, REASON -->``; the
pattern is a regular expression.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import pyvista
import yaml
from helpers.command_line import BLOCK, ROOT, write_job
from helpers.freecad_deck import deck
from helpers.typed import blocks, files, run_line, run_python, type_in

OTHERS = [*(ROOT / "docs").glob("tutorials/*.md"), ROOT / "docs/start/your-own-mesh.md", ROOT / "docs/reference/api.md"]
PAGES = [ROOT / "README.md", *sorted(set((ROOT / "docs").glob("*/*.md")) - set(OTHERS))]
# Run before a release.
LONG = {"README.md", "fit.md", "identify.md", "new.md", "report.md", "start-up.md", "study.md", "sweep.md"}
BEFORE = {"report.md": ["hpcinv sweep run sweep.yaml", "hpcinv study study.yaml"]}
GALLERY = re.findall(r"`((?:mpirun|python) [^`]*)`", (ROOT / "docs" / "gallery.md").read_text())
GALLERY_ENDS = {"paper-monte-carlo.yaml --first 500": 3}  # some of its cases have no solution
SMALLER = (
    (r"mpirun -n \d+", "mpirun -n 2"),
    (r"--parts \d+", "--parts 2"),
    (r"=34\b", "=3"),
    (r"--ranks-per-case 4", "--ranks-per-case 2"),
    (r"jobs/\*\.yaml", "jobs/single-tetrahedron.yaml jobs/column.yaml"),
    (r"/(?:shared|project)/kernels", "kernels"),
    (r"^python3 -m uv run ", ""),
    (r"run jobs/carotid.yaml", "validate jobs/carotid.yaml"),
)


def pages() -> Iterator[object]:
    for page in PAGES:
        if any(text for _, text in blocks(page)):
            marks = [pytest.mark.release] if page.name in LONG else []
            yield pytest.param(page, id=page.stem, marks=marks)


def smaller(line: str) -> str:
    for pattern, other in SMALLER:
        line = re.sub(pattern, other, line)
    return line


STATES = [
    {"name": "prone", "given": True, "effects": BLOCK["effects"]},
    {"name": "rest"},
    {"name": "supine", "effects": [BLOCK["effects"][0] | {"acceleration": [0, 0, 9.81]}]},
]
SWEEP = {
    "sweep": "block",
    "job": "job.yaml",
    "set": {"output.mesh": ["vtu"]},
    "axes": [
        {
            "sobol": {
                "material.mu": {"normal": ["10 kPa", "0.5 kPa"]},
                "material.lam": {"normal": ["40 kPa", "1 kPa"]},
            },
            "count": 8,
            "seed": 1,
        }
    ],
}
STUDY = {
    "study": "block",
    "job": "job.yaml",
    "series": [{"name": "P2", "vary": {"mesh.parameters.nx": [1, 2]}}],
    "measure": ["tip"],
    "reference": {"tip": "0.1 m"},
}


def ball(path: Path, radius: float) -> None:
    """An image of a ball, with its middle at one ``radius`` (mm) along each axis, of labels 5, then 6 and 7 inside."""
    SimpleITK = pytest.importorskip("SimpleITK")
    spacing = radius / 12
    axis = (np.arange(31) - 3) * spacing - radius
    distance = np.sqrt(sum(x**2 for x in np.meshgrid(axis, axis, axis, indexing="ij")))
    voxels = np.select([distance < x * radius for x in (0.3, 0.5, 1)], [7, 6, 5])
    image = SimpleITK.GetImageFromArray(voxels.astype(np.uint8))
    image.SetSpacing([spacing] * 3)
    image.SetOrigin([-3 * spacing] * 3)
    SimpleITK.WriteImage(image, str(path))


def rubber_tests(directory: Path) -> None:
    """Tables of two tests of an incompressible material of Mooney and Rivlin."""
    stretch = np.linspace(1.1, 2.0, 10)
    for mode, power in (("uniaxial", -2), ("planar", -3)):
        stress = 0.4 * (stretch - stretch**power) + 0.1 * (1 - stretch ** (power - 1))
        rows = "".join(f"{a:.4f}, {b:.4f}\n" for a, b in zip(stretch, stress, strict=True))
        (directory / f"{mode}.csv").write_text(f"# mode: {mode}\nstretch, nominal stress [MPa]\n{rows}")


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the reader of the pages has."""
    directory = tmp_path_factory.mktemp("reader")
    for name in ("jobs", "benchmarks"):
        shutil.copytree(ROOT / name, directory / name)
    (directory / "docs" / "pictures").mkdir(parents=True)
    (directory / "meshes").symlink_to(ROOT / "meshes")
    write_job(directory / "jobs" / "pdms-beam.yaml", BLOCK)
    (directory / "download").mkdir()
    tip = [{"name": "tip", "of": "uz", "at": [0.5, 0.5, 1]}]
    write_job(directory / "job.yaml", BLOCK, quantities=tip)
    for name, text in (("sweep", SWEEP), ("study", STUDY)):
        (directory / f"{name}.yaml").write_text(yaml.safe_dump(text))
    write_job(directory / "breast.yaml", {k: v for k, v in BLOCK.items() if k != "effects"}, states=STATES)
    write_job(directory / "liver.yaml", BLOCK)
    write_job(directory / "large.yaml", BLOCK, mesh={"file": "body.bp"})
    write_job(directory / "download" / "job.yaml", BLOCK, mesh={"file": "body.msh"})
    for line in (
        "mpirun -n 2 hpcinv run liver.yaml",
        "mpirun -n 2 hpcinv run breast.yaml",
        "rm liver.yaml && cp -r results/liver results/pdms-beam",
        """sed -i 's/"x0"/"spine"/' results/liver/shape.msh""",
        "cp results/liver/shape.msh body.msh",
        "cp body.msh download",
    ):
        run_line(line, directory)
    rubber_tests(directory)
    (directory / "Mesh.inp").write_text(deck())
    ball(directory / "scan.nii.gz", 20)
    ball(directory / "later.nii.gz", 500)
    for name in ("straight.stl", "scan.stl"):
        pyvista.Cube(center=(500, 500, 500), x_length=1000, y_length=1000, z_length=1000).triangulate().save(
            directory / name
        )
    return directory


@pytest.mark.parametrize("page", list(pages()))
def test_commands_of_a_page_run(page: Path, prepared: Path, tmp_path: Path) -> None:
    directory = tmp_path / "reader"
    shutil.copytree(prepared, directory, symlinks=True)
    typed = type_in if page.name in LONG else run_line
    for line in BEFORE.get(page.name, ()):
        typed(line, directory)
    for name, text in files(page).items():
        (directory / name).write_text(text)
    for language, text in blocks(page):
        if language == "python":
            (directory / "typed.py").write_text(text)
            if page.name in LONG or "class " in text:  # effects of this process would be known to later tests
                type_in("python typed.py", directory)
            else:
                run_python(text, directory)
        for line in text.splitlines() if language == "sh" else ():
            if line and not line.startswith("#"):
                typed(smaller(line), directory)


@pytest.mark.release  # twenty minutes
@pytest.mark.parametrize("line", GALLERY)
def test_commands_of_the_gallery(line: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "jobs", tmp_path / "jobs")
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")
    type_in(line, tmp_path, ends=GALLERY_ENDS.get(line.split("/")[-1], 0))
    assert any((tmp_path / "results").iterdir())


def test_commands_stand_in_blocks_of_shell() -> None:
    """An indented command would not be typed."""
    indented = re.compile(r"^ {4,}(?:mpirun -n \d+ )?(?:python3? -m )?hpcinv (?!:).*", re.M)
    assert not {page.name: lines for page in PAGES if (lines := indented.findall(page.read_text()))}
