"""``hpcinv new``: its jobs are valid and run; what does not fit is refused, and nothing is overwritten or left."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import pyvista
from helpers.schemas import refusals

import hpcinv as package
from hpcinv.__main__ import main
from hpcinv.base.files.names import yaml_text
from hpcinv.base.parallel.runtime import MPI
from hpcinv.geometry.imaging import hollow_wall
from hpcinv.job.filling_points import filling_points
from hpcinv.job.yaml_reader import read_text, read_yaml
from hpcinv.mesh import build_body, read_source
from hpcinv.model.fibre_directions import rule_directions

pytestmark = pytest.mark.usefixtures("warm_reader")

KINDS = ("artery", "breast", "liver", "part", "shell", "ventricle")
SPACING = 5.0  # mm


def scan(path: Path) -> Path:
    """A segmented image: an ellipsoid with the label 5, in it a ball with the label 7."""
    sitk = pytest.importorskip("SimpleITK")
    grid = np.stack(np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (44, 34, 26)), indexing="ij"), axis=-1)
    voxels = np.where(((grid / [18, 13, 10]) ** 2).sum(-1) < 1, 5, 0)
    voxels[(grid**2).sum(-1) < 5**2] = 7
    image = sitk.GetImageFromArray(voxels.astype(np.uint8).transpose())
    image.SetSpacing((SPACING,) * 3)
    image.SetOrigin((-100, -60, 30))
    sitk.WriteImage(image, str(path))
    return path


def wall(path: Path, *, kind: str) -> Path:
    """A segmented wall (label 1) around a cavity (2): a cup, or an oblique tube cut by the image's border."""
    sitk = pytest.importorskip("SimpleITK")
    x, y, z = np.meshgrid(
        *(np.arange(n) - (n - 1) / 2 for n in (30, 30, 22 if kind == "ventricle" else 12)), indexing="ij"
    )
    if kind == "ventricle":
        r2, z = x**2 + y**2, z - 6
        voxels = np.where(r2 / 13**2 + z**2 / 16**2 < 1, 1, 0)
        voxels[r2 / 8**2 + z**2 / 11**2 < 1] = 2
        voxels[z > 0] = 0
    else:
        r = np.hypot(x - 0.2 * z, y)
        voxels = np.where(r < 11, 1, 0)
        voxels[r < 6] = 2
    image = sitk.GetImageFromArray(voxels.astype(np.uint8).transpose())
    image.SetSpacing((2.0, 2.0, 2.0))
    sitk.WriteImage(image, str(path))
    return path


def surface(path: Path) -> Path:
    pyvista.Cylinder(radius=10, height=60, direction=(1, 0, 0), resolution=40).triangulate().save(path)
    return path


def typed(*arguments: object) -> int:
    return main(["new", *map(str, arguments)])


@pytest.mark.parametrize("kind", KINDS)
def test_examples_are_valid_jobs_next_to_their_mesh(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file = tmp_path / f"my-{kind}.yaml"
    assert typed(kind, file) == 0
    assert f"python -m hpcinv run {file}" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.iterdir()) == [file.name, f"my-{kind}_mesh.py"]
    assert main(["validate", str(file)]) == 0
    assert refusals(read_yaml(file)) == []
    text = file.read_text()
    assert "$" not in text
    assert "doi:10." in text
    assert "typical order of magnitude" in text or kind in ("part", "shell")


def test_a_ventricle_by_its_pressure_and_by_klotz_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lv.yaml"
    assert typed("ventricle", "--ed-pressure", "10 mmHg", file) == 0
    (pressure,) = package.load(file).effects
    assert pressure.quantities()["pressure"][0] == pytest.approx(1333.22, rel=1e-5)
    assert typed("ventricle", "--ed-pressure", "12 mmHg", "--klotz", "--force", file) == 0
    assert f"python -m hpcinv identify {file}" in capsys.readouterr().out
    job = package.load(file)
    assert job.identify is not None
    points = [point.pressure for point in filling_points("lv", job.cavities, job.quantities, job.states)]
    assert points == pytest.approx([share * 12 * 133.322387415 for share in (0.25, 0.5, 0.75, 0)])
    assert typed("liver", "--klotz", tmp_path / "liver.yaml") != 0
    assert "--klotz: is for a ventricle, and this is a liver" in capsys.readouterr().err
    assert typed("ventricle", "--ed-pressure", "10 mm", tmp_path / "other.yaml") != 0
    assert "--ed-pressure: must be a stress" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["liver", "breast", "part"])
