"""Files of FEBio: what the reader of published tests finds in them, and the job that it makes."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT

from hpcinv.job.job import load

BAR = """<?xml version="1.0" encoding="UTF-8"?>
<febio_spec version="4.0">
  <Module type="solid"/>
  <Control>
    <analysis>STATIC</analysis><time_steps>4</time_steps><step_size>0.25</step_size>
    <solver type="solid"><dtol>0.001</dtol></solver>
  </Control>
  <Material><material id="1" name="rubber" type="neo-Hookean"><E lc="2">3</E><v>0</v></material></Material>
  <Mesh>
    <Nodes name="all">
      <node id="11">0,0,0</node><node id="12">1,0,0</node><node id="13">1,1,0</node><node id="14">0,1,0</node>
      <node id="21">0,0,1</node><node id="22">1,0,1</node><node id="23">1,1,1</node><node id="24">0,1,1</node>
      <node id="31">0,0,2</node><node id="32">1,0,2</node><node id="33">1,1,2</node><node id="34">0,1,2</node>
      <node id="99">5,5,5</node>
    </Nodes>
    <Elements type="hex8" name="bar">
      <elem id="1">11,12,13,14,21,22,23,24</elem><elem id="2">21,22,23,24,31,32,33,34</elem>
    </Elements>
    <NodeSet name="bottom">11, 12,
      13, 14</NodeSet>
    <NodeSet name="left">11,14,21,24,31,34</NodeSet>
    <NodeSet name="edge">11,21</NodeSet>
    <Surface name="top"><quad4 id="1">31,32,33,34</quad4></Surface>
  </Mesh>
  <MeshDomains><SolidDomain name="bar" mat="rubber"/></MeshDomains>
  <Boundary>
    <bc name="a" node_set="bottom" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc>
    <bc name="b" node_set="left" type="zero displacement"><x_dof>1</x_dof><y_dof>0</y_dof><z_dof>0</z_dof></bc>
    <bc name="c" node_set="@surface:top" type="prescribed displacement">
      <dof>z</dof><value lc="1">4</value><relative>0</relative>
    </bc>
  </Boundary>
  <LoadData>
    <load_controller id="1" type="loadcurve"><interpolate>LINEAR</interpolate><extend>CONSTANT</extend>
      <points><pt>0,0</pt><pt>2,1</pt></points></load_controller>
    <load_controller id="2" type="loadcurve"><interpolate>STEP</interpolate><extend>CONSTANT</extend>
      <points><pt>0,2</pt></points></load_controller>
  </LoadData>
</febio_spec>
"""


@pytest.fixture(autouse=True)
def benchmarks_importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)


def read(path: Path, text: str) -> Any:
    from benchmarks.published.febio.feb_reader import read_feb

    path.write_text(text)
    return read_feb(path)


def test_values_are_those_at_the_end_of_the_last_step(tmp_path: Path) -> None:
    model = read(tmp_path / "bar.feb", BAR)
    (block,) = model.blocks
    assert (block.kind, block.material, block.nodes.shape) == ("hex8", "rubber", (2, 8))
    assert model.points[model.numbers == 33].tolist() == [[1, 1, 2]]
    assert model.materials["rubber"].number("E") == 6
    assert model.conditions[2].number("value") == 2
    assert model.nodes_of("bottom").tolist() == [11, 12, 13, 14]
    assert model.nodes_of("@surface:top").tolist() == [31, 32, 33, 34]
    assert model.unread == ()
    assert model.rest == 0
    contact = read(tmp_path / "contact.feb", BAR.replace("<LoadData>", "<Contact><contact/></Contact><LoadData>"))
    assert contact.unread == ("Contact",)


BAR_2 = """<febio_spec version="2.5">
  <Module type="solid"/>
  <Control><analysis type="static"/><time_steps>4</time_steps><step_size>0.25</step_size><dtol>0.001</dtol></Control>
  <Material><material id="1" name="rubber" type="neo-Hookean"><E lc="2">3</E><v>0</v></material></Material>
  <Geometry>
    <Nodes>NODES</Nodes>
    <Elements type="hex8" mat="1">ELEMENTS</Elements>
    <NodeSet name="bottom"><node id="11"/><node id="12"/><node id="13"/><node id="14"/></NodeSet>
    <NodeSet name="left">
      <node id="11"/><node id="14"/><node id="21"/><node id="24"/><node id="31"/><node id="34"/>
    </NodeSet>
    <Surface name="top"><quad4 id="1">31,32,33,34</quad4></Surface>
  </Geometry>
  <Boundary>
    <fix bc="x,y,z" node_set="bottom"/><fix bc="x" node_set="left"/>
    <prescribe bc="z" surface="top"><scale lc="1">4</scale><relative>0</relative></prescribe>
  </Boundary>
  <LoadData>
    <loadcurve id="1" type="linear"><point>0,0</point><point>2,1</point></loadcurve>
    <loadcurve id="2" type="step" extend="constant"><point>0,2</point></loadcurve>
  </LoadData>
