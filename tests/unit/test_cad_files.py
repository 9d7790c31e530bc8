"""Bodies of CAD files: names, sizes against closed forms, glued and faulty assemblies, damaged files."""

from __future__ import annotations

import dataclasses
import json
import random
import re
from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, hpcinv_here, write_job
from helpers.schemas import refusals

import hpcinv as package
from hpcinv.__main__ import main
from hpcinv.base.parallel import code_cache
from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.cad import mesh_warnings
from hpcinv.geometry.workshop.cad_refit import NotRefitted, movement, refit
from hpcinv.geometry.workshop.solid import volume_of
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import read_source
from hpcinv.mesh.cell_count import no_report
from hpcinv.mesh.io import isolated
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")

MODELS = {
    "box": "o.addBox(0, 0, 0, 20, 10, 10)",
    "cylinder": "o.addCylinder(0, 0, 0, 0, 0, 20, 5)",
    "two": "o.addBox(0, 0, 0, 10, 10, 10); o.addBox(10, 2, 2, 10, 6, 6)",
    "overlap": "o.addBox(0, 0, 0, 10, 10, 10); o.addBox(9, 2, 2, 10, 6, 6)",
    "gap": "o.addBox(0, 0, 0, 10, 10, 10); o.addBox(10.005, 2, 2, 10, 6, 6)",
    "sheet": "o.addRectangle(0, 0, 0, 10, 10)",
    "rounded": "v = o.addBox(0, 0, 0, 40, 10, 10); o.synchronize(); o.fillet([v], range(1, 13), [1])",
    "plate": "o.cut([(3, o.addBox(0, 0, 0, 20, 10, 4))], [(3, o.addCylinder(10, 5, -1, 0, 0, 6, 2))])",
}


@pytest.fixture(scope="module")
def cad(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    place = tmp_path_factory.mktemp("cad")

    def made(file: str) -> Path:
        path = place / file
        if not path.exists():
            with session(path.stem) as gmsh:
                exec(MODELS[path.stem], {"o": gmsh.model.occ})
                gmsh.model.occ.synchronize()
                gmsh.write(str(path))
        return path

    return made


def read(path: Path, **more: Any) -> MeshSource:
    report = more.pop("report", no_report)
    data = {"cad": path.name, "size": "4 mm"} | more
    spec = MeshSpec.model_validate(data, context={"directory": path.parent, "untrusted": False})
    return read_source(spec, path, report=report)


def volume(source: MeshSource) -> float:
    """Volume (m³) of straight tetrahedra."""
    a, b, c, d = (source.points[source.cells[:, i]] for i in range(4))
    return float(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)).sum() / 6)


def counts(source: MeshSource) -> dict[str, int]:
    return {group.name: group.dim for group in source.groups}


@pytest.mark.release
def test_the_command_writes_metres(cad: Callable[[str], Path], tmp_path: Path) -> None:
    """Files in mm would need their unit in the next command."""
    mesh = tmp_path / "box.msh"
    assert main(["mesh", "from-cad", str(cad("box.step")), str(mesh), "--size", "8 mm"]) == 0
    spec = MeshSpec.model_validate({"file": mesh.name}, context={"directory": tmp_path, "untrusted": False})
    assert volume(read_source(spec, mesh)) == pytest.approx(2e-6, rel=1e-9)


@pytest.mark.everyday("box.step-unit0")
@pytest.mark.parametrize(("file", "unit"), [("box.step", {}), ("box.brep", {"unit": "mm"})])
def test_a_box_has_its_volume_and_faces(file: str, unit: dict[str, str], cad: Callable[[str], Path]) -> None:
    source = read(cad(file), **unit)
    assert volume(source) == pytest.approx(2e-6, rel=1e-9)
    assert counts(source) == {"solid-1": 3, **{f"face-{number}": 2 for number in range(1, 7)}}
    assert len(read(cad(file), **unit, size="2 mm").cells) > 4 * len(source.cells)


