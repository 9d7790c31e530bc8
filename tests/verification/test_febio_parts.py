"""Slides, springs, rigid regions, fibres and varying laws in models for FEBio, evaluated from the files themselves."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_data_files import block
from helpers.verification import job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.spatial_fields import ByRegion
from hpcinv.errors import OutputError
from hpcinv.geometry.workshop.run_shapes import read_shape
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.job import load
from hpcinv.mesh.source import DataArray, Group
from hpcinv.physics.materials import laws
from hpcinv.studies.second_opinion.febio_model import write_model
from hpcinv.studies.second_opinion.fibre_directions import directions_in_cells
from hpcinv.studies.second_opinion.foundations import Foundation
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody, loaded_body
from hpcinv.studies.second_opinion.opinion import second_opinion
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.remote_regions import RemoteRegion
from hpcinv.studies.second_opinion.slides import Slide
from hpcinv.studies.second_opinion.uniform_parts import CellValues, with_uniform_parts
from hpcinv.studies.second_opinion.units import Units

MESHES = Path(__file__).parents[2] / "meshes"
STRETCH = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.02], [0.03, 0.0, 1.05]])
SCALE = 1e3
"""of lengths in a model in mm"""


def body(degree: int = 1, *, hexahedra: bool = False) -> LoadedBody:
    """A block of 2 m x 1 m x 1 m under a uniform deformation."""
    mesh = block(MESHES, hexahedra, degree)
    law = laws()["neo-hookean"]
    one = {"": law.model_validate(law.example)}
    return LoadedBody(name="a", rest=mesh, loaded=mesh.points @ STRETCH.T, laws=one, forces=np.zeros_like(mesh.points))


def nodes_of(posed: LoadedBody, region: str) -> Any:
    return np.unique(posed.rest.facets[group_of(posed.rest, region).members])


def slide(posed: LoadedBody, region: str, direction: Any) -> Slide:
    nodes = nodes_of(posed, region)
    directions = np.tile(np.array(direction) / np.linalg.norm(direction), (len(nodes), 1))
    values = np.einsum("ni,ni->n", directions, posed.displacement[nodes])
    return Slide(f"slide-{region}", nodes, directions, values, region)


def written(posed: LoadedBody, path: Path) -> ET.Element:
    write_model(path / "part.feb", posed, Units(1 / SCALE))
    return ET.parse(path / "part.feb").getroot()


def constraints(root: ET.Element) -> dict[tuple[int, str], tuple[float, dict[tuple[int, str], float]]]:
    """Offset and factors of the linear constraints, by node and axis of what they eliminate."""
    found = {}
    for entry in root.findall("Boundary/bc[@type='linear constraint']"):
        children = {
            (int(child.findtext("node", "")), child.findtext("dof", "")): float(child.findtext("value", ""))
            for child in entry.findall("child_dof")
        }
        place = int(entry.findtext("node", "")), entry.findtext("dof", "")
        found[place] = float(entry.findtext("offset", "0")), children
    return found


def displacements(posed: LoadedBody) -> dict[tuple[int, str], float]:
    tags = posed.rest.node_tags.tolist()
    rows = zip(tags, (SCALE * posed.displacement).tolist(), strict=True)
    return {(tag, axis): value for tag, row in rows for axis, value in zip("xyz", row, strict=True)}


def test_nodes_that_slide_are_eliminated_and_agree_with_the_run(tmp_path: Path) -> None:
    """Two oblique planes, an axis that another support holds at some of their nodes, and a third plane at an edge."""
    posed = body()
    posed.slides += [slide(posed, "z1", (0, 1, 2)), slide(posed, "x1", (3, 0.5, 0.2)), slide(posed, "y1", (0, 1, 0.3))]
    held = nodes_of(posed, "y0")
    posed.held.append(Held("supports[0]", held, 1, posed.displacement[held, 1], "y0"))
    root, known = written(posed, tmp_path), displacements(posed)
    found = constraints(root)
    for place, (offset, children) in found.items():
        value = offset + sum(factor * known[child] for child, factor in children.items())
        assert value == pytest.approx(known[place], abs=1e-9 * SCALE)
        assert not children.keys() & found.keys()  # FEBio refuses these
    sliding = {row for entry in posed.slides for row in entry.nodes.tolist()}
    conditions = sum(len(entry.nodes) for entry in posed.slides)
    corners = [row for row in sliding if all(row in entry.nodes for entry in posed.slides)]
    assert len(corners) == 1
    alone = [entry for entry in root.findall("Boundary/bc") if entry.get("name", "").startswith("slides-")]
    assert {entry.findtext("dof") for entry in alone} == {"x", "y", "z"}
    sets = {entry.get("name"): (entry.text or "").split(",") for entry in root.iter("NodeSet")}
    assert len(found) + sum(len(sets[entry.get("node_set")]) for entry in alone) == conditions


@pytest.mark.parametrize(("normal", "tangential", "degree"), [(5e3, 5e3, 1), (5e3, 0.0, 2), (4e3, 1e3, 1)])
def test_springs_have_the_stiffness_of_the_foundation(
    normal: float, tangential: float, degree: int, tmp_path: Path
) -> None:
    """A displacement c of the whole surface stretches springs of an energy of ``A/2 (k_n c_n² + k_t c_t²)``."""
    posed = body(degree)
    shift = np.array([0.01, 0.02, -0.03])
    posed = dataclasses.replace(posed, loaded=posed.rest.points + shift, quadrature=2 * degree)
    posed.foundations.append(Foundation("effects[0]", group_of(posed.rest, "x1"), normal, tangential, False))
    posed.slides.append(slide(posed, "z1", (0, 1, 2)))
    root, known = written(posed, tmp_path), displacements(posed)
    places = {
        int(n.get("id", "")): np.array([float(x) for x in (n.text or "").split(",")])
        for n in root.iterfind("Mesh/Nodes/node")
    }
    moved = {}
    for place, (offset, children) in constraints(root).items():
        moved[place] = offset + sum(factor * known[child] for child, factor in children.items())
    stiffness = {e.get("name"): float(e.findtext("E", "")) for e in root.findall("Discrete/discrete_material")}
    energy = 0.0
    for springs in root.iter("DiscreteSet"):
        for pair in springs:
            point, end = (int(tag) for tag in (pair.text or "").split(","))
            u = np.array([moved.get((point, axis), 0.0) for axis in "xyz"])
            before, after = places[end] - places[point], places[end] - places[point] - u
            stretch = float(np.linalg.norm(after) - np.linalg.norm(before))
            energy += stiffness[springs.get("name")] / 2 * stretch**2
    area = 1.0
    wanted = area / 2 * (normal * shift[0] ** 2 + tangential * (shift[1] ** 2 + shift[2] ** 2))
    assert energy / SCALE == pytest.approx(wanted, rel=1e-4)  # N mm
    fixed = {entry.get("node_set"): entry for entry in root.findall("Boundary/bc[@type='zero displacement']")}
    assert {dof.text for dof in fixed["hpcinv-ground"]} == {"1"}
    assert ("hpcinv-spring-points" in fixed) == (not tangential)


def test_a_remote_load_is_on_a_rigid_body_whose_centre_is_its_point(tmp_path: Path) -> None:
    posed = body()
    force, moment, point = np.array([1.0, 0.0, -2.0]), np.array([0.0, 3.0, 0.5]), np.array([2.5, 0.5, 0.5])
    remote = RemoteRegion("supports[1]", group_of(posed.rest, "x1"), point, force, moment, np.array([0.1, 0.2, 0.3]))
    posed.remotes.append(remote)
    root = written(posed, tmp_path)
    [rigid] = [entry for entry in root.iter("material") if entry.get("type") == "rigid body"]
    assert [float(x) for x in rigid.findtext("center_of_mass", "").split(",")] == [2500, 500, 500]
    [condition] = root.findall("Boundary/bc[@type='rigid']")
    assert (condition.get("node_set"), condition.findtext("rb")) == ("x1", rigid.get("id"))
    loads = {
        (e.get("type"), e.findtext("dof")): float(e.findtext("value", "")) for e in root.findall("Rigid/rigid_load")
    }
    forces, moments = {("rigid_force", "Rx"): 1, ("rigid_force", "Rz"): -2}, {("rigid_moment", "Rv"): 3000}
    assert loads == forces | moments | {("rigid_moment", "Rw"): 500}
    edge = nodes_of(posed, "y0")
    posed.held.append(Held("supports[0]", edge, 1, np.zeros(len(edge)), "y0"))
    with pytest.raises(OutputError, match=r"supports\[0\]: shares nodes with the rigid region of supports\[1\]"):
        written(posed, tmp_path)


@dataclasses.dataclass
class PartOfJob:
    """What directions and parts need of a job."""

    fibres: dict[str, FibreFamily] = dataclasses.field(default_factory=dict)
    directions: tuple[str, ...] = ("inverse",)
    regions: dict[str, Any] = dataclasses.field(default_factory=dict)


@pytest.mark.parametrize(("hexahedra", "degree"), [(False, 2), (True, 2), (True, 1)])
@pytest.mark.parametrize("given_on", ["reference", "current"])
def test_fibres_that_vary_are_data_at_the_nodes_of_elements(
    given_on: str, hexahedra: bool, degree: int, tmp_path: Path
) -> None:
    posed = body(degree, hexahedra=hexahedra)
    letters = "XYZ" if given_on == "reference" else "xyz"
    formulas = ["c + {0}*{1}/c", "{2}", "0.2*c"]
    direction = [formula.format(*letters) for formula in formulas]
    family = FibreFamily.model_validate({"direction": direction, "given_on": given_on, "constants": {"c": "1 m"}})
    loaded = dataclasses.replace(posed.rest, points=posed.loaded)
    posed.fibre_fields = dict(directions_in_cells(PartOfJob({"fibre": family}), posed.rest, loaded))  # type: ignore[arg-type]
    law = laws()["transversely-isotropic"]
    posed.laws = {"": law.model_validate(law.example)}
    root = written(posed, tmp_path)
    assert [entry.text for entry in root.iter("fiber")] == ["fibre"]
    [data] = root.findall("MeshData/ElementData")
    [part] = root.iter("Elements")
    listed = next(e for e in root.iter("ElementSet") if e.get("name") == data.get("elem_set"))
    assert [int(tag) for tag in (listed.text or "").split(",")] == [int(e.get("id", "")) for e in part]
    places = {
        n.get("id"): np.array([float(x) for x in (n.text or "").split(",")]) / SCALE
        for n in root.iterfind("Mesh/Nodes/node")
    }
    assert len(data) == len(part)
    for entry, element in zip(data, part, strict=True):
        vectors = np.array([float(x) for x in (entry.text or "").split(",")]).reshape(-1, 3)
        points = np.array([places[tag] for tag in (element.text or "").split(",")])
        x, y, z = (points if given_on == "reference" else points @ STRETCH.T).T
        wanted = np.stack([1 + x * y, z, np.full(len(x), 0.2)], axis=1)
        if given_on == "current":
            wanted = wanted @ np.linalg.inv(STRETCH).T
        assert vectors == pytest.approx(wanted / np.linalg.norm(wanted, axis=1)[:, None], abs=1e-12)


@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_fibres_by_a_rule_are_those_that_the_run_has_kept(direction: str) -> None:
    """On the body that the run computed: at rest, or loaded and pulled back from there; data are on the given body."""
    posed = body(2)
    kept = np.random.default_rng(1).normal(size=(len(posed.rest.cells), 3))
    array = {"fibres.fibre": DataArray("fibres.fibre", "cells", kept), "sheet": DataArray("sheet", "cells", kept)}
    rule = {"kind": "tube", "inner": "x0", "outer": "x1", "inlet": "y0", "outlet": "y1", "helix": "30 deg"}
    families = {
        "fibre": FibreFamily.model_validate({"rule": rule, "given_on": "reference"}),
        "other": FibreFamily.model_validate({"data": "sheet", "given_on": "current"}),
    }
    rest = dataclasses.replace(posed.rest, data=array)
    loaded = dataclasses.replace(rest, points=posed.loaded)
    found = dict(directions_in_cells(PartOfJob(families, (direction,)), rest, loaded))  # type: ignore[arg-type]
    pulled = kept @ np.linalg.inv(STRETCH).T
    for name, wanted in (("fibre", kept if direction == "inverse" else pulled), ("other", pulled)):
        assert found[name][:, 0] == pytest.approx(wanted / np.linalg.norm(wanted, axis=1)[:, None], abs=1e-12)
    with pytest.raises(OutputError, match=r"fibres.fibre: .* has no array 'fibre'"):
        dict(directions_in_cells(PartOfJob(families, (direction,)), posed.rest, posed.rest))  # type: ignore[arg-type]


def test_parameters_by_cell_and_densities_by_region_are_parts() -> None:
    """The values of the cells are not sorted; a group of the mesh that is a part keeps its name."""
    mesh = block(MESHES, False, 1)
    moduli = np.array([2.0, 1.0, 3.0])[np.arange(len(mesh.cells)) % 3]
    stiff = np.flatnonzero(moduli == 3)
    mesh = dataclasses.replace(mesh, groups=(*mesh.groups, Group("stiff", 3, 9, stiff)))
    data = {"modulus": DataArray("modulus", "cells", moduli[:, None])}
    law = laws()["isochoric-neo-hookean"].model_validate(
        {"law": "isochoric-neo-hookean", "mu": {"data": "modulus", "unit": "kPa"}, "kappa": 1e5}
    )
    values = CellValues(mesh, data, PartOfJob())  # type: ignore[arg-type]
    density = ByRegion({"stiff": 1200.0, "elsewhere": 900.0})
    parted, own, densities = with_uniform_parts({"": law}, density, values)
    assert {name: part.mu for name, part in own.items()} == {"part_1": 1e3, "part_2": 2e3, "stiff": 3e3}  # type: ignore[attr-defined]
    assert densities == {"part_1": 900, "part_2": 900, "stiff": 1200}
    for name, part in own.items():
        assert np.array_equal(group_of(parted, name, 3).members, np.flatnonzero(moduli == part.mu / 1e3))  # type: ignore[attr-defined]
    assert with_uniform_parts({"": law}, None, CellValues(mesh, {}, values.job))[1] == {"": law}  # no such array


def test_a_state_of_a_job_is_written_and_read_back(tmp_path: Path) -> None:
    """With oblique planes that meet in an edge, which are equations there; and both states as steps for CalculiX."""
    gravity = {"effect": "gravity", "acceleration": [0, 1, -2], "density": 1000}
    pull = {"effect": "traction", "region": "z1", "traction": [100, 0, 150], "area_in": "reference"}
    size = {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 1}
    states = [{"name": "worn", "given": True, "effects": [gravity]}, {"name": "pulled", "effects": [gravity, pull]}]
    run = tmp_path / "run"
    sections = {
        "mesh": {"file": "../meshes/box.py", "parameters": size},
        "material": {"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4},
        "discretisation": {"displacement": 1, "formulation": "displacement"},
        "supports": [
            {"region": "z0", "fix": ["x", "y", "z"]},
            {"region": "x0", "fix": ["normal"], "normal": [2, 1, 0]},
            {"region": "y1", "fix": ["normal"], "normal": [0, 3, 1]},
        ],
        "output": {"mesh": ["msh"], "fields": False},
    }
    hpcinv.run(job(**sections, states=states), MPI.COMM_SELF, directory=run, progress=False)
    deck, back = tmp_path / "part.feb", tmp_path / "back.yaml"
    assert main(["export", str(run), "--deck", str(deck), "--unit", "mm", "--shape", "pulled"]) == 0
    assert main(["new", "job", "--from", str(deck), "--unit", "mm", "--stress-unit", "MPa", str(back)]) == 0
    assert "Not taken from the file" not in back.read_text()
    again = load(back).with_({"discretisation": sections["discretisation"], "certificate": "off"})
    found = hpcinv.run(again, MPI.COMM_SELF, progress=False)
    np.testing.assert_allclose(found.shape_in_file, read_shape(run, "pulled").points, rtol=0, atol=1e-7)
    assert np.allclose(loaded_body(run, abilities=["slides"]).loaded, read_shape(run, "worn").points)
    deck = tmp_path / "part.inp"
    options = ["--unit", "mm", "--force-unit", "uN", "--shape"]
    assert main(["export", str(run), "--deck", str(deck), *options, "worn,pulled"]) == 0
    assert main(["export", str(run), "--deck", str(tmp_path / "part.cdb"), *options, "worn,pulled"]) == 2
    if shutil.which("ccx"):
        subprocess.run(["ccx", "part"], cwd=tmp_path, stdout=subprocess.DEVNULL, check=True)
        blocks = deck.with_suffix(".dat").read_text().split("displacements")[1:]
        for block_of_step, name in zip(blocks, ("part-expected.csv", "part-expected-2.csv"), strict=True):
            rows = [line.split() for line in block_of_step.splitlines() if len(line.split()) == 4]
            expected = np.loadtxt(tmp_path / name, delimiter=",", skiprows=1)
            moved = expected[:, 4:] - expected[:, 1:4]
            np.testing.assert_allclose(np.array(rows, dtype=float)[:, 1:], moved, atol=1e-4 * np.abs(moved).max())
        opinion = second_opinion(run, None, 60)
        assert opinion.lines()[1:] == ["its elements (C3D4) are ours", "the loaded body is the state 'worn'"]
        assert opinion.largest < 1e-5 * opinion.displacement
    with pytest.raises(OutputError, match="--shape rest: is not a loaded state"):
        loaded_body(run, state="rest")