</febio_spec>
"""
BAR_3 = """<febio_spec version="3.0">
  <Module type="solid"/>
  <Control><analysis>STATIC</analysis><time_steps>4</time_steps><step_size>0.25</step_size></Control>
  <Material><material id="1" name="rubber" type="neo-Hookean"><E lc="2">3</E><v>0</v></material></Material>
  <Mesh>
    <Nodes name="all">NODES</Nodes>
    <Elements type="hex8" name="bar">ELEMENTS</Elements>
    <NodeSet name="bottom"><n id="11"/><n id="12"/><n id="13"/><n id="14"/></NodeSet>
    <NodeSet name="left"><n id="11"/><n id="14"/><n id="21"/><n id="24"/><n id="31"/><n id="34"/></NodeSet>
    <Surface name="top"><quad4 id="1">31,32,33,34</quad4></Surface>
  </Mesh>
  <MeshDomains><SolidDomain name="bar" mat="rubber"/></MeshDomains>
  <Boundary>
    <bc type="fix" node_set="bottom"><dofs>x,y,z</dofs></bc><bc type="fix" node_set="left"><dofs>x</dofs></bc>
    <bc type="prescribe" node_set="@surface:top"><dof>z</dof><scale lc="1">4</scale><relative>0</relative></bc>
  </Boundary>
  <LoadData>
    <load_controller id="1" type="loadcurve"><points><point>0,0</point><point>2,1</point></points></load_controller>
    <load_controller id="2" type="loadcurve"><interpolate>STEP</interpolate>
      <points><point>0,2</point></points></load_controller>
  </LoadData>