@pytest.mark.parametrize("suffix", ["step", "iges"])
def test_curved_cells_are_on_the_surface(suffix: str, cad: Callable[[str], Path]) -> None:
    if suffix == "iges":  # surfaces alone, which are sewn to a solid
        straight = read(cad("cylinder.iges"))
        assert volume(straight) == pytest.approx(pi * 25 * 20e-9, rel=0.06)
        return
    straight, curved = (read(cad("cylinder.step"), geometry_degree=degree) for degree in (1, 2))
    side = next(g for g in curved.groups if g.name == "face-1").members
    radii = np.hypot(*curved.points[curved.facets[side]][..., :2].reshape(-1, 2).T)
    assert np.abs(radii - 5e-3).max() < 1e-12
    assert 0.93 < volume(straight) / (pi * 25 * 20e-9) < 1


@pytest.mark.release
def test_touching_solids_share_their_face(cad: Callable[[str], Path]) -> None:
    source = read(cad("two.step"))
    assert {name for name, dim in counts(source).items() if dim == 3} == {"solid-1", "solid-2"}
    (shared,) = (group for group in source.groups if group.name == "solid-1|solid-2")
    assert len(np.unique(source.facets[shared.members])) > 4
    assert source.points[source.facets[shared.members]][..., 0] == pytest.approx(0.01)
    assert volume(source) == pytest.approx(1.36e-6, rel=1e-9)


def test_faulty_assemblies_are_refused_with_their_place(cad: Callable[[str], Path]) -> None:
    with pytest.raises(MeshError, match=r"solids 'solid-1' and 'solid-2' overlap near \(0\.0095, 0\.005, 0\.005\) m"):
        read(cad("overlap.step"))
    with pytest.raises(MeshError, match="solids 'solid-1' and 'solid-2' miss each other by 5 µm near") as refused:
        read(cad("gap.step"))
    assert "glue: 5 µm" in refused.value.advice
    assert "solid-1|solid-2" in counts(read(cad("gap.step"), glue="6 um"))
    with pytest.raises(MeshError, match=r"mesh\.glue is more than 1% of the size"):
        read(cad("overlap.step"), glue="1 mm")
    with pytest.raises(MeshError, match="has no solid"):
        read(cad("sheet.step"))


def test_wrong_keys_are_refused(cad: Callable[[str], Path], tmp_path: Path) -> None:
    for file, keys, message in (
        ("box.step", {"size": "4 mm", "unit": "mm"}, "mesh.unit: is in the file already; leave it out"),
        ("box.brep", {"size": "4 mm"}, "mesh.unit: is needed: BREP files do not have one"),
        ("box.step", {}, "mesh.size: is needed: the largest length of edges"),
    ):
        data = {"mesh": {"cad": str(cad(file)), **keys}, "material": {"law": "neo-hookean", "mu": 1, "lam": 1}}
        with pytest.raises(JobError, match=message):
            package.load(
                write_job(tmp_path / "job.yaml", data, supports=[{"region": "face-1", "fix": ["x", "y", "z"]}])
            )


