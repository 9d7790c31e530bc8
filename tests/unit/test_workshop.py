"""Shapes as closed surfaces, their files read back by other means than they are written, and moulds."""

from __future__ import annotations

import json
import re
import struct
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import pyvista
from helpers.sheets import sheet
from helpers.small_files import small_files

from hpcinv.__main__ import main
from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.mesh_formats import MESHES as SAVED
from hpcinv.errors import MeshError, OutputError
from hpcinv.geometry.workshop.cell_mesh import write_cells
from hpcinv.geometry.workshop.formats import WRITERS, write
from hpcinv.geometry.workshop.mould import Split, loose_pieces, mould, undercut
from hpcinv.geometry.workshop.solid import Solid, region_cells, solid_of, volume_of
from hpcinv.job.job import load as load_job
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.body import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.midsurface import thicken
from hpcinv.mesh.readers import FILES
from hpcinv.mesh.source import MeshSource
from hpcinv.output.run_directory import RunDirectory

MESHES = Path(__file__).parents[2] / "meshes"
BLOCK: dict[str, Any] = {"lx": 0.06, "ly": 0.03, "lz": 0.02, "nx": 3, "ny": 2, "nz": 2}
INNER, OUTER = 0.02, 0.03
SPHERE: dict[str, Any] = {"inner": INNER, "outer": OUTER, "radial": 1, "along": 2}


def meshed(name: str, **mesh: Any) -> MeshSource:
    spec = MeshSpec.model_validate({"file": name, **mesh}, context={"directory": MESHES})
    return read_source(spec, MESHES / name)


@pytest.fixture(scope="module", params=[False, True], ids=["tetrahedra", "hexahedra"])
def sphere(request: pytest.FixtureRequest) -> MeshSource:
    return meshed("thick_sphere.py", parameters={**SPHERE, "hexahedra": request.param}, geometry_degree=2)


@pytest.mark.parametrize("hexahedra", [False, True])
def test_straight_bodies_keep_their_volume(hexahedra: bool) -> None:
    source = meshed("box.py", parameters={**BLOCK, "hexahedra": hexahedra})
    solid = solid_of(source, None)
    assert solid.is_closed
    assert solid.volume == pytest.approx(0.06 * 0.03 * 0.02, rel=1e-12)
    assert volume_of(source, None) == pytest.approx(0.06 * 0.03 * 0.02, rel=1e-12)


def test_curved_bodies_have_their_volume(sphere: MeshSource) -> None:
    """Quadratic cells are 1e-4 of an octant of a hollow sphere; their surface has their volume to 1e-5."""
    solid, volume = solid_of(sphere, None), volume_of(sphere, None)
    assert solid.is_closed
    assert solid.volume == pytest.approx(volume, rel=1e-5)
    assert volume == pytest.approx(np.pi / 6 * (OUTER**3 - INNER**3), rel=3e-3)


@pytest.mark.parametrize("hexahedra", [False, True])
def test_triangles_keep_to_the_tolerance(hexahedra: bool) -> None:
    """The top of a block becomes a parabola, which quadratic cells have exactly."""
    rise, length, tolerance = 0.01, BLOCK["lx"], 2e-5
    straight = meshed("box.py", parameters={**BLOCK, "hexahedra": hexahedra}, geometry_degree=2)
    points = straight.points.copy()
    points[:, 2] += 4 * rise * points[:, 0] * (length - points[:, 0]) / length**2
    corners = (solid := solid_of(replace(straight, points=points), None, tolerance)).points[solid.triangles]

    def above(at: np.ndarray) -> np.ndarray:
        x = at[..., 0]
        return np.asarray(at[..., 2] - BLOCK["lz"] - 4 * rise * x * (length - x) / length**2)

    top = corners[np.abs(above(corners)).max(axis=1) < tolerance]
    middles = np.concatenate([top.mean(axis=1), *((top[:, i] + top[:, i - 1]) / 2 for i in range(3))])
    assert tolerance / 3 < np.abs(above(middles)).max() <= tolerance
    shadow = np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0])[:, 2].sum() / 2
    assert shadow == pytest.approx(BLOCK["lx"] * BLOCK["ly"], rel=1e-9)  # so that these are all of the top


def test_a_finer_surface_is_nearer(sphere: MeshSource) -> None:
    counts = [len(solid_of(sphere, None, tolerance).triangles) for tolerance in (1e-4, 1e-5, 1e-6)]
    assert counts[0] * 5 < counts[1]
    assert counts[1] * 5 < counts[2]
    with pytest.raises(OutputError, match=r"would take .* triangles"):
        solid_of(sphere, None, 1e-11)


