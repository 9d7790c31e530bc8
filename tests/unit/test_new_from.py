"""``hpcinv new job --from``: materials, supports and loads of other programs' files as a job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.job.job import load

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
<node id="5">1,1,1</node></Nodes>
<Elements type="tet4" name="a"><elem id="1">1,2,3,4</elem></Elements>
<Elements type="tet4" name="b"><elem id="2">2,3,4,5</elem></Elements>
<Surface name="side"><tri3 id="1">2,3,5</tri3></Surface><NodeSet name="foot">1,2,3</NodeSet></Mesh>
<MeshDomains><SolidDomain name="a" mat="soft"/><SolidDomain name="b" mat="stiff"/></MeshDomains>
<Boundary><bc node_set="foot" type="zero displacement"><x_dof>1</x_dof><y_dof>0</y_dof><z_dof>1</z_dof></bc></Boundary>
<Loads><surface_load surface="side" type="pressure"><pressure lc="1">3</pressure></surface_load></Loads>
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
    assert job["supports"] == [{"region": "Foot", "displacement": ["0 mm", "0 mm", "0.5 mm"]}]
    assert "Not taken from the file: *CLOAD" in text
    assert "support on 'Tip', which spans no facet" in text


def test_a_model_of_febio_is_a_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job, text = job_of(tmp_path, "part.feb", FEB)
    assert "leave the body free to move along y" in capsys.readouterr().out
    assert {region: law["young"] for region, law in job["material"].items()} == {"a": "2 MPa", "b": "20 MPa"}
    assert job["supports"] == [{"region": "foot", "fix": ["x", "z"]}]
    assert job["effects"] == [{"effect": "pressure", "region": "side", "pressure": "3 MPa"}]
    assert "load curve 1 of the pressure on side" in text


def test_an_archive_of_ansys_is_a_job(tmp_path: Path) -> None:
    job, text = job_of(tmp_path, "part.cdb", CDB)
    assert job["material"] == {"law": "neo-hookean", "young": "2.5 MPa", "poisson": 0.3}
    assert job["supports"] == [{"region": "FOOT", "fix": ["x"]}]
    assert "D,UY of 1 nodes that are not a component" in text
    assert "Not taken from the file: SFE" in text


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (("", ""), ["--unit", "mm"], "have no units"),
        (("NEO HOOKE", "MARLOW"), ["--unit", "mm", "--stress-unit", "MPa"], "MARLOW"),
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