def test_validate_lists_solids_and_faces(
    cad: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = {
        "mesh": {"cad": str(cad("cylinder.step")), "size": "4 mm"},
        "material": {"law": "neo-hookean", "mu": 1, "lam": 1},
    }
    job = write_job(tmp_path / "job.yaml", data, supports=[{"region": "face-1", "fix": ["x", "y", "z"]}])
    assert main(["validate", str(job)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  solid-1: solid" in lines
    assert "  face-2: face of 78.54 mm^2 around (0, 0, 20) mm" in lines


def test_damaged_files_get_a_message(cad: Callable[[str], Path], tmp_path: Path) -> None:
    whole, source, messages = cad("cylinder.step").read_bytes(), random.Random(1), list[str]()
    for number in range(4):
        path = tmp_path / f"damaged-{number}.step"
        content = bytearray(whole[: source.randrange(len(whole) // 2, len(whole))])
        content[source.randrange(len(content))] = source.randrange(256)
        path.write_bytes(content)
        with pytest.raises(MeshError) as refused:
            read(path)
        messages.append(refused.value.message)
    assert not [text for text in messages if "Traceback" in text]


def test_a_file_without_shapes_has_no_solid(cad: Callable[[str], Path], tmp_path: Path) -> None:
    """OpenCASCADE reads files of versions that it does not know as nothing, without an error."""
    path = tmp_path / "empty.brep"
    path.write_bytes(cad("box.brep").read_bytes().replace(b"Topology V", b"Topology X"))
    with pytest.raises(MeshError, match="has no solid"):
        read(path, unit="mm")


def test_a_file_that_gmsh_has_read_is_not_tried_again(
    cad: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, tried = tmp_path / "box.step", list[str]()
    path.write_bytes(cad("box.step").read_bytes())
    monkeypatch.setattr(code_cache, "_places", (tmp_path / "records",))
    run = isolated.run_isolated
    monkeypatch.setattr(isolated, "run_isolated", lambda action, *rest: tried.append(action) or run(action, *rest))
    first, second = read(path), read(path)
    assert tried == ["cad"]
    assert np.array_equal(first.points, second.points)
    path.write_bytes(cad("cylinder.step").read_bytes())  # another content under the same name
    read(path)
    assert len(tried) == 2


def test_a_job_on_a_cad_file_runs(cad: Callable[[str], Path], tmp_path: Path) -> None:
    data = {
        "analysis": "round_trip",
        "mesh": {"cad": str(cad("two.step")), "size": "5 mm"},
        "regions": {"foot": "x < 1e-6 m"},
        "material": {
            "solid-1": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.4},
            "solid-2": {"law": "neo-hookean", "young": "0.5 MPa", "poisson": 0.4},
        },
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "foot", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
    }
    path = write_job(tmp_path / "job.yaml", data)
    assert not refusals(package.load(path).data)
    assert main(["validate", str(path)]) == 0
    ended = hpcinv_here("run", path, "--output", "out", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["errors"]["round_trip"]["relative"] < 1e-10


def styled(number: int, colour: str, entity: str) -> str:
    """STEP's entities for the colour of a solid or face, from a number on."""
    rows = [
        f"COLOUR_RGB('',{colour})",
        f"FILL_AREA_STYLE_COLOUR('',#{number})",
        f"FILL_AREA_STYLE('',(#{number + 1}))",
        f"SURFACE_STYLE_FILL_AREA(#{number + 2})",
        f"SURFACE_SIDE_STYLE('',(#{number + 3}))",
        f"SURFACE_STYLE_USAGE(.BOTH.,#{number + 4})",
        f"PRESENTATION_STYLE_ASSIGNMENT((#{number + 5}))",
        f"STYLED_ITEM('color',(#{number + 6}),#{entity})",
    ]
    return "".join(f"#{number + i}={row};\n" for i, row in enumerate(rows))


def test_colours_are_regions(cad: Callable[[str], Path], tmp_path: Path) -> None:
    text = cad("two.step").read_text()
    solids, faces = (re.findall(rf"#(\d+) = {kind}", text) for kind in ("MANIFOLD_SOLID_BREP", "ADVANCED_FACE"))
    (context, *_) = re.findall(r"#(\d+) = \( ?GEOMETRIC_REPRESENTATION_CONTEXT", text)
    more = styled(9001, "1.,0.,0.", solids[0]) + styled(9011, "0.,0.,1.", solids[1])
    more += styled(9021, "0.,1.,0.", faces[0])  # at x = 0
    items = "#9008,#9018,#9028"
    more += f"#9030=MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({items}),#{context});\n"
    head, _, tail = text.rpartition("ENDSEC;")
    path = tmp_path / "coloured.step"
    path.write_text(f"{head}{more}ENDSEC;{tail}")
    source = read(path)
    groups = {group.name: group for group in source.groups}
    first, second = (groups[name].members for name in ("colour-ff0000", "colour-0000ff"))
    assert np.array_equal(np.sort(np.concatenate([first, second])), np.arange(len(source.cells)))
    assert volume(dataclasses.replace(source, cells=source.cells[first])) == pytest.approx(1e-6, rel=1e-9)
    green = source.points[source.facets[groups["colour-00ff00"].members]]
    assert np.abs(green[..., 0]).max() < 1e-12


def test_small_roundings_that_make_a_mesh_large_are_named(
    cad: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh_warnings, "_MANY", 300)
    lines: list[str] = []
    read(cad("rounded.step"), size="8 mm", report=lines.append)
    (line,) = [line for line in lines if "mesh.grade" in line]
    assert re.search(r"rounded faces such as face-\d+ \(radius 1 mm\) have edges down to 2 mm", line)
    assert "take mesh.grade 2: edges of 4 mm and more" in line
    lines.clear()
    read(cad("rounded.step"), size="8 mm", grade=1, report=lines.append)
    read(cad("box.step"), size="1.5 mm", report=lines.append)  # many cells, as the job asks for
    assert not any("mesh.grade" in line for line in lines)


def test_a_body_of_flat_faces_is_refitted(cad: Callable[[str], Path]) -> None:
    """Its edges have no curves in the parameters of faces."""
    path = cad("box.step")
    given = read(path, size="5 mm", geometry_degree=2)
    x, y, z = given.points.T
    found = dataclasses.replace(given, points=np.column_stack([x, y, z + 4 * x**2]))
    volume = volume_of(found, None) * 1e9
    step = refit(path, movement(given, found, 1e-3, 1.0, 1e-2), 1e-2, volume)
    assert step.faces == 6
    assert step.volume == pytest.approx(volume, rel=1e-4)


def test_faces_are_refitted_to_a_moved_shape(cad: Callable[[str], Path], tmp_path: Path) -> None:
    """A plate with a hole is bent and twisted: planes, a cylinder with a seam, and edges without curves on planes."""
    path = cad("plate.step")
    given = read(path, size="2 mm", geometry_degree=2)
    x, y, z = given.points.T
    found = dataclasses.replace(given, points=np.column_stack([x, y + 8 * x**2, z * (1 + 10 * x)]))
    volume = volume_of(found, None) * 1e9
    move = movement(given, found, 1e-3, 1.0, 1e-2)
    step = refit(path, move, 1e-2, volume)
    assert move.error < 1e-3  # a quadratic map is a spline
    assert 0 < step.deviation < 1e-2
    assert step.faces == 7
    assert step.volume == pytest.approx(volume, rel=1e-4)
    (tmp_path / "bent.step").write_bytes(step.content)
    again = read(tmp_path / "bent.step", size="2 mm", geometry_degree=2)
    assert volume_of(again, None) * 1e9 == pytest.approx(volume, rel=1e-3)
    assert np.ptp(again.points, axis=0) == pytest.approx(np.ptp(found.points, axis=0), rel=1e-3)
    with pytest.raises(NotRefitted, match="no smooth map is nearer than 1 mm"):
        refit(path, dataclasses.replace(move, error=1.0), 1e-2, volume)
    with pytest.raises(NotRefitted, match="it has 2 solids"):
        refit(cad("two.step"), move, 1e-2, volume)
    straight = read(path, size="2 mm", grade=1)
    same = movement(straight, straight, 1e-3, 1.0, 1e-2)
    remedy = r"since its cells are coarse: run with a smaller mesh.size or with 'mesh: \{geometry_degree: 2\}'"
    with pytest.raises(NotRefitted, match=remedy):
        refit(path, same, 1e-2, volume_of(straight, None) * 1e9)
    coarse = read(cad("box.step"), size="20 mm")
    with pytest.raises(NotRefitted, match="too few for a smooth map: take smaller cells"):
        movement(coarse, coarse, 1e-3, 1.0, 1e-2)