def test_a_region_is_closed_by_itself() -> None:
    source = meshed("box.py", parameters={**BLOCK, "hexahedra": True})
    left = np.flatnonzero(source.points[source.cells][:, :, 0].max(axis=1) < 0.041)
    solid = solid_of(source, left)
    assert solid.is_closed
    assert solid.volume == pytest.approx(0.04 * 0.03 * 0.02, rel=1e-12)
    assert len(region_cells(source, "block")) == len(source.cells)
    with pytest.raises(MeshError, match="no region of cells 'blok'"):
        region_cells(source, "blok")


def test_cells_that_touch_at_an_edge_are_refused() -> None:
    source = meshed("box.py", parameters={**BLOCK, "hexahedra": True})
    middles = source.points[source.cells].mean(axis=1) / [0.02, 0.015, 0.01]
    checkered = np.flatnonzero((middles.astype(int).sum(axis=1) % 2 == 0) & (middles[:, 2] < 1))
    with pytest.raises(MeshError, match="not a closed surface"):
        solid_of(source, checkered)


def read_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    content = path.read_bytes()
    (count,) = struct.unpack_from("<I", content, 80)
    rows = np.frombuffer(content, np.dtype([("v", "<f4", (4, 3)), ("a", "<u2")]), count, 84)["v"].astype(float)
    points, place = np.unique(rows[:, 1:].reshape(-1, 3), axis=0, return_inverse=True)
    triangles = place.reshape(-1, 3)
    normals = np.cross(*(points[triangles[:, i]] - points[triangles[:, 0]] for i in (1, 2)))
    assert (np.einsum("ni,ni->n", normals, rows[:, 0]) > 0).mean() > 0.99  # normals of tiny triangles are rounded
    return points, triangles


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    head, _, body = path.read_bytes().partition(b"end_header\n")
    assert b"binary_little_endian" in head
    vertices, faces = (int(head.split(f"element {name} ".encode())[1].split()[0]) for name in ("vertex", "face"))
    points = np.frombuffer(body, "<f4", 3 * vertices).reshape(-1, 3)
    rows = np.frombuffer(body, np.dtype([("n", "u1"), ("v", "<i4", 3)]), faces, points.nbytes)
    assert (rows["n"] == 3).all()
    return points.astype(float), rows["v"].astype(np.int64)


def read_3mf(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        model = ET.fromstring(archive.read("3D/3dmodel.model"))
    assert model.get("unit") == "millimeter"
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    vertices = [[float(v.get(i, "")) for i in "xyz"] for v in model.iter(f"{core}vertex")]
    triangles = [[int(t.get(f"v{i}", "")) for i in (1, 2, 3)] for t in model.iter(f"{core}triangle")]
    assert len(list(model.iter(f"{core}item"))) == 1
    return np.array(vertices), np.array(triangles)


def read_step(path: Path) -> tuple[np.ndarray, np.ndarray]:
    text = path.read_text()
    rows = re.findall(r"#(\d+)=CARTESIAN_POINT\('',\(([^)]*)\)\)", text)
    place = {number: row for row, (number, _) in enumerate(rows)}
    loops = re.findall(r"POLY_LOOP\('',\(#(\d+),#(\d+),#(\d+)\)\)", text)
    points = np.array([[float(entry) for entry in values.split(",")] for _, values in rows])
    return points, np.array([[place[number] for number in loop] for loop in loops])


READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".stl": read_stl,
    ".ply": read_ply,
    ".3mf": read_3mf,
    ".step": read_step,
    ".stp": read_step,
}


def read(path: Path) -> Solid:
    return Solid(*READERS[path.suffix](path))


@pytest.mark.everyday("tetrahedra-.stl", "tetrahedra-.ply", "hexahedra-.stl", "hexahedra-.ply", "hexahedra-.3mf")
@pytest.mark.parametrize("suffix", WRITERS)
def test_files_hold_the_solid(suffix: str, sphere: MeshSource, tmp_path: Path) -> None:
    solid = solid_of(sphere, None, 1e-5).scaled(1e3)
    write(tmp_path / f"a{suffix}", solid, "mm")
    mesh_read = read(tmp_path / f"a{suffix}")
    assert mesh_read.is_closed
    assert mesh_read.volume == pytest.approx(solid.volume, rel=1e-6)
    assert len(mesh_read.triangles) == len(solid.triangles)
    np.testing.assert_allclose(mesh_read.size, OUTER * 1e3, rtol=1e-3)
    assert [path.name for path in tmp_path.iterdir()] == [f"a{suffix}"]