def test_jobs_of_images_and_surfaces_are_valid_and_hold_the_right_end(kind: str, tmp_path: Path) -> None:
    (tmp_path / "jobs").mkdir()
    of_image, of_surface = (tmp_path / "jobs" / name for name in ("image.yaml", "surface.yaml"))
    assert typed(kind, "--image", scan(tmp_path / "a scan.nii.gz"), "--label", "organ=5,7", of_image) == 0
    job = package.load(of_image)
    assert job.resolve(job.mesh.file).samefile(tmp_path / "a scan.nii.gz")
    assert job.mesh.size == pytest.approx((4 / 3 * np.pi * 18 * 13 * 10 * 125e-9 / 240) ** (1 / 3), rel=0.1)
    (held,) = job.regions.values()
    # The ellipsoid lies at y from -40 to 90 mm, x from -82.5 to 97.5 mm, by its voxels' middles.
    axis, end, inner = ("x", -0.06, 0.0) if kind == "part" else ("y", 0.08, 0.03)
    assert held.evaluate(**{axis: end})
    assert not held.evaluate(**{axis: inner})
    assert typed(kind, "--surface", surface(tmp_path / "it.stl"), "--unit", "mm", "--size", "5 mm", of_surface) == 0
    assert package.load(of_surface).mesh.size == pytest.approx(5e-3)


@pytest.mark.release
def test_a_liver_from_a_scan_runs(tmp_path: Path) -> None:
    file = tmp_path / "liver.yaml"
    given = ("--label", "liver=5", "--label", "tumour=7", "--size", "25 mm")
    assert typed("liver", "--image", scan(tmp_path / "scan.nii.gz"), *given, file) == 0
    job = package.load(file).with_({"certificate": "quick"})
    result = package.run(job, MPI.COMM_SELF)
    assert result.certificate.verdict.value in ("pass", "warning")
    assert 1e-3 < float(result.quantities["largest-displacement"]) < 0.05


@pytest.mark.everyday("artery")
@pytest.mark.parametrize("kind", ["artery", "ventricle"])
def test_the_surfaces_of_a_wall_in_an_image_have_their_names(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "job.yaml"
    given = ("--label", "wall=1", "--label", "cavity=2", "--size", "14 mm" if kind == "artery" else "6 mm")
    assert typed(kind, "--image", wall(tmp_path / "scan.nii.gz", kind=kind), *given, file) == 0
    job = package.load(file)
    source = read_source(job.mesh, tmp_path / job.mesh.file)
    areas = {}
    for group in source.groups:
        if group.dim == 2:
            a, b, c = (source.points[source.facets[group.members][:, i]] for i in range(3))
            areas[group.name] = 1e6 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2  # mm²
    corners = source.points[source.cells]
    volume = abs(np.linalg.det(corners[:, 1:4] - corners[:, :1])).sum() / 6 * 1e9
    if kind == "artery":
        exact = {
            "inlet": 85 * 4 * np.pi,
            "outlet": 85 * 4 * np.pi,
            "inner": 2 * 12 * 24 * np.pi,
            "outer": 2 * 22 * 24 * np.pi,
        }
        expected = 85 * 4 * np.pi * 24
        rule = {"kind": "tube", "inner": "inner", "outer": "outer", "inlet": "inlet", "outlet": "outlet", "helix": 0}
    else:
        exact = {"base": 4 * np.pi * (13**2 - 8**2)}
        expected = 2 / 3 * np.pi * 8 * (13**2 * 16 - 8**2 * 11)
        rule = dict(job.fibres["fibre"].rule or {})
    print({name: f"{areas[name] / value:.2f}" for name, value in exact.items()}, f"volume {volume / expected:.3f}")
    assert volume == pytest.approx(expected, rel=0.03)
    for name, value in exact.items():
        assert areas[name] == pytest.approx(value, rel=0.2), name
    with_rule = job.with_({"fibres": {"fibre": {"rule": rule, "given_on": "current"}}})
    family = with_rule.fibres["fibre"].rule
    assert family is not None
    body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve)
    assert rule_directions(body, family, "fibres.fibre").undefined < 0.01 * len(source.cells)


