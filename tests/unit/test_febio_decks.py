"""FEBio's models: supports and loads on whole parts, options that are not read, directions of elements."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.feb_data import directions_in
from hpcinv.formats.cards.febio_deck import read_deck
from hpcinv.job.job import load

MODEL = """<febio_spec version="4.0"><Module type="solid"/>
<Material><material id="1" name="soft" type="neo-Hookean"><E>2</E><v>0.3</v></material></Material>
<Mesh><Nodes>
<node id="1">0,0,0</node><node id="2">1,0,0</node><node id="3">0,1,0</node><node id="4">0,0,1</node>
<node id="5">1,1,1</node></Nodes>
<Elements type="tet4" name="a"><elem id="1">1,2,3,4</elem></Elements>{more}
<Surface name="side"><tri3 id="1">1,3,4</tri3></Surface><NodeSet name="side">1,2,3</NodeSet></Mesh>
<MeshDomains><SolidDomain name="a" mat="soft"/>{domain}</MeshDomains>
<Boundary><bc node_set="{region}" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc>
</Boundary>
</febio_spec>
"""
SECOND = '<Elements type="tet4" name="b"><elem id="2">2,3,4,5</elem></Elements>', '<SolidDomain name="b" mat="soft"/>'


def job_of(tmp_path: Path, text: str) -> tuple[dict[str, Any], str]:
    (tmp_path / "a.feb").write_text(text)
    options = ["--unit", "mm", "--stress-unit", "MPa", str(tmp_path / "a.yaml"), "--force"]
    assert main(["new", "job", "--from", str(tmp_path / "a.feb"), *options]) == 0
    written = (tmp_path / "a.yaml").read_text()
    return yaml.safe_load(written), written


def test_a_support_on_a_whole_part_is_a_job_that_can_run(tmp_path: Path) -> None:
    job, text = job_of(tmp_path, MODEL.format(more="", domain="", region="@elem_set:a"))
    assert job["supports"] == [{"region": "boundary", "fix": ["x", "y", "z"]}]
    assert "the whole body, holds its boundary" in text
    load(tmp_path / "a.yaml")
    more, domain = SECOND
    job, _ = job_of(tmp_path, MODEL.format(more=more, domain=domain, region="@elem_set:a"))
    assert job["supports"] == [{"region": "a_vertices", "fix": ["x", "y", "z"]}]
    assert len(job["regions"]["a_vertices"]["vertices"]) == 4
    load(tmp_path / "a.yaml")


@pytest.mark.release
def test_a_node_set_and_a_surface_of_one_name_are_told_apart(tmp_path: Path) -> None:
    job, _ = job_of(tmp_path, MODEL.format(more="", domain="", region="side"))
    assert job["supports"][0]["region"] == "side-nodes"
    assert main(["validate", str(tmp_path / "a.yaml")]) == 0
    job, _ = job_of(tmp_path, MODEL.format(more="", domain="", region="@surface:side"))
    assert job["supports"][0]["region"] == "side"


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        ('<bc node_set="side" type="zero displacement"><x_dof>1</x_dof><sx_dof>1</sx_dof></bc>', "<sx_dof>"),
        ('<bc node_set="side" type="zero displacement" active="0"><x_dof>1</x_dof></bc>', "active="),
        ('<bc node_set="side" type="zero displacement"><x_dof>1</x_dof><sx_dof>0</sx_dof></bc>', ""),
    ],
)
def test_options_that_are_not_read_are_listed(entry: str, word: str) -> None:
    text = f"<febio_spec version='4.0'><Boundary>{entry}</Boundary></febio_spec>"
    unused = read_deck(text, {}).unused
    assert any(word in line for line in unused) if word else not unused


@pytest.mark.parametrize(("facets", "pressures"), [(["1,3,2"], [5.0]), (["1,2,3"], [-5.0]), (["1,3,2", "1,4,2"], [])])
def test_a_pressure_acts_against_the_normal_as_the_facets_turn(facets: list[str], pressures: list[float]) -> None:
    nodes = "".join(f'<node id="{i}">{place}</node>' for i, place in enumerate(("0,0,0", "1,0,0", "0,1,0", "0,0,1"), 1))
    faces = "".join(f'<tri3 id="{i}">{facet}</tri3>' for i, facet in enumerate(facets, 1))
    text = (
        f'<febio_spec version="4.0"><Mesh><Nodes>{nodes}</Nodes><Elements type="tet4" name="a">'
        f'<elem id="1">1,2,3,4</elem></Elements><Surface name="s">{faces}</Surface></Mesh>'
        '<Loads><surface_load surface="s" type="pressure">'
        "<pressure>5</pressure></surface_load></Loads></febio_spec>"
    )
    deck = read_deck(text, {})
    assert [effect["pressure"].value for effect in deck.effects] == pressures
    assert bool(deck.unused) == (not pressures)


@pytest.mark.parametrize(
    ("kind", "supports", "unused"),
    [
        ("symmetry plane", [{"region": "side", "fix": ["normal"], "of": "surface"}], []),
        ("fixed normal displacement", [{"region": "side", "fix": ["normal"], "of": "surface"}], []),
        ("volume", [], ["<constraint type='volume'>"]),
    ],
)
def test_surfaces_that_slide_are_read(kind: str, supports: list[Any], unused: list[str]) -> None:
    entry = f'<constraint type="{kind}" surface="side"><penalty>1e5</penalty></constraint>'
    deck = read_deck(f"<febio_spec version='4.0'><Constraints>{entry}</Constraints></febio_spec>", {})
    assert deck.supports == supports
    assert deck.unused == unused


RIGID = """<febio_spec version="4.0"><Material>
<material id="2" name="cap" type="rigid body"><density>1</density><center_of_mass>1,2,3</center_of_mass></material>
</Material><Boundary><bc type="rigid" node_set="top"><rb>cap</rb></bc></Boundary>
<Rigid><rigid_load type="rigid_force"><rb>2</rb><dof>Rx</dof><value lc="1">4</value></rigid_load>
<rigid_load type="rigid_moment"><rb>2</rb><dof>Rw</dof><value>5</value>{more}</rigid_load></Rigid>
<LoadData><load_controller id="1" type="loadcurve"><points><pt>0,0</pt><pt>1,0.5</pt></points></load_controller>
</LoadData></febio_spec>"""


def test_forces_and_moments_on_rigid_nodes_are_a_remote_load() -> None:
    deck = read_deck(RIGID.format(more=""), {})
    [region] = deck.remotes
    assert (region.region, region.of) == ("top", "nodes")
    values = {key: [m.value for m in vector] for key, vector in region.section["remote"].items()}
    assert values == {"force": [2, 0, 0], "moment": [0, 0, 5], "about": [1, 2, 3]}
    assert not deck.unused
    deck = read_deck(RIGID.format(more="<load_type>FOLLOW</load_type>"), {})
    assert not deck.remotes
    assert deck.unused[:1] == ["<bc type='rigid'> on top"]


def vectors(entries: str) -> dict[str, Any]:
    """Directions of three elements; a set has the first two."""
    root = ET.fromstring(
        f"<febio_spec><MeshData><ElementData name='fibres' elem_set='part' data_type='vec3'>{entries}"
        "</ElementData><ElementData name='other' elem_set='unknown' data_type='vec3'><e lid='1'>1,0,0</e>"
        "</ElementData></MeshData></febio_spec>"
    )
    return directions_in(root, {"part": [5, 7]}, [7, 5, 9])


def test_directions_of_elements_are_the_means_of_their_nodes() -> None:
    """Elements are numbered within their set; the one that is not in it has no direction."""
    found = vectors("<e lid='2'>0,2,0</e><e lid='1'>1 0 0  0,0,1</e>")
    assert list(found) == ["fibres"]
    assert found["fibres"].tolist() == [[0, 2, 0], [0.5, 0, 0.5], [0, 0, 0]]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("<e lid='3'>1,0,0</e>", "lid='3', not 1 to 2"),
        ("<e>1,0,0</e>", "lid='', not 1 to 2"),
        ("<e lid='1'>1,0</e>", "not three numbers"),
        ("<e lid='1'>1,0,nan</e>", "not three numbers"),
        ("<e lid='1'>a,b,c</e>", "not three numbers"),
        ("<e lid='1'/>", "not three numbers"),
    ],
)
def test_damaged_directions_are_refused(entry: str, message: str) -> None:
    with pytest.raises(Fault, match=f"data 'fibres' have .*{message}"):
        vectors(entry)