@pytest.mark.everyday(".inp", ".vtu")
@pytest.mark.parametrize("suffix", [s for s in dict.fromkeys(FORMATS[s].suffix for s in SAVED) if s != ".mesh"])
def test_mesh_files_hold_the_thick_body_of_a_shell(suffix: str, tmp_path: Path) -> None:
    """A part of a cylinder, written in mm, comes back as solid cells of the same volume with the shell's regions."""
    source = sheet(tmp_path / "sheet.msh", 3, 2, lambda s, t: np.column_stack([np.cos(s), np.sin(s), t]))
    shell = thicken(source, Shell(thickness=0.1, layers={"core": 3.0, "coat": 1.0}))
    path = tmp_path / f"thick{suffix}"
    written = write_cells(path, shell, None, 0.5, 1e-3)
    read = FILES[suffix](path).convert_to_metres(1e-3)
    check(read)
    assert volume_of(read, None) == pytest.approx(volume_of(written, None), rel=1e-9)
    assert volume_of(read, None) == pytest.approx(0.1 / 8, rel=1e-3)  # area × thickness, halved lengths
    if suffix == ".cdb":  # its components are nodes
        return
    sizes = {group.name: len(group.members) for group in read.groups}
    assert {"outer": 6, "inner": 6, "core": 6, "coat": 6, "x0": 4, "sheet_outer": 6}.items() <= sizes.items()
    core = write_cells(path, shell, region_cells(shell, "core"), 1.0, 1.0)
    assert volume_of(FILES[suffix](path), None) == pytest.approx(volume_of(core, None), rel=1e-9)
    assert volume_of(core, None) == pytest.approx(0.075 * (1 - 0.0125), rel=1e-3)
    assert "outer" not in {group.name for group in core.groups}


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path: Path) -> None:
    """Files may have 20,000 bytes; libraries would write half a file, or abort."""
    import lib3mf  # noqa: F401  (a first import needs files of its own)

    sphere = pyvista.Sphere(theta_resolution=60, phi_resolution=60)
    solid = Solid(np.asarray(sphere.points, dtype=float), np.asarray(sphere.regular_faces, dtype=np.int64))
    for suffix in WRITERS:
        with small_files(20_000), pytest.raises(OutputError, match=rf"part\{suffix}: cannot be written: "):
            write(tmp_path / f"part{suffix}", solid, "mm")
    assert list(tmp_path.iterdir()) == []


def test_mould_is_the_block_without_the_part(sphere: MeshSource) -> None:
    part = solid_of(sphere, None, 1e-5).scaled(1e3)
    block = float(np.prod(part.size + 10))
    (whole,) = mould(part, 5.0, None).blocks
    halves = mould(part, 5.0, Split(0, 12.0)).blocks
    for solid in (whole, *halves):
        assert solid.is_closed
        assert solid.round_to_single().is_closed
    assert whole.volume == pytest.approx(block - part.volume, rel=1e-6)
    assert sum(half.volume for half in halves) == pytest.approx(whole.volume, rel=1e-6)
    assert halves[0].points[:, 0].max() == pytest.approx(12.0)
    assert halves[1].points[:, 0].min() == pytest.approx(12.0)


def hollow_box() -> Solid:
    """A cube of 10 with a closed chamber of 4 x 2 x 2."""
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    points = np.concatenate([10 * corners, np.array([3, 4, 4]) + corners * [4, 2, 2]])
    return Solid(points, np.concatenate([triangles, triangles[:, ::-1] + 8]))


def test_run_for_opencarp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", str(finished(tmp_path / "run")), "--to", str(tmp_path / "heart.pts"), "--scale", "2"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "tetrahedra in µm, volume 383 ml" in printed
    assert "ratio 1.000000" in printed
    assert "directions: none in the shape, (1, 0, 0) instead" in printed
    assert sorted(path.suffix for path in tmp_path.glob("heart*")) == [".elem", ".lon", ".pts"]
    assert main([*command, "--mould", str(tmp_path / "m.stl")]) == 2
    assert "--mould: is for surfaces" in capsys.readouterr().err


def test_a_closed_chamber_has_a_core_of_its_own() -> None:
    part = hollow_box()
    assert part.is_closed
    assert part.volume == pytest.approx(1000 - 16)
    made = mould(part, 1.0, Split(2))
    (core,) = made.cores
    assert core.is_closed
    assert core.volume == pytest.approx(16)
    assert [half.volume for half in made.blocks] == pytest.approx([(12**3 - 1000) / 2] * 2)
    assert [loose_pieces(half) for half in made.blocks] == [0, 0]
    assert undercut(part, Split(2)) == 0.0


