"""Regions by outer normals and by cavities, on 1 to 3 ranks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import Job, parse
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.region_rules import RegionRule, RegionUnion, SmoothFace
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body
from hpcinv.mesh.boundary_shells import shells
from hpcinv.mesh.source import MeshSource

CUBES = np.array([[i, j, k] for i in range(5) for j in range(5) for k in range(3)])
HOLES = [(1, 1, 1), (3, 3, 1), (3, 2, 1)]


def block() -> MeshSource:
    """5 x 5 x 3 hexahedra of 1 m without three of them: a cavity of two cells, and one of one."""
    kept = np.array([cube for cube in CUBES if tuple(cube) not in HOLES])
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    points, cells = np.unique((kept[:, None] + corners).reshape(-1, 3), axis=0, return_inverse=True)
    return MeshSource(
        path=Path("block"),
        kind="hexahedron",
        degree=1,
        points=points.astype(np.float64),
        node_tags=np.arange(1, len(points) + 1),
        cells=cells.reshape(-1, 8),
        cell_tags=np.arange(1, len(kept) + 1),
        facets=np.zeros((0, 4), dtype=np.int64),
    )


def rules(**regions: str | list[str] | RegionUnion) -> dict[str, RegionRule]:
    kinds = {str: lambda text: Expression(text), list: lambda names: RegionUnion(tuple(names))}
    return {name: kinds.get(type(rule), lambda rule: rule)(rule) for name, rule in regions.items()}


def body(**regions: str | list[str] | RegionUnion) -> Body:
    spec = MeshSpec.model_construct(file="block.vtu", unit=1.0)
    return build_body(spec, rules(**regions), MPI.COMM_WORLD, replacement=block())


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_regions_by_normals_and_cavities() -> None:
    region_body = body(
        bottom="nz < -cos(30 deg) and z < 0.5 m",
        outer="cavity < 1",
        large="cavity > 0 and cavity < 2",
        small="cavity > 1",
        roofs="cavity > 0 and nz < 0",  # outer normals point into the cavity
    ).regions
    counts = {name: (region.facet_count, region.cell_count) for name, region in region_body.items()}
    assert counts["bottom"] == (25, 0)
    assert counts["outer"] == (2 * 25 + 4 * 15, 0)
    assert counts["large"] == (10, 0)
    assert counts["small"] == (6, 0)
    assert counts["roofs"] == (3, 0)
    with pytest.raises(MeshError, match="region 'third': no boundary facet and no cell satisfies 'cavity > 2'"):
        body(third="cavity > 2")


UNIONS: dict[str, str | list[str]] = {
    "lower": "z < 1.5 m",
    "bottom": "nz < -cos(30 deg) and z < 0.5 m",
    "holes": "cavity > 0",
    "skin": ["bottom", "lower"],  # the first is a part of the second
    "wall": ["skin", "holes"],
}


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_unions_have_each_facet_and_cell_once() -> None:
    regions = body(**UNIONS).regions
    counts = {name: (region.facet_count, region.cell_count) for name, region in regions.items()}
    assert counts["lower"] == (25 + 4 * 5 + 3, 25)  # the bottom, a layer of the sides, and the floors of the cavities
    assert counts["skin"] == counts["lower"]
    assert counts["wall"] == (25 + 4 * 5 + 10 + 6, 25)
    with pytest.raises(MeshError, match="no region 'endo'"):
        body(skin=["endo"])


@pytest.mark.parallel([1, 2, 3])
def test_differences_leave_facets_and_cells_out() -> None:
    conditions = {"lower": "z < 1.5 m", "bottom": "nz < -cos(30 deg) and z < 0.5 m"}
    regions = body(**conditions, rest=RegionUnion(("boundary", "lower"), ("bottom",))).regions
    lower, rest = regions["lower"], regions["rest"]
    assert (rest.facet_count, rest.cell_count) == (regions["boundary"].facet_count - 25, lower.cell_count)
    with pytest.raises(MeshError, match=r"region 'none': nothing is left of \[bottom, not lower\]"):
        body(**conditions, none=RegionUnion(("bottom",), ("lower",)))


def test_unions_in_jobs_are_checked(tmp_path: Path) -> None:
    sections = {"mesh": {"file": "box.py"}, "material": {"law": "neo-hookean", "young": "1 kPa", "poisson": 0.3}}
    (tmp_path / "box.py").write_text("def build(gmsh): ...")
    supports = [{"region": "skin", "fix": ["x", "y", "z"]}]

    def job(**regions: object) -> Job:
        return parse({**sections, "supports": supports, "regions": regions}, tmp_path / "job.yaml")

    assert job(foot="z < 1 mm", skin=["foot", "endo"]).regions["skin"] == RegionUnion(("foot", "endo"))
    without = job(foot="z < 1 mm", skin=["boundary", "not foot"]).regions["skin"]
    assert without == RegionUnion(("boundary",), ("foot",))
    rule = {"smooth": [0, "3 cm", "2 mm"], "angle": "20 deg"}
    face = job(foot=rule, skin=["foot"]).regions["foot"]
    assert face == SmoothFace((0.0, 0.03, 0.002), np.deg2rad(20))
    assert job(**job(foot=rule, skin=["foot"]).model_dump(mode="json")["regions"]).regions["foot"] == face
    for regions, message in (
        ({"skin": {"smooth": [0, 1]}}, "regions.skin: must be such as {smooth: "),
        ({"skin": {"smooth": [0, 0, "1 kg"]}}, "regions.skin: must be a length"),
        ({"skin": {"smooth": [0, 0, 0], "angl": 1}}, "regions.skin: must be such as {smooth: "),
        ({"skin": ["boundary", "not foot"], "foot": "z < 1 mm"}, "regions.skin: names 'foot', which is not defined"),
        ({"skin": ["not foot"]}, r"regions.skin: must name a region from which to leave out others"),
        ({"skin": ["foot"], "foot": "z < 1 mm"}, "regions.skin: names 'foot', which is not defined above it"),
        ({"skin": ["skin"]}, "regions.skin: names 'skin', which is not defined above it"),
        ({"skin": []}, r"regions.skin: must be a condition, or names of regions such as \[endo, epi\], not \[\]"),
        ({"skin": [1]}, "must be a condition, or names of regions"),
    ):
        with pytest.raises(JobError, match=message):
            job(**regions)


def test_shells_that_enclose_nothing_are_numbered_by_volume() -> None:
    facets = np.array([[0, 1, 2], [2, 3, 0], [4, 5, 6], [7, 8, 9]])
    assert shells(facets, np.array([-1.0, -1.0, 5.0, -3.0])).tolist() == [2, 2, 0, 1]


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_a_smooth_face_ends_at_sharp_edges() -> None:
    # The nearest facet is on the top, 1.2 m from which the hole begins.
    regions = body(
        top=SmoothFace((2.1, 0.3, 3.2)),
        roof=SmoothFace((1.5, 1.5, 1.9)),
        outer=SmoothFace((2.1, 0.3, 3.2), np.pi),
    ).regions
    assert regions["top"].facet_count == 25
    assert regions["roof"].facet_count == 1  # of the cavity of one cell
    assert regions["outer"].facet_count == 2 * 25 + 4 * 15
    assert regions["top"].cell_count == 0
