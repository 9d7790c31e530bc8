"""How many cells a generator is expected to make, and the limit on them."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import hpcinv_here
from helpers.mesh_cases import spec

from hpcinv.errors import MeshError
from hpcinv.mesh import read_source
from hpcinv.mesh.cell_count import rounded

BALL = """
def build(gmsh, *, size=0.2, radius=1.0):
    gmsh.model.occ.addSphere(0, 0, 0, radius)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
"""
BY_POINTS = """
def build(gmsh, *, size=0.25, n: int = 0):
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.setSize(gmsh.model.getEntities(0), size)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.generate(3)
    for _ in range(n):
        gmsh.model.mesh.refine()
"""
BY_FIELD = """
def build(gmsh, *, size=0.25):
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    field = gmsh.model.mesh.field.add("MathEval")
    gmsh.model.mesh.field.setString(field, "F", str(size))
    gmsh.model.mesh.field.setAsBackgroundMesh(field)
    gmsh.model.mesh.generate()
"""
GEO = """
DefineConstant[ size = 0.25 ];
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 1, 1, 1};
Mesh.MeshSizeMax = size;
"""


def generator(tmp_path: Path, text: str) -> Path:
    path = tmp_path / ("body.geo" if "DefineConstant" in text else "body.py")
    path.write_text(text)
    return path


def expected(path: Path, **parameters: Any) -> tuple[float, int]:
    """The messages, and the number of cells made."""
    message: list[str] = []
    source = read_source(spec(path, parameters=parameters), path, message.append)
    numbers = [float(text.split()[1].replace(",", "")) for text in message]
    assert all(text.endswith(" cells expected") for text in message)
    return numbers[0], len(source.cells)


@pytest.mark.everyday("text1", "text2", "text3")
@pytest.mark.parametrize("text", [BALL, BY_POINTS, BY_FIELD, GEO])
def test_cells_are_counted_beforehand_to_a_factor_of_two(tmp_path: Path, text: str) -> None:
    for size in (0.25, 0.12):
        before, made = expected(generator(tmp_path, text), size=size)
        assert 0.5 < before / made < 2


@pytest.mark.parametrize(
    ("file", "parameters", "factor"),
    [
        ("pdms_beam.py", {"size": "3 mm"}, 2),
        ("box.py", {"nx": 12, "ny": 5, "nz": 4}, 2),
        ("refined_corner.py", {}, 4),  # its cells are graded by a factor of a thousand
        ("thick_sphere.py", {}, 4),  # gmsh's own kernel knows no volume, and the box around this one is twice as large
    ],
)
def test_cell_counts_of_the_projects_generators_are_predicted(
    meshes: Path, file: str, parameters: dict[str, Any], factor: float
) -> None:
    before, made = expected(meshes / file, **parameters)
    assert 1 / factor < before / made < factor


@pytest.mark.parametrize(
    ("text", "parameters"),
    [
        (BALL, {"size": 6e-6}),
        (BALL, {"size": 2e-3}),
        (BY_POINTS, {"size": 1e-9}),
        (BY_FIELD, {"size": 1e-3}),
        (GEO, {"size": 1e-3}),
    ],
)
def test_absurd_sizes_are_refused_before_surfaces_are_meshed(
    tmp_path: Path, text: str, parameters: dict[str, Any]
) -> None:
    path, began = generator(tmp_path, text), time.process_time()
    with pytest.raises(
        MeshError, match=r"cells expected, more than mesh\.maximum_cells allows \(10,000,000\)"
    ) as caught:
        read_source(spec(path, parameters=parameters), path)
    assert "raise mesh.maximum_cells" in caught.value.advice
    assert time.process_time() - began < 60  # their surfaces alone would take hours


def test_maximum_cells_holds_for_all_generators_and_refined_meshes(tmp_path: Path) -> None:
    path = generator(tmp_path, BY_POINTS)
    made = len(read_source(spec(path, maximum_cells=2000), path).cells)
    assert 200 < made < 2000
    with pytest.raises(MeshError, match=rf"about {rounded(8 * made)} cells expected".replace(".", r"\.")):
        read_source(spec(path, maximum_cells=2000, parameters={"n": 1}), path)
    refined = read_source(spec(path, parameters={"n": 1}), path)
    assert len(refined.cells) == 8 * made
    by_hand = generator(
        tmp_path,
        "def build(gmsh):\n"
        "    body = gmsh.model.addDiscreteEntity(3)\n"
        "    gmsh.model.mesh.addNodes(3, body, [1, 2, 3, 4], [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1])\n"
        "    gmsh.model.mesh.addElementsByType(body, 4, [1, 2], [1, 2, 3, 4] * 2)\n",
    )
    with pytest.raises(MeshError, match=r"about 2 cells expected, more than .* \(1\)"):
        read_source(spec(by_hand, maximum_cells=1), by_hand)


def test_a_mesh_to_be_partitioned_is_reported_too_and_refused_where_it_is_absurd(tmp_path: Path) -> None:
    path = generator(tmp_path, BALL)
    cut = hpcinv_here("mesh", "partition", path, "ball.bp", "--parts", 2, cwd=tmp_path)
    message, done = cut.stdout.splitlines()
    assert re.fullmatch(rf"meshing {path}: about \d,\d00 cells expected", message)
    assert "number of parts 2" in done
    absurd = hpcinv_here("mesh", "partition", path, "b.bp", "--parts", 2, "--parameter", "size=1e-4", cwd=tmp_path)
    assert (absurd.returncode, "more than mesh.maximum_cells allows" in absurd.stderr) == (2, True)
    assert not (tmp_path / "b.bp").exists()


def test_the_mesh_is_the_one_that_gmsh_makes_unwatched(tmp_path: Path) -> None:
    """Also where its generator meshes curves, surfaces and volumes one after the other."""
    from hpcinv.mesh.io.gmsh_model import session

    path = generator(tmp_path, BALL)
    source = read_source(spec(path), path)
    with session("unwatched") as gmsh:
        namespace: dict[str, Any] = {}
        exec(BALL, namespace)
        namespace["build"](gmsh)
        _, points, _ = gmsh.model.mesh.getNodes()
    assert np.array_equal(np.sort(source.points.ravel()), np.sort(points))


@pytest.mark.parametrize(("number", "text"), [(3, "3"), (47, "47"), (6708.3, "6,700"), (3.24e9, "3.2e+09")])
def test_numbers_of_cells_are_shown_with_two_digits(number: float, text: str) -> None:
    assert rounded(number) == text