def test_pieces_of_a_half_that_hold_nowhere_are_counted() -> None:
    """A tube with a closed end, cut across its bore: what fills the bore is apart from the lower half."""
    outer = hollow_box().shells()[0]
    side = manifold3d.Manifold.cube((2.0, 12.0, 2.0)).translate((4.0, 5.0, 4.0))
    solid = manifold3d.Manifold(manifold3d.Mesh64(outer.points, outer.triangles.astype(np.uint64))) - side
    mesh = solid.to_mesh64()
    part = Solid(np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64))
    lower, upper = mould(part, 1.0, Split(1, 7.0)).blocks
    assert [loose_pieces(half) for half in (lower, upper)] == [1, 0]
    assert min(abs(shell.volume) for shell in lower.shells()) == pytest.approx(2 * 2 * 2)


def test_core_of_a_run_is_a_file_with_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = finished(tmp_path / "run")
    sides = {"lx": 0.03, "ly": 0.03, "lz": 0.03, "nx": 3, "ny": 3, "nz": 3}
    box = meshed("box.py", parameters={**sides, "hexahedra": True})
    is_middle = np.linalg.norm(box.points[box.cells].mean(axis=1) - 0.015, axis=1) < 0.001
    hollow = replace(box, cells=box.cells[~is_middle], groups=())
    save(run / "shape.msh", hollow, hollow.points)
    command = ["export", str(run), "--to", str(tmp_path / "part.stl"), "--mould", str(tmp_path / "mould.stl")]
    assert main([*command, "--split", "z"]) == 0
    warned = capsys.readouterr().err
    assert (
        "mould-core.stl: is the core of a closed chamber: hold it inside the mould, and melt or dissolve it" in warned
    )
    assert "undercuts" not in warned
    core, lower = (read(tmp_path / f"mould-{name}.stl") for name in ("core", "1"))
    assert core.is_closed
    assert core.volume == pytest.approx(1e3, rel=1e-6)
    assert len(lower.shells()) == 1
    command[3] = str(tmp_path / "mould-core.stl")
    assert main([*command, "--split", "z"]) == 2
    assert "is the file of the core of the mould" in capsys.readouterr().err


def test_undercuts_hold_a_mould_back() -> None:
    """A block has none; of half a hollow sphere, split through its rim, the inside has."""
    block = solid_of(meshed("box.py", parameters=BLOCK), None)
    assert undercut(block, Split(2)) == 0.0
    sphere = solid_of(meshed("thick_sphere.py", parameters=SPHERE), None)
    assert undercut(sphere, Split(2)) > 0.05
    with pytest.raises(OutputError, match="misses the part"):
        undercut(block, Split(2, 1.0))


def finished(
    directory: Path, *, direction: str = "inverse", status: str = "converged", load: float = 1.0, **job: Any
) -> Path:
    """A run directory with a shape 1.1 times as large as the mesh that was given."""
    content = {
        "job": "block",
        "analysis": direction,
        "mesh": {"file": str(MESHES / "box.py"), "parameters": BLOCK},
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        **job,
    }
    (directory.parent / "job.yaml").write_text(json.dumps(content))
    run = RunDirectory(directory)
    lock = run.create(load_job(directory.parent / "job.yaml"), overwrite=False)
    assert lock is not None
    lock.release()
    if status:
        summary = {"status": status, "solutions": [{"direction": direction, "load": load}]}
        (directory / "summary.json").write_text(json.dumps(summary))
        source = meshed("box.py", parameters=BLOCK)
        save(directory / "shape.msh", source, 1.1 * source.points)
    return directory


VOLUME = 60.0 * 30 * 20  # mm³


