"""``validate`` knows the regions of ready-made meshes, and reports a name that none has, without reading the mesh."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
import yaml
from helpers.command_line import environment
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.job import mesh_contents
from hpcinv.mesh import MeshSource, read_source
from hpcinv.mesh.distributed.partition import partitioned
from hpcinv.mesh.distributed.partitioned import write_partitioned
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import DataArray

JOB: dict[str, Any] = {
    "analysis": "forward",
    "regions": {"corner": "x < 1 mm"},
    "material": {"block": {"law": "neo-hookean", "mu": {"block": "1 Pa", "elsewhere": "2 Pa"}, "lam": 1}},
    "effects": [{"effect": "pressure", "region": "x1", "pressure": "1 Pa"}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}, {"region": "corner", "fix": ["x"]}],
    "quantities": [{"name": "q", "of": "x", "on": "boundary", "reduce": "max"}],
}
WRONG: dict[str, Any] = {
    "material": {"blok": {"law": "neo-hookean", "mu": {"rind": "1 Pa", "elsewhere": "2 Pa"}, "lam": 1}},
    "effects": [{"effect": "pressure", "region": "X1", "pressure": "1 Pa"}],
    "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
    "quantities": [{"name": "q", "of": "x", "on": "tip", "reduce": "max"}],
}


@pytest.fixture(scope="module")
def block() -> MeshSource:
    path = Path(__file__).parents[2] / "meshes" / "box.py"
    return read_source(spec(path), path)


def convert(path: Path, mesh: MeshSource, version: float, *, binary: bool) -> None:
    """Write a mesh, and again by gmsh in a version of MSH."""
    save(path, mesh, mesh.points)
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(path))
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(path))
    gmsh.finalize()


WRITERS: dict[str, Callable[[Path, MeshSource], None]] = {
    "binary41.msh": lambda path, mesh: save(path, mesh, mesh.points),
    "text41.msh": partial(convert, version=4.1, binary=False),
    "binary22.msh": partial(convert, version=2.2, binary=True),
    "own.vtu": lambda path, mesh: save(path, mesh, mesh.points),
    "parts.bp": lambda path, mesh: write_partitioned(path, MPI.COMM_SELF, partitioned(mesh, 2)[0]),
}


def write(directory: Path, mesh: str, **changes: Any) -> Path:
    path = directory / "job.yaml"
    path.write_text(yaml.safe_dump({**JOB, "mesh": {"file": mesh}, **changes}))
    return path


@pytest.mark.parametrize("name", WRITERS)
def test_a_region_that_the_mesh_has_not_is_reported(name: str, tmp_path: Path, block: MeshSource) -> None:
    WRITERS[name](tmp_path / name, block)
    hpcinv.load(write(tmp_path, name))
    path = write(tmp_path, name, **WRONG)
    with pytest.raises(JobError) as caught:
        hpcinv.load(path)
    assert list(caught.value.problems) == [
        f"{path}: {where}: there is no region '{region}' in {name}, nor in 'regions'.{hint}"
        for where, region, hint in (
            ("supports[0].region", "clamp", caught.value.problems[0].partition("'regions'.")[2]),
            ("effects[0].region", "X1", " Did you mean 'x1'?"),
            ("material.blok", "blok", " Did you mean 'block'?"),
            ("material.blok.mu.rind", "rind", caught.value.problems[3].partition("'regions'.")[2]),
            ("quantities[0].on", "tip", caught.value.problems[4].partition("'regions'.")[2]),
        )
    ]


def test_region_names_are_reported_only_where_certain(tmp_path: Path) -> None:
    tetrahedron = [(4, 1, 1, (1, 2, 3, 4)), (2, 3, 1, (1, 2, 3))]
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": []}
    write_msh22(tmp_path / "a.msh", TETRAHEDRON, tetrahedron)  # groups without names
    for region, is_known in (("surface-3", True), ("surface-4", True), ("volume-1", True), ("surface", False)):
        path = write(tmp_path, "a.msh", **plain, supports=[{"region": region, "fix": ["x", "y", "z"]}])
        if is_known:
            hpcinv.load(path)
        else:
            with pytest.raises(JobError, match="there is no region 'surface' in"):
                hpcinv.load(path)
    (tmp_path / "a.msh").write_text("$MeshFormat\n")  # incomplete files are reported where they are read
    hpcinv.load(write(tmp_path, "a.msh"))
    (tmp_path / "a.vtu").write_text("<VTKFile><cut")
    hpcinv.load(write(tmp_path, "a.vtu"))


def test_a_file_without_names_has_advice_once(tmp_path: Path, block: MeshSource) -> None:
    values = np.ones((len(block.cells), 1), dtype=np.int64)
    numbers = DataArray("gmsh:physical", "cells", values.astype(float))
    save(tmp_path / "a.vtu", replace(block, groups=(), data={numbers.name: numbers}), block.points)
    text = (tmp_path / "a.vtu").read_bytes().replace(b'"Float64" Name="gmsh', b'"Int64" Name="gmsh')
    (tmp_path / "a.vtu").write_bytes(text)
    with pytest.raises(JobError) as caught:
        hpcinv.load(write(tmp_path, "a.vtu", **WRONG))
    first, *others = caught.value.problems
    assert "give a condition, such as 'regions: {clamp: x < 1 mm}', or numbers of an array in 'mesh': " in first
    assert first.endswith("""'labels: {array: "gmsh:physical", names: {clamp: 1}}'.""")
    assert others
    assert not any("such as" in line for line in others)


def test_names_of_points_and_curves_are_not_regions(tmp_path: Path) -> None:
    elements = [(4, 1, 1, (1, 2, 3, 4)), (1, 2, 1, (1, 2))]
    write_msh22(tmp_path / "a.msh", TETRAHEDRON, elements, [(3, 1, "body"), (1, 2, "edge")])
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": []}
    path = write(tmp_path, "a.msh", **plain, supports=[{"region": "edge", "fix": ["x", "y", "z"]}])
    with pytest.raises(JobError, match=r"It has points or lines only, no whole facet. Hold the facets"):
        hpcinv.load(path)


def test_tags_of_xdmf_are_known_by_the_name_of_their_grid(tmp_path: Path) -> None:
    grid = '<Grid Name="facets"><Topology/></Grid>'
    (tmp_path / "a.xdmf").write_text(f"<Xdmf><Domain>{grid}</Domain></Xdmf>")
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": []}
    hpcinv.load(write(tmp_path, "a.xdmf", **plain, supports=[{"region": "facets-7", "fix": ["x", "y", "z"]}]))
    with pytest.raises(JobError, match="there is no region 'clamp' in"):
        hpcinv.load(write(tmp_path, "a.xdmf", **plain, supports=[{"region": "clamp", "fix": ["x", "y", "z"]}]))


@pytest.mark.release
def test_validate_knows_them_without_the_libraries_that_read_meshes(tmp_path: Path, block: MeshSource) -> None:
    for name in ("a.msh", "a.vtu"):
        save(tmp_path / name, block, block.points)
        path = write(tmp_path, name, **WRONG)
        code = (
            "import sys; from hpcinv.__main__ import main; assert main(['validate', sys.argv[1]]) == 2;"
            "print({'gmsh', 'vtkmodules', 'pyvista', 'dolfinx', 'numpy'} & set(sys.modules))"
        )
        command = [sys.executable, "-c", code, str(path)]
        done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=True)
        assert "no region 'clamp'" in done.stderr
        assert done.stdout.strip() == "set()"


def validated(*paths: Path) -> list[str]:
    """Lines that ``validate`` prints of jobs that are not valid."""
    with pytest.MonkeyPatch.context() as patch:
        output = io.StringIO()
        patch.setattr(sys, "stderr", output)
        main(["validate", *map(str, paths)])
    return output.getvalue().splitlines()


@pytest.mark.everyday("mesh", "vtk")
@pytest.mark.parametrize("suffix", ["bdf", "cdb", "e", "med", "mesh", "unv", "vtk"])
def test_validate_reads_formats_whose_headers_do_not_name_regions(
    suffix: str, tmp_path: Path, block: MeshSource
) -> None:
    save(tmp_path / f"a.{suffix}", block, block.points)
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": []}
    right = "surface-1" if suffix == "mesh" else "x0"
    good = write(tmp_path, f"a.{suffix}", **plain, supports=[{"region": right, "fix": ["x", "y", "z"]}])
    assert validated(good) == []
    wrong = write(tmp_path, f"a.{suffix}", **plain, supports=[{"region": "X9", "fix": ["x", "y", "z"]}])
    (line,) = validated(wrong)
    assert line.startswith(f"{wrong}: supports[0].region: there is no region 'X9' in a.{suffix}")


@pytest.mark.everyday("inp", "xdmf")
@pytest.mark.parametrize("suffix", ["bdf", "e", "inp", "med", "msh", "vtu", "xdmf"])
def test_validate_finds_damaged_files(suffix: str, tmp_path: Path, block: MeshSource) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "xdmf":
        path.write_text("<Xdmf><Domain>")
    else:
        save(path, block, block.points)
        path.write_bytes(path.read_bytes()[:2000])
    held = [{"region": "boundary", "fix": ["x", "y", "z"]}]
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": [], "supports": held}
    job = write(tmp_path, path.name, **plain)
    (line,) = validated(job)
    assert line.startswith(f"{job}: mesh: 'a.{suffix}' ")
    image = write(tmp_path, path.name, **plain, expected_shape={"surface": "a.stl", "unit": "mm"})
    (tmp_path / "a.stl").write_text("nothing")
    assert [line.split(": ")[1] for line in validated(image)] == ["mesh", "expected_shape"]


def test_validate_names_files_that_are_too_large(
    tmp_path: Path, block: MeshSource, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save(tmp_path / "a.vtk", block, block.points)
    monkeypatch.setattr(mesh_contents, "LARGEST", 100)
    plain = {"material": JOB["material"]["block"] | {"mu": 1}, "effects": [], "quantities": []}
    path = write(tmp_path, "a.vtk", **plain, supports=[{"region": "X9", "fix": ["x", "y", "z"]}])
    assert main(["validate", str(path)]) == 0
    assert capsys.readouterr().out.startswith(f"{path}: valid; not read here: {tmp_path / 'a.vtk'} of 0 MB")


# densities and temperatures


def expansion(**given: Any) -> dict[str, Any]:
    return {"effects": [{"effect": "thermal-expansion", "coefficient": "3e-4 1/K", **given}], "regions": {}}


@pytest.fixture
def simple(tmp_path: Path) -> Callable[..., hpcinv.Job]:
    (tmp_path / "a.msh").write_text("$MeshFormat\n")
    material = {"law": "neo-hookean", "mu": 1, "lam": 1}
    supports = [{"region": "x0", "fix": ["x", "y", "z"]}]
    return lambda **changes: hpcinv.load(
        write(
            tmp_path, "a.msh", **{"material": material, "quantities": [], "effects": [], "supports": supports} | changes
        )
    )


@pytest.mark.parametrize(
    ("given", "change"),
    [
        ({"temperature_change": "40 K"}, 40.0),
        ({"temperature": "400 °C", "reference_temperature": "20 °C"}, 380.0),
        ({"temperature": "400 degC", "reference_temperature": "293.15 K"}, 380.0),
        ({"temperature": "212 °F", "reference_temperature": "32 degF"}, 100.0),
        ({"temperature": "-40 °F", "reference_temperature": "-40 °C"}, 0.0),
        ({"temperature": 300, "reference_temperature": "0 ℃"}, 26.85),
        (
            {"temperature": {"core": "37 °C", "elsewhere": "20 °C"}, "reference_temperature": "20 °C"},
            {"core": 17.0, "elsewhere": 0.0},
        ),
    ],
)
def test_a_change_of_temperature_or_both_temperatures(
    given: dict[str, Any], change: Any, simple: Callable[..., hpcinv.Job]
) -> None:
    temperature = simple(**expansion(**given)).effects[0].temperature_change
    assert (temperature.plain() if isinstance(change, dict) else temperature) == pytest.approx(change, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (expansion(temperature_change="400 °C"), "effects[0].temperature_change: '400 °C' is an absolute temperature"),
        (expansion(temperature_change="40 degC"), "write a difference in K"),
        (expansion(temperature="400 °C"), "effects[0].reference_temperature: is needed with 'temperature'"),
        (
            expansion(reference_temperature="20 °C"),
            "effects[0].temperature: is needed with 'reference_temperature'",
        ),
        (
            expansion(temperature="400 °C", reference_temperature="20 °C", temperature_change="380 K"),
            "effects[0].temperature: is not valid with 'temperature_change'; remove one of them",
        ),
        (expansion(temperature="-300 °C", reference_temperature="20 °C"), "'-300 °C' is below absolute zero"),
        (expansion(temperature="4 m", reference_temperature="20 °C"), "must be a temperature, such as 400 °C or"),
        (expansion(temperature=[1], reference_temperature="20 °C"), "must be a temperature, such as 400 °C or"),
        (expansion(temperature=-1, reference_temperature="20 °C"), "must be a temperature in K, 0 or more"),
        (
            {"material": {"law": "neo-hookean", "mu": "20 °C", "lam": 1}},
            "material.mu: '20 °C' is an absolute temperature; write a difference",
        ),
        (
            {"effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": "-1 kg/m^3"}]},
            "effects[0].density: must be at least 0, not -1 kg/m^3; for a body that is lighter than the",
        ),
        (
            {"effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": {"x": -1}}]},
            "effects[0].density: in region 'x': must be at least 0, not -1",
        ),
        (
            {"effects": [{"effect": "centrifugal", "angular_velocity": 1, "axis": [0, 0, 1], "density": -1}]},
            "effects[0].density: must be at least 0, not -1",
        ),
    ],
    ids=lambda value: value[:60] if isinstance(value, str) else "",
)
def test_temperatures_and_densities_that_cannot_be_are_reported(
    changes: dict[str, Any], message: str, simple: Callable[..., hpcinv.Job]
) -> None:
    with pytest.raises(JobError) as caught:
        simple(**changes)
    assert message in str(caught.value)
