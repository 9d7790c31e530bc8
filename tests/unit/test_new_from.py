"""``hpcinv new job --from``: materials, supports and loads of other programs' files as a job."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.mesh_cases import spec

from hpcinv.__main__ import main
from hpcinv.errors import MeshError
from hpcinv.formats.cards.abaqus_deck import read_deck
from hpcinv.formats.cards.deck import Measure
from hpcinv.job.job import load
from hpcinv.mesh import read_source

pytestmark = pytest.mark.usefixtures("warm_reader")

INP = """*HEADING
*NODE
1,0,0,0
2,10,0,0
3,0,10,0
4,0,0,10
5,10,10,10
*ELEMENT, TYPE=C3D4, ELSET=Body
1,1,2,3,4
2,2,3,4,5
*NSET, NSET=Foot
1,2,3
*NSET, NSET=Tip
5
*SURFACE, NAME=Side
2, S3
*SOLID SECTION, ELSET=Body, MATERIAL=Rubber
*MATERIAL, NAME=Rubber
*HYPERELASTIC, NEO HOOKE
0.1, 0.2
*DENSITY
1e-9
*STEP
*BOUNDARY
foot, 1, 2
Foot, 3, 3, 0.5
Tip, 1
*DSLOAD
Side, P, 0.01
*DLOAD
Body, GRAV, 9810., 0,0,-1
*CLOAD
5, 1, 2.
*END STEP
"""
FEB = """<febio_spec version="4.0"><Module type="solid"/>
<Material><material id="1" name="soft" type="neo-Hookean"><E>2</E><v>0.3</v></material>
<material id="2" name="stiff" type="neo-Hookean"><E>20</E><v>0.4</v></material></Material>
<Mesh><Nodes>
<node id="1">0,0,0</node><node id="2">1,0,0</node><node id="3">0,1,0</node><node id="4">0,0,1</node>
<node id="5">1,1,1</node><node id="6">0,2,2</node></Nodes>
<Elements type="tet4" name="a"><elem id="1">1,2,3,4</elem></Elements>
<Elements type="tet4" name="b"><elem id="2">2,3,4,5</elem><elem id="3">3,5,4,6</elem></Elements>
<Surface name="side"><tri3 id="1">2,3,5</tri3></Surface><NodeSet name="foot">1,2,3</NodeSet>
<NodeSet name="wide">1,2,4,6</NodeSet></Mesh>
<MeshDomains><SolidDomain name="a" mat="soft"/><SolidDomain name="b" mat="stiff"/></MeshDomains>
<Boundary><bc node_set="@surface:foot" type="zero displacement">
<x_dof>1</x_dof><y_dof>0</y_dof><z_dof>1</z_dof></bc></Boundary>
<Loads><surface_load surface="side" type="pressure"><pressure lc="1">3</pressure></surface_load></Loads>
<LoadData><load_controller id="1" type="loadcurve"><points><pt>0,0</pt><pt>2,1</pt></points>
</load_controller></LoadData>
</febio_spec>
"""
CDB = """ET,1,285
NBLOCK,6,SOLID,4,4
(3i9,6e16.9)
        1        0        0
        2        0        0 1.000000000E+00
        3        0        0 0.000000000E+00 1.000000000E+00
        4        0        0 0.000000000E+00 0.000000000E+00 1.000000000E+00
N,R5.3,LOC,       -1,
EBLOCK,19,SOLID,1,1
(19i9)
        1        1        1        1        0        0        0        0        4        0        1        1        2        3        4
       -1
CMBLOCK,FOOT,NODE,2
(8i10)
         1        -3