@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_shapes_of_a_run(direction: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = finished(tmp_path / "run", direction=direction)
    volumes = {}
    for shape in ("undeformed", "deformed"):
        path = tmp_path / f"{shape}.3mf"
        assert main(["export", str(run), "--to", str(path), "--shape", shape, "--scale", "1.02"]) == 0
        volumes[shape] = read(path).volume / (VOLUME * 1.02**3)
    computed_shape = "undeformed" if direction == "inverse" else "deformed"
    assert volumes.pop(computed_shape) == pytest.approx(1.1**3, rel=1e-6)
    assert volumes.popitem()[1] == pytest.approx(1.0, rel=1e-6)
    assert "ratio 1.000000" in capsys.readouterr().out


def test_mould_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--to", tmp_path / "part.stl", "--mould", tmp_path / "mould.ply", "--unit", "cm", "--wall", "5 mm"]
    command = ["export", *map(str, [finished(tmp_path / "run"), *options]), "--split"]
    assert main([*command, "z=15 mm"]) == 0
    part, lower, upper = (read(tmp_path / name) for name in ("part.stl", "mould-1.ply", "mould-2.ply"))
    assert part.volume == pytest.approx(VOLUME * 1.1**3 / 1e3, rel=1e-6)
    area, hole = 7.6 * 4.3, 6.6 * 3.3
    assert lower.volume == pytest.approx(area * 2.0 - hole * 1.5, rel=1e-6)
    assert upper.volume == pytest.approx(area * 1.2 - hole * 0.7, rel=1e-6)
    assert lower.is_closed
    assert upper.is_closed
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "a.obj"], "a.obj: the formats of solids are .stl, .ply, .3mf"),
        (["--to", "nowhere/a.stl"], "there is not a directory nowhere"),
        (["--to", "a.3mf", "--unit", "km"], "3MF knows no unit 'km'"),
        (["--to", "a.stl", "--unit", "kg"], "--unit kg: is not a unit of length"),
        (["--to", "a.stl", "--scale", "0"], "--scale 0: must be above 0"),
        (["--to", "a.stl", "--tolerance", "0.1"], "--tolerance 0.1: must be a length with a unit"),
        (["--to", "a.stl", "--split", "z"], "Give --mould FILE"),
        (["--to", "a.stl", "--mould", "m.stl", "--split", "q"], "must be x, y or z"),
        (["--to", "a.stl", "--mould", "m.stl", "--split", "z=1 m"], "--split z=1000: misses the part"),
        (["--to", "a.stl", "--mould", "m.stl", "--wall", "-1 mm"], "--wall -1 mm: must be above 0"),
        (["--to", "a.stl", "--region", "core"], "has no region of cells 'core'"),
        (["--to", "a.inp", "--mould", "m.stl"], "--mould: is for surfaces, and a.inp is a mesh"),
    ],
)
def test_bad_options_are_one_message(
    options: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = finished(tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    assert main(["export", str(run), *options]) == 2
    assert message in capsys.readouterr().err
    assert set(tmp_path.iterdir()) == before


def test_runs_without_a_shape_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bare").mkdir()
    bare = finished(tmp_path / "bare" / "run")
    (bare / "shape.msh").unlink()
    for name, status in (("failed", "the load was not reached"), ("begun", "")):
        (tmp_path / name).mkdir()
        finished(tmp_path / name / "run", status=status, load=0.5)
    for run, message in (
        ("missing", "no such directory"),
        ("empty", "is not the directory of a finished run"),
        ("failed/run", "the run failed, and has no shape: the load was not reached"),
        ("begun/run", "the run is not finished\n  Finish it by 'resume"),
        ("bare/run", "has no file of the shape"),
    ):
        assert main(["export", str(tmp_path / run), "--to", str(tmp_path / "a.stl")]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "a.stl").exists()


def test_a_run_that_was_stopped_in_its_certificate_has_a_shape(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, part = finished(tmp_path / "run", status="stopped by a signal"), tmp_path / "part.stl"
    assert main(["export", str(run), "--to", str(part)]) == 0
    assert f"warning: {part}: the certificate is not complete (stopped by a signal)" in capsys.readouterr().err
    assert read(part).volume == pytest.approx(VOLUME * 1.1**3, rel=1e-6)


@pytest.mark.parametrize(("unit", "suffix"), [("mm", ".step"), ("in", ".stp")])
def test_step_files_are_solids_of_the_same_volume(unit: str, suffix: str, tmp_path: Path) -> None:
    """OpenCASCADE reads one solid, whose neighbouring faces share their edges (Euler: corners - edges + faces = 2)."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * [20.0, 10, 5] + 1 / 3
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))])
    write((tmp_path / "a").with_suffix(suffix), Solid(corners, triangles), unit)
    with session("step") as gmsh:
        gmsh.model.occ.importShapes(str((tmp_path / "a").with_suffix(suffix)))
        gmsh.model.occ.synchronize()
        ((_, solid),) = gmsh.model.getEntities(3)
        volume = gmsh.model.occ.getMass(3, solid)
        assert [len(gmsh.model.getEntities(dim)) for dim in (0, 1, 2)] == [8, 18, 12]
    assert volume == pytest.approx(1000 * {"mm": 1, "in": 25.4**3}[unit], rel=1e-6)  # numbers of 4 bytes