</febio_spec>
"""


@pytest.mark.parametrize("text", [BAR_2, BAR_3], ids=["2.5", "3.0"])
def test_older_formats_give_the_same_job(tmp_path: Path, text: str) -> None:
    from benchmarks.published.febio.conversion import convert

    nodes = re.search("<Nodes[^>]*>(.*)</Nodes>", BAR, re.DOTALL)
    elements = re.search("<Elements[^>]*>(.*)</Elements>", BAR, re.DOTALL)
    assert nodes
    assert elements
    text = text.replace("NODES", nodes[1]).replace("ELEMENTS", elements[1])
    older, newest = (convert(read(tmp_path / "bar.feb", content), "bar") for content in (text, BAR))
    assert older.job == newest.job
    for name in ("points", "cells", "facets", "node_tags"):
        assert np.array_equal(getattr(older.source, name), getattr(newest.source, name))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</febio_spec>", "", "is not XML"),
        ('version="4.0"', 'version="1.2"', "is of format 1.2; formats 2.5"),
        ("febio_spec", "svg", "not a model of FEBio"),
        ("<febio_spec", '<!DOCTYPE a [<!ENTITY b "c">]><febio_spec', "entities"),
        ('<elem id="1">11,', '<elem id="1">', "a hex8 has 8 nodes"),
        ('<node id="12">1,0,0', '<node id="12">1,0,nan', "not finite"),
        ('<node id="12">1,0,0', '<node id="11">1,0,0', "same number"),
        ('<value lc="1">', '<value lc="7">', "no load curve 7"),
        ("<Control>", "<Other>", "mismatched|is not XML"),
    ],
)
def test_damaged_files_are_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    from benchmarks.published.febio.feb_reader import FebError

    assert old in BAR
    with pytest.raises(FebError, match=rf"bar.feb: .*({message})"):
        read(tmp_path / "bar.feb", BAR.replace(old, new, 2 if new == "svg" else 1))


def test_load_curves_have_the_value_of_their_kind() -> None:
    from hpcinv.formats.cards.card import CardError
    from hpcinv.formats.cards.febio_curves import curve_value

    points = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 9.0]])
    assert curve_value(points, "LINEAR", "CONSTANT", 1.0) == 2
    assert curve_value(points, "STEP", "CONSTANT", 1.0) == 3
    assert curve_value(points, "SMOOTH", "CONSTANT", 2.0) == 3
    assert curve_value(points, "SMOOTH", "CONSTANT", 5.0) == 9
    assert curve_value(points[:2], "SMOOTH", "CONSTANT", 1.0) == 2
    for kind, extend, time in (("SMOOTH", "CONSTANT", 1.0), ("LINEAR", "REPEAT", 5.0)):
        with pytest.raises(CardError, match=kind):
            curve_value(points, kind, extend, time)


def test_conditions_that_share_facets_become_separate_groups(tmp_path: Path) -> None:
    from benchmarks.published.febio.conversion import convert, prescribed

    model = read(tmp_path / "bar.feb", BAR.replace('node_set="left"', 'node_set="@elem_set:bar"'))
    conversion = convert(model, "bar")
    facets = np.concatenate([group.members for group in conversion.source.groups])
    assert sorted(facets) == list(range(len(conversion.source.facets))) == list(range(10))
    assert len(conversion.source.points) == 12  # without the node of no element
    supports = conversion.job["supports"]
    assert [support.get("displacement") for support in supports if "displacement" in support] == [[None, None, 2.0]]
    assert sum(support.get("fix") == ["x"] for support in supports) == 3
    values = prescribed(model)
    assert {node for node, axis in values if axis == 0} == {11, 12, 13, 14, 21, 22, 23, 24, 31, 32, 33, 34}
    assert values[33, 2] == 2


def test_features_without_a_counterpart_are_named(tmp_path: Path) -> None:
    from benchmarks.published.febio.conversion import Unsupported, convert
    from hpcinv.formats.cards.card import UnknownLaw

    with pytest.raises(Unsupported, match=r"do not fill facets \(edge\)"):
        convert(read(tmp_path / "bar.feb", BAR.replace('node_set="left"', 'node_set="edge"')), "bar")
    with pytest.raises(UnknownLaw, match="law Shenoy"):
        convert(read(tmp_path / "bar.feb", BAR.replace('"neo-Hookean"', '"Shenoy"')), "bar")
    with pytest.raises(Unsupported, match="Rigid"):
        convert(read(tmp_path / "bar.feb", BAR.replace("<LoadData>", "<Rigid><a/></Rigid><LoadData>")), "bar")


def test_a_file_gives_the_norm_of_its_free_displacements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hpcinv
    from benchmarks.published.febio import cases
    from benchmarks.published.runs import Missing

    monkeypatch.delenv(cases.FOLDER, raising=False)
    with pytest.raises(Missing, match=cases.FOLDER):
        cases.job_file("bar", tmp_path)
    (tmp_path / "Verify").mkdir()
    (tmp_path / "Verify" / "bar.feb").write_text(BAR)
    monkeypatch.setenv(cases.FOLDER, str(tmp_path))
    with pytest.raises(Missing, match=r"other.feb is missing"):
        cases.job_file("other", tmp_path)
    job = load(cases.job_file("bar", tmp_path / "store"))
    result = hpcinv.run(job.with_({"output.mesh": ["msh"]}), directory=tmp_path / "run", progress=False)
    # the length doubles without change of the section: four nodes in the middle move by 1
    assert cases.quantities("bar", result) == {"norm": pytest.approx(2, rel=1e-11)}
    back = load(cases.job_file("bar-unloaded", tmp_path / "store"))
    result = hpcinv.run(back.with_({"mesh.file": str(tmp_path / "run" / "shape.msh")}), progress=False)
    radius = math.sqrt((4 * (0 + 1 + 1 + 2) / 4 * 3 + 4 * (0 + 1 + 4)) / 12)
    assert cases.quantities("bar-unloaded", result) == {"radius": pytest.approx(radius, rel=1e-11)}


def test_formulas_of_laws_agree_with_their_functions() -> None:
    from hpcinv.formats.cards.series import exponential_integral, inverse_langevin

    series = inverse_langevin(20)
    for x in (0.1, 0.3, 0.45):
        b = sum(c * x ** (2 * k + 1) for k, c in enumerate(series))
        assert 1 / math.tanh(b) - 1 / b == pytest.approx(x, rel=1e-10)
    for strain, factor in ((0.055, 30.6), (0.8, 1.0), (0.07, 43.0)):
        formula = exponential_integral("s", "c").replace("exp", "math.exp")
        stretches = 1 + strain * (np.arange(200_000) + 0.5) / 200_000
        reference = float(np.mean((np.exp(factor * (stretches - 1)) - 1) / stretches)) * strain
        assert eval(formula, {"math": math, "s": strain, "c": factor}) == pytest.approx(reference, rel=1e-9)