MP,EX,1,2.5
MP,PRXY,1,0.3
D,1,UX,0
D,2,UX,0
D,3,UX,0
D,4,UY,0
SFE,1,1,PRES,,1
"""  # noqa: E501


def job_of(tmp_path: Path, name: str, text: str, *more: str) -> tuple[dict[str, Any], str]:
    (tmp_path / name).write_text(text)
    output = tmp_path / "part.yaml"
    command = ["new", "job", "--from", str(tmp_path / name), "--unit", "mm", "--stress-unit", "MPa", str(output), *more]
    assert main(command) == 0
    return yaml.safe_load(output.read_text()), output.read_text()


def test_an_input_file_of_abaqus_is_a_job(tmp_path: Path) -> None:
    job, text = job_of(tmp_path, "part.inp", INP)
    load(tmp_path / "part.yaml")
    assert job["mesh"] == {"file": "part.inp", "unit": "mm"}
    # mu = 2 C10, kappa = 2 / D1
    assert job["material"] == {"law": "isochoric-neo-hookean", "mu": "0.2 MPa", "kappa": "10 MPa"}
    # 1e-9 t/mm^3 is 1000 kg/m^3
    assert job["effects"] == [
        {"effect": "pressure", "region": "Side", "pressure": "0.01 MPa"},
        {"effect": "gravity", "acceleration": ["0 mm/s^2", "0 mm/s^2", "-9810 mm/s^2"], "density": "1000 kg/m^3"},
    ]
    assert job["supports"] == [
        {"region": "Foot", "displacement": ["0 mm", "0 mm", "0.5 mm"]},
        {"region": "Tip_vertices", "fix": ["x"]},
    ]
    assert job["regions"] == {"Tip_vertices": {"vertices": [["10 mm", "10 mm", "10 mm"]]}}
    assert "Not taken from the file: *CLOAD on 1 single nodes, which span no facet" in text
    head, material = INP.split("*MATERIAL")  # also if a part is in another file; a comma ends a keyword
    (tmp_path / "rubber.inc").write_text(f"*MATERIAL{material}*BOUNDARY,\nTip, 1\n*BOUNDARY,")
    included, text = job_of(tmp_path, "part.inp", f"{head}*INCLUDE, INPUT=rubber.inc\n*STATIC,\n*END STEP\n", "--force")
    assert included == job
    assert "Not taken from the file: *BOUNDARY, which has no line of data" in text


def test_orthotropic_materials_have_the_axes_of_their_sections(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    deck = (
        INP[: INP.index("*SOLID SECTION")]
        .replace("ELSET=Body", "ELSET=Low")
        .replace("2,2,3,4,5", "*ELEMENT, TYPE=C3D4, ELSET=High\n2,2,3,4,5")
    )
    deck += """*ORIENTATION, NAME=Turned