def test_a_wall_with_a_hole_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A leak of the cavity through the apex is too small for an opening, and the surfaces meet around it."""
    sitk = pytest.importorskip("SimpleITK")
    scan_file = wall(tmp_path / "scan.nii.gz", kind="ventricle")
    image = sitk.ReadImage(str(scan_file))
    voxels = sitk.GetArrayFromImage(image)
    leak = voxels[:8, 14:16, 14:16]
    leak[leak == 1] = 2
    image = sitk.GetImageFromArray(voxels)
    image.SetSpacing((2.0, 2.0, 2.0))
    sitk.WriteImage(image, str(scan_file))
    given = ("--label", "wall=1", "--label", "cavity=2", "--size", "6 mm")
    assert typed("ventricle", "--image", scan_file, *given, tmp_path / "job.yaml") == 2
    assert re.search("the wall has a hole, or no thickness, near .*: 'endo' touches 'epi'", capsys.readouterr().err)
    assert not list(tmp_path.glob("job*"))


def branched(path: Path, *, closed: bool = False) -> Path:
    """A segmented vessel (wall 1, cavity 2) along z, with a narrower branch along x."""
    sitk = pytest.importorskip("SimpleITK")
    x, y, z = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (32, 20, 22)), indexing="ij")
    trunk, branch = np.hypot(x + 6, y), np.where(x > -6, np.hypot(y, z), np.inf)
    voxels = np.where((trunk < 8) | (branch < 6.5), 1, 0)
    voxels[((trunk < 4) & ((np.abs(z) < 8) | (not closed))) | (branch < 3)] = 2
    image = sitk.GetImageFromArray(voxels.astype(np.uint8).transpose())
    image.SetSpacing((2.0, 2.0, 2.0))
    sitk.WriteImage(image, str(path))
    return path


def test_all_ends_of_a_branched_vessel_are_found_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "vessel.yaml"
    labels = ["--label", "wall=1", "--label", "cavity=2"]
    assert typed("artery", "--image", branched(tmp_path / "scan.nii.gz"), *labels, "--size", "12 mm", file) == 0
    job = package.load(file)
    names = ["inlet", "outlet 1", "outlet 2"]
    assert [support.region for support in job.supports] == names
    source = read_source(job.mesh, job.resolve(job.mesh.file))
    middles = {
        group.name: source.points[np.unique(source.facets[group.members])].mean(axis=0)
        for group in source.groups
        if group.dim == 2
    }
    assert set(names) | {"inner", "outer"} == set(middles)
    ends = np.sort([abs(middles[name][2] - middles["outer"][2]) for name in names])
    assert ends[0] < 5e-3  # the branch
    assert ends[1:] == pytest.approx([22e-3, 22e-3], abs=5e-3)  # the trunk, one of its ends is the inlet
    capsys.readouterr()


def test_the_ends_of_a_vessel_are_counted_before_it_is_meshed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(hollow_wall, "image_mesh", lambda *_: pytest.fail("it was meshed"))
    labels = ["--label", "wall=1", "--label", "cavity=2"]
    for kind, scan_file, message in (
        ("artery", branched(tmp_path / "branch.nii.gz", closed=True), "has 1 opening .* but 2 or more are needed"),
        ("ventricle", branched(tmp_path / "open.nii.gz"), r"has 3 openings .* but 1 is needed \(base\)"),
        ("artery", wall(tmp_path / "cup.nii.gz", kind="ventricle"), "has 1 opening .* but 2 or more are needed"),
    ):
        assert typed(kind, "--image", scan_file, *labels, tmp_path / "job.yaml") == 2
        assert re.search(message, capsys.readouterr().err)


@pytest.mark.release
@pytest.mark.parametrize("kind", KINDS)
def test_examples_run_and_certify(kind: str, tmp_path: Path) -> None:
    assert typed(kind, tmp_path / "job.yaml") == 0
    result = package.run(package.load(tmp_path / "job.yaml"), MPI.COMM_SELF)
    assert result.certificate.verdict.value in ("pass", "warning")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "liver --image scan.nii.gz job.yaml",
            "--label: is needed with --image, such as --label liver=1; in .* are 5 .*L.*, 7 .*ml",
        ),
        (
            "liver --image scan.nii.gz --label liver=4 job.yaml",
            r"no voxel has the label 4 \('liver'\); the labels in it",
        ),
        ("liver --image scan.nii.gz --label liver job.yaml", "the region 'liver' has no label"),
        ("liver --image scan.nii.gz --label liver=x job.yaml", "--label liver=x: is written NAME=NUMBER"),
        (
            "liver --image it.stl --label liver=5 job.yaml",
            "--image it.stl: is not in a format of images; the endings are .nii",
        ),
        ("liver --image no.nii.gz --label liver=5 job.yaml", "--image no.nii.gz: no such file"),
        ("liver --label liver=5 job.yaml", "--label: is for an image, and there is no --image"),
        ("part --surface it.stl job.yaml", "--unit: is needed with --surface"),
        ("part --surface it.stl --unit kg job.yaml", "--unit kg: is not a unit of length"),
        ("part --surface it.stl --unit mm --size 3_kg job.yaml", "--size 3_kg: "),
        (
            "artery --surface it.stl --unit mm job.yaml",
            "--surface: does not distinguish cavity and outside of an artery",
        ),
        ("artery --image scan.nii.gz job.yaml", "such as --label wall=1 --label cavity=2; in .* are 5 .*L.*, 7 .*ml"),
        ("artery --image scan.nii.gz --label wall=5 job.yaml", "--label: an artery has two regions in an image"),
        (
            "artery --image scan.nii.gz --label wall=5 --label cavity=7 --size 20_mm job.yaml",
            "the cavity has 0 openings at the outside or the border, but 2 or more are needed",
        ),
        ("part --size 3 job.yaml", "--size: is for an --image or a --surface"),
        ("part --surface it.stl --image scan.nii.gz job.yaml", "--surface: a job has one mesh"),
        ("part job.txt", "job.txt: is not a name of a job"),
        ("part no/job.yaml", "there is not a directory no"),
        ("part '.yaml", "'.yaml: cannot be the name of a job"),
        ("liver --image scan.nii.gz --label a:b=5 job.yaml", "mesh.labels"),
    ],
)
def test_unsuitable_arguments_are_refused_and_leave_nothing(
    arguments: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    scan(tmp_path / "scan.nii.gz")
    surface(tmp_path / "it.stl")
    before = sorted(tmp_path.iterdir())
    assert typed(*(word.replace("20_mm", "20 mm") for word in arguments.split())) == 2
    assert re.search(message, capsys.readouterr().err)
    assert sorted(tmp_path.iterdir()) == before


def test_files_are_replaced_only_by_force(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file, mesh = tmp_path / "part.yaml", tmp_path / "part_mesh.py"
    for existing in (file, mesh):
        existing.write_text("mine")
        assert typed("part", file) == 2
        assert f"{existing}: exists" in capsys.readouterr().err
        assert [p.read_text() for p in tmp_path.iterdir()] == ["mine"]
        existing.unlink()
    file.write_text("mine")
    assert typed("part", "--force", file) == 0
    assert main(["validate", str(file)]) == 0


@pytest.mark.parametrize("name", ["a\nplugins: [evil.py]\n#", "a\u2028plugins: [evil.py]\u2028", 'a"\\', "a\x85b: ü"])
def test_names_of_files_are_data(name: str, tmp_path: Path) -> None:
    """Neither the comment of the job nor its section 'mesh' gets a line from a name."""
    image = scan(tmp_path / f"{name}.nii.gz")
    directory = tmp_path / name
    directory.mkdir()
    for file in (tmp_path / "job.yaml", directory / "job.yaml"):
        assert typed("liver", "--image", image, "--label", "liver=5,7", file) == 0
        assert "plugins" not in read_yaml(file)
        job = package.load(file)
        assert job.resolve(job.mesh.file).resolve() == image
        lines = file.read_text(encoding="utf-8").splitlines()
        assert not [line for line in lines if line.startswith("plugins")]


@pytest.mark.parametrize(
    "text", ["plain/file-1.nii", "1e3", "yes", "No", "a: b", " a ", "-", "#", "\u2028", "😀\n", "", "{a}"]
)
def test_texts_are_read_from_yaml_as_they_were(text: str) -> None:
    assert read_text(f"value: {yaml_text(text)}", "test") == {"value": text}
    assert read_text(f"list: [{yaml_text(text)}, 1]", "test") == {"list": [text, 1]}