0, 2, 0, 0, 1, 5
3, 90.
*MATERIAL, NAME=Wood
*ELASTIC, TYPE=ORTHO
12, 3, 7, 2, 1.5, 6, 2.5, 1.8,
1.2
*PLASTIC
1., 0.
*SOLID SECTION, ELSET=Low, MATERIAL=WOOD
*SOLID SECTION, ELSET=High, MATERIAL=Wood, ORIENTATION=turned
*BOUNDARY
Foot, 1, 3
*DSLOAD
Side, P, 1
"""
    job, text = job_of(tmp_path, "part.inp", deck)
    assert "Linear elasticity Wood became an energy of Green's strains" in text
    assert "Not taken from the file: *PLASTIC of material Wood" in text
    load(tmp_path / "part.yaml")
    low, high = job["material"]["Low"], job["material"]["High"]
    assert high["energy"] == re.sub("_([abc])", r"_\1x2", low["energy"])
    directions = {name: tuple(entry["direction"]) for name, entry in job["fibres"].items()}
    assert directions == {
        "a": (1, 0, 0),
        "b": (0, 1, 0),
        "c": (0, 0, 1),
        # local axes y, z, x, then by 90 degrees about x
        "ax2": pytest.approx((0, 0, 1)),
        "bx2": pytest.approx((0, -1, 0)),
        "cx2": pytest.approx((1, 0, 0)),
    }
    (tmp_path / "part.inp").write_text(deck.replace("NAME=Turned", "NAME=Turned, SYSTEM=CYLINDRICAL"))
    assert (
        main(["new", "job", "--from", str(tmp_path / "part.inp"), *UNITS, "--force", str(tmp_path / "part.yaml")]) == 2
    )
    assert "the axes of High vary over the body; remove its ORIENTATION=" in capsys.readouterr().err


def test_a_model_of_febio_is_a_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job, text = job_of(tmp_path, "part.feb", FEB)
    assert "leave the body free to move along y" in capsys.readouterr().out
    assert {region: law["young"] for region, law in job["material"].items()} == {"a": "2 MPa", "b": "20 MPa"}
    assert job["supports"] == [{"region": "foot", "fix": ["x", "z"]}]
    assert job["effects"] == [{"effect": "pressure", "region": "side", "pressure": "1.5 MPa"}]
    assert "Not taken" not in text


@pytest.mark.parametrize("domain", [("", ' mat="1"'), ('<ShellDomain name="skin" mat="soft"/>', "")])
def test_shells_on_a_solid_of_febio_are_refused(
    tmp_path: Path, domain: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    shell = f'<Elements type="tri3" name="skin"{domain[1]}><elem id="9">2,3,5</elem></Elements><Surface'
    text = FEB.replace("<Surface", shell).replace("</MeshDomains>", f"{domain[0]}</MeshDomains>")
    (tmp_path / "part.feb").write_text(text)
    options = ["--unit", "mm", "--stress-unit", "MPa", str(tmp_path / "part.yaml")]
    assert main(["new", "job", "--from", str(tmp_path / "part.feb"), *options]) == 2
    assert "has shells, such as <Elements name='skin'>" in capsys.readouterr().err


def test_fibres_between_local_nodes_are_an_array_of_the_mesh(tmp_path: Path) -> None:
    fibres = '<fiber type="local"><local>1,3</local></fiber>'
    mixture = (
        'type="solid mixture"><solid type="neo-Hookean"><E>2</E><v>0.3</v></solid>'
        f'<solid type="fiber-exp-pow"><ksi>1</ksi><beta>3</beta>{fibres}</solid>'
    )
    model = FEB.replace('type="neo-Hookean"><E>2</E><v>0.3</v>', mixture)
    job, _ = job_of(tmp_path, "part.feb", model)
    assert job["fibres"] == {"f2": {"data": "local-1-3", "given_on": "reference"}}
    assert job["material"]["a"]["energy"].endswith("ksi2/beta2*max(I4_f2 - 1, 0)**3")
    array = read_source(spec(tmp_path / "part.feb"), tmp_path / "part.feb").data["local-1-3"]
    assert (array.place, array.values.tolist()) == ("cells", [[0, 1, 0], [-1, 0, 1], [0, -1, 1]])
    (tmp_path / "part.feb").write_text(model.replace("1,3", "1,5"))
    with pytest.raises(MeshError, match="fibres to node 5 of elements of 4 nodes"):
        read_source(spec(tmp_path / "part.feb"), tmp_path / "part.feb")


def test_a_model_of_febio_says_what_is_not_taken(tmp_path: Path) -> None:
    more = FEB.replace("<Material>", "<Control><analysis>DYNAMIC</analysis></Control><Material>")
    more = more.replace("<LoadData>", "<Discrete><discrete/></Discrete><LoadData>").replace('lc="1"', 'lc="7"')
    more = more.replace("</MeshDomains>", '<ShellDomain name="skin" mat="soft"/></MeshDomains>')
    more = more.replace(
        "</Boundary>",
        '<bc node_set="wide" type="prescribed displacement"><dof>y</dof><value lc="1">2</value></bc>'
        '<bc node_set="foot" type="prescribed displacement"><dof>y</dof><value>2</value><relative>1</relative></bc>'
        "</Boundary>",
    ).replace(
        "</Loads>",
        '<surface_load surface="side" type="traction"><scale lc="1">2</scale><traction>0,0,3</traction></surface_load>'
        '<surface_load surface="side" type="pressure"><pressure>3</pressure><linear>1</linear></surface_load>'
        '<surface_load surface="bent" type="pressure"><pressure>3</pressure><linear>1</linear></surface_load>'
        '<nodal_load type="nodal_force" node_set="foot"><value lc="1">0,4,0</value></nodal_load>'
        '<nodal_load type="nodal_load" node_set="foot"><dof>z</dof><scale>2</scale></nodal_load>'
        '<body_load type="body force"><force>0,0,9.81</force></body_load></Loads>',
    )
    more = more.replace("<E>2</E>", '<E lc="1">2</E><density>3</density>', 1)
    bent = '<Surface name="bent"><tri3 id="1">2,3,5</tri3><tri3 id="2">1,2,4</tri3></Surface>'
    more = more.replace('<NodeSet name="foot">', f'{bent}<NodeSet name="foot">', 1)
    job, text = job_of(tmp_path, "part.feb", more)
    assert job["material"]["a"]["young"] == "1 MPa"
    assert "# neo-Hookean: parameters with load curves have their values at the end" in text
    # the curve is 1/2 at the end
    assert job["supports"][1] == {"region": "wide", "displacement": [None, "1 mm", None]}
    assert job["supports"][2] == {"region": "wide_vertices", "displacement": [None, "1 mm", None]}
    # an edge joins the first one, which is on the facet that is held, to the other
    ends = [["0 mm", "0 mm", "1 mm"], ["0 mm", "2 mm", "2 mm"]]
    assert job["regions"] == {"wide_vertices": {"vertices": ends}}
    traction = {"effect": "traction", "region": "side", "traction": ["0 MPa", "0 MPa", "3 MPa"], "area_in": "current"}
    # 1 MPa s²/mm² is 1e12 kg/m³, and FEBio counts body forces with the opposite sign
    down = ["0 mm/s^2", "0 mm/s^2", "-9.81 mm/s^2"]
    densities = {"a": "3000000000000 kg/m^3", "b": "1000000000000 kg/m^3"}  # FEBio's own is 1
    gravity = {"effect": "gravity", "acceleration": down, "density": densities}
    nodal = {"effect": "traction", "region": "foot", "area_in": "reference"}
    # Three nodes with 2 each along y, and with 2 along z, on an area of 1/2.
    pushed = [nodal | {"traction": ["0 MPa", "12 MPa", "0 MPa"]}, nodal | {"traction": ["0 MPa", "0 MPa", "12 MPa"]}]
    # a pressure on the undeformed surface, against its normal (1, 1, -1)
    dead = traction | {"area_in": "reference"}
    dead["traction"] = [f"{sign}{3 / 3**0.5:.15g} MPa" for sign in ("-", "-", "")]
    effects = [{"effect": "pressure", "region": "side", "pressure": "3 MPa"}, traction, dead, gravity, *pushed]
    assert job["effects"] == effects
    for what in (
        "<ShellDomain name='skin'>",
        "<Discrete>",
        "a dead pressure on bent, which is not flat",
        "inertia (analysis DYNAMIC)",
        "<bc type='prescribed displacement'> on foot",
        "load curve 7 of the pressure on side: there is no load curve 7",
    ):
        assert f"Not taken from the file: {what}" in text


def test_steps_and_amplitudes_count_at_their_end(tmp_path: Path) -> None:
    later = "*STEP\n*STATIC\n0.1, 3.\n*DLOAD\nbody, GRAV, 4905., 0,0,-1\n*CLOAD\n5, 2, 1.\n*END STEP\n"
    text = INP.replace("*STEP\n", "*AMPLITUDE, NAME=Half\n0., 0., 2., 1.\n*STEP\n")
    text = text.replace("*DSLOAD\n", "*DSLOAD, amplitude=half\n").replace("Tip, 1\n", "5, 1\n5, 2\n4, pinned\n")
    text = text.replace("*DLOAD\n", "*ELSET, ELSET=Upper\n2\n*DLOAD\nUpper, P3, 2.\n") + later
    job, head = job_of(tmp_path, "part.inp", text)
    load(tmp_path / "part.yaml")
    # the gravity of the second step replaces the first one
    assert job["effects"] == [
        {"effect": "pressure", "region": "Side", "pressure": "0.005 MPa"},
        {"effect": "pressure", "region": "Upper-P3", "pressure": "2 MPa"},
        {"effect": "gravity", "acceleration": ["0 mm/s^2", "0 mm/s^2", "-4905 mm/s^2"], "density": "1000 kg/m^3"},
    ]
    supports = {entry["region"]: entry["fix"] for entry in job["supports"] if "fix" in entry}
    assert supports == {"held_xy_vertices": ["x", "y"], "held_z_vertices": ["z"]}
    assert job["regions"]["held_z_vertices"] == {"vertices": [["0 mm", "0 mm", "10 mm"]]}
    assert head.count("*CLOAD") == 1
    linear = text.replace("*HYPERELASTIC, NEO HOOKE\n0.1, 0.2", "*ELASTIC\n2., 0.3\n*PLASTIC\n1., 0.")
    linear = linear.replace("amplitude=half", "amplitude=half, TIME DELAY=0.5")
    job, head = job_of(
        tmp_path, "part.inp", linear.replace("NAME=Half", "NAME=Half, SHIFTX=0.25, SHIFTY=0.5"), "--force"
    )
    assert job["effects"][0]["pressure"] == "0.00625 MPa"  # 0.5 and (1 - 0.5 - 0.25)/2 times 0.01
    assert job["material"] == {"law": "neo-hookean", "young": "2 MPa", "poisson": 0.3}
    assert "Not taken from the file: *PLASTIC of material Rubber" in head


CUBE = """*NODE
1, 0
2, 2
3, 2, 2
4, 0, 2
5, 0, 0, 2
6, 2, 0, 2
7, 2, 2, 2
8, 0, 2, 2
9, 1, 1, 9
*ELEMENT, TYPE=C3D8, ELSET=ALL
1, 1,2,3,4,5,6,7,8
*ELEMENT, TYPE=S4, ELSET=SKIN
2, 1,2,3,4
*ELEMENT, TYPE=MASS, ELSET=POINT
3, 9
*NSET, NSET=TOP
5, 6, 7, 8
*ELSET, ELSET=BOTH
ALL, SKIN
*NSET, NSET=EVERY, GENERATE
1, 99
*MATERIAL, NAME=M
*ELASTIC
10., 0.3
*SOLID SECTION, ELSET=BOTH, MATERIAL=m
*BOUNDARY
1, 1, 3
2, 2, 3
3, 3
4, 3
*STEP
*CLOAD
TOP, 3, 2.
6, 1, 3.
7, 1, 1.
TOP, 2, 0.
2, 1, 2.
3, 1, 2.
9, 2, 1.
*DLOAD
1, P3, 0.5
*END STEP
"""


REMOTE = {
    "force": ["0 N", "1 N", "0 N"],
    "moment": ["0.002 N m", "0 N m", "0 N m"],
    "about": ["1 mm", "1 mm", "9 mm"],
}
"""load of node 9 of the cube on its upper face"""
OBLIQUE = "1,1,0,-1,1,0"  # x' = (1, 1, 0)/√2, y' = (-1, 1, 0)/√2, z' = z
SKEW = "1,1,1,-1,1,0"
NORMAL = {"fix": ["normal"], "normal": pytest.approx([0.5**0.5, 0.5**0.5, 0])}


@pytest.mark.parametrize(
    ("options", "axes", "lines", "supports"),
    [
        ("", OBLIQUE, "foot, 1", [NORMAL]),
        ("", OBLIQUE, "1, 1\n2, 1\n3, 1", [NORMAL]),
        ("", OBLIQUE, "foot, 1, 2", [{"fix": ["x", "y"]}]),
        ("", OBLIQUE, "foot, 1\nfoot, 3, 3, 0.5", [{"displacement": [None, None, 0.5]}, NORMAL]),
        ("", OBLIQUE, "foot, 1, 3, 0.5", [{"displacement": pytest.approx([0, 0.5**0.5, 0.5])}]),
        ("", "0,-1,0,0,0,1", "foot, 1, 1, 0.5", [{"displacement": [None, -0.5, None]}]),
        (", TYPE=C", "0,0,0,0,0,-2", "foot, 3, 3, 0.5", [{"displacement": [None, None, -0.5]}]),
        (", TYPE=C", "0,0,0,0,0,-2", "foot, 1, 2", [{"fix": ["x", "y"]}]),
        (", TYPE=C", "0,0,0,0,0,-2", "foot, 2", None),
        ("", OBLIQUE, "foot, 1, 1, 0.5", None),
        ("", SKEW, "foot, 1, 2", None),
        ("", OBLIQUE, "wide, 1", None),  # one of its nodes is not turned
    ],
)
def test_components_along_turned_axes(options: str, axes: str, lines: str, supports: list[Any] | None) -> None:
    nodes = {"Foot": frozenset((1, 2, 3)), "wide": frozenset((1, 2, 3, 4)), "held-x": frozenset((1, 2, 3))}
    deck = read_deck(f"*TRANSFORM, NSET=Foot{options}\n{axes}\n*STEP\n*BOUNDARY\n{lines}\n", nodes)
    found = [
        {
            key: [v.value if isinstance(v, Measure) else v for v in value]
            for key, value in entry.items()
            if key != "region"
        }
        for entry in deck.supports
    ]
    assert found == (supports or [])
    assert bool(deck.unused) == (supports is None)


def test_forces_along_turned_axes() -> None:
    nodes = {"Foot": frozenset((1, 2)), "loaded-1": frozenset((1,)), "loaded-2": frozenset((4,))}
    text = "*TRANSFORM, NSET=Foot{}\n{}\n*STEP\n*CLOAD\n1, 1, 2.\n4, 2, 3.\nfoot, 3, 1.\n"
    deck = read_deck(text.format("", "0,1,0,0,0,1"), nodes)
    assert {entry.region: dict(entry.forces) for entry in deck.forces} == {
        "Foot": {1: (1, 0, 0), 2: (1, 0, 0)},
        "loaded-1": {1: (0, 2, 0)},
        "loaded-2": {4: (0, 3, 0)},
    }
    deck = read_deck(text.format(", TYPE=C", "0,0,0,0,0,1"), nodes)
    assert {entry.region for entry in deck.forces} == {"Foot", "loaded-2"}
    assert deck.unused == ["*CLOAD on 1 single nodes, along the radial axes of *TRANSFORM"]


def test_conditions_on_single_nodes_and_elements_become_regions(tmp_path: Path) -> None:
    job, head = job_of(tmp_path, "part.inp", CUBE)
    # 4 forces of 2 on an area of 4; 8 on the face x = 2, whose moment (higher nodes have no more) is not lost
    assert job["effects"] == [
        {"effect": "pressure", "region": "pressed", "pressure": "0.5 MPa"},
        {"effect": "traction", "region": "TOP", "traction": ["0 MPa", "0 MPa", "2 MPa"], "area_in": "reference"},
        {"effect": "traction", "region": "loaded-1", "traction": ["2 MPa", "0 MPa", "0 MPa"], "area_in": "reference"},
    ]
    assert "*CLOAD on 4 single nodes became a uniform traction on 'loaded-1' with the same resultant; their mom" in head
    assert "on no facet of the region" not in head
    _, strayed = job_of(tmp_path, "part.inp", CUBE.replace("5, 6, 7, 8", "5, 6, 7, 8, 2"), "--force")
    assert "; 1 of its nodes are on no facet of the region" in strayed
    assert "Not taken from the file: *CLOAD on 1 single nodes, which span no facet" in head
    assert "Not taken from the file: elements of type MASS" in head
    assert job["supports"] == [
        {"region": "held_x_vertices", "fix": ["x"]},
        {"region": "held_y_vertices", "fix": ["y"]},
        {"region": "held-z", "fix": ["z"]},
    ]
    assert job["regions"] == {
        "held_x_vertices": {"vertices": [["0 mm", "0 mm", "0 mm"]]},
        "held_y_vertices": {"vertices": [["0 mm", "0 mm", "0 mm"], ["2 mm", "0 mm", "0 mm"]]},
    }
    load(tmp_path / "part.yaml")


def test_couplings_become_remote_loads(tmp_path: Path) -> None:
    text = CUBE.replace(
        "*STEP\n", "*SURFACE, NAME=UP\n1, S2\n*COUPLING, REF NODE=9, SURFACE=UP\n*KINEMATIC\n1, 3\n*STEP\n"
    )
    text = text.replace("9, 2, 1.\n", "9, 2, 1.\n9, 4, 2.\n").replace("TOP, 3, 2.\n", "")
    job, head = job_of(tmp_path, "part.inp", text)
    assert job["supports"][-1] == {"region": "UP", "remote": REMOTE}
    assert "COUPLING" not in head
    spread = text.replace("*KINEMATIC\n1, 3\n", "*DISTRIBUTING\n1, 3\n").replace("9, 4, 2.\n", "")
    job, head = job_of(tmp_path, "part.inp", spread, "--force")
    assert {
        "effect": "traction",
        "region": "UP",
        "traction": ["0 MPa", "0.25 MPa", "0 MPa"],
        "area_in": "reference",
    } in (job["effects"])
    assert "*CLOAD on node 9 with a distributing *COUPLING became a uniform traction on 'UP'" in head
    turned = text.replace("SURFACE=UP\n*K", "SURFACE=UP, ORIENTATION=O\n*K")
    _, head = job_of(tmp_path, "part.inp", turned, "--force")
    assert "Not taken from the file: *COUPLING of UP" in head


def test_rigid_bodies_of_calculix_become_remote_loads(tmp_path: Path) -> None:
    rigid = "*NODE\n10, 1., 1., 9.\n*RIGID BODY, NSET=TOP, REF NODE=9, ROT NODE=10\n*EQUATION\n1\n1, 1, 1.\n*STEP\n"
    text = CUBE.replace("*STEP\n", rigid).replace("9, 2, 1.\n", "9, 2, 1.\n10, 1, 2.\n").replace("TOP, 3, 2.\n", "")
    job, head = job_of(tmp_path, "part.inp", text)
    assert job["supports"][-1] == {"region": "TOP", "remote": REMOTE}
    assert "RIGID" not in head
    assert "Not taken from the file: *EQUATION, which a job cannot say: fix a plane of symmetry, or give a face" in head
    held = text.replace("*BOUNDARY\n", "*BOUNDARY\n10, 1, 3\n")
    job, head = job_of(tmp_path, "part.inp", held, "--force")
    assert all("remote" not in support for support in job["supports"])
    assert "Not taken from the file: *RIGID BODY of TOP and its load, since its node 9 is held" in head
    _, head = job_of(tmp_path, "part.inp", text.replace("NSET=TOP,", "ELSET=ALL,"), "--force")
    assert "Not taken from the file: *RIGID BODY that is not one set of nodes" in head


def test_an_archive_of_ansys_is_a_job(tmp_path: Path) -> None:
    job, text = job_of(tmp_path, "part.cdb", CDB)
    assert job["material"] == {"law": "neo-hookean", "young": "2.5 MPa", "poisson": 0.3}
    assert job["supports"] == [{"region": "FOOT", "fix": ["x"]}, {"region": "held_y_vertices", "fix": ["y"]}]
    assert job["regions"]["held_y_vertices"] == {"vertices": [["0 mm", "0 mm", "1 mm"]]}
    assert job["effects"] == [{"effect": "pressure", "region": "FOOT", "pressure": "1 MPa"}]
    assert "what follows the end of the file, which has no FINISH" in text


UNITS = ["--unit", "mm", "--stress-unit", "MPa"]


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (("", ""), ["--unit", "mm"], "have no units"),
        (("NEO HOOKE", "MARLOW"), ["--unit", "mm", "--stress-unit", "MPa"], "MARLOW"),
        (
            ("*HYPERELASTIC, NEO HOOKE\n0.1, 0.2", "*CONDUCTIVITY\n1"),
            UNITS,
            "neither *HYPERELASTIC nor *ELASTIC in material",
        ),
        (("GRAV, 9810.", "GRAV, fast"), ["--unit", "mm", "--stress-unit", "MPa"], "'fast' is not a number"),
    ],
)
def test_faults_leave_no_job(
    tmp_path: Path, change: tuple[str, str], options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "part.inp").write_text(INP.replace(*change))
    assert main(["new", "job", "--from", str(tmp_path / "part.inp"), *options, str(tmp_path / "part.yaml")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "part.yaml").exists()
