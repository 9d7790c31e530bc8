"""Cards that are written, options and laws without a counterpart, and the command."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.card_cases import law_of, material

from hpcinv.__main__ import main
from hpcinv.formats.cards import abaqus, ansys, febio
from hpcinv.formats.cards.card import CardError, UnknownLaw, Values
from hpcinv.physics.materials import MaterialLaw, laws


def changed(law: type[MaterialLaw], volumetric: str | None) -> MaterialLaw:
    values = {**law.example, "volumetric": volumetric} if volumetric else dict(law.example)
    return law.model_validate(values)


WRITTEN = [
    *((abaqus, name, None) for name in ("isochoric-neo-hookean", "mooney-rivlin", "yeoh", "ogden")),
    (abaqus, "arruda-boyce", "simo-taylor"),
    *((ansys, name, None) for name in ("isochoric-neo-hookean", "mooney-rivlin", "yeoh", "ogden")),
    *((ansys, name, "simo-taylor") for name in ("arruda-boyce", "gent")),
    *((febio, name, None) for name in ("neo-hookean", "st-venant-kirchhoff", "isochoric-neo-hookean", "ogden", "yeoh")),
    *((febio, name, "logarithmic") for name in ("mooney-rivlin", "gent", "veronda-westmann", "arruda-boyce")),
]


@pytest.mark.parametrize(("program", "name", "volumetric"), WRITTEN)
def test_a_written_card_gives_the_law_back(program: ModuleType, name: str, volumetric: str | None) -> None:
    law = changed(laws()[name], volumetric)
    text = program.write(Values(law, program.PROGRAM, 1e3), "tissue & wall")
    back = law_of(program.read(text).law, "kPa")
    assert type(back) is type(law)
    assert getattr(back, "volumetric", None) == getattr(law, "volumetric", None)
    for key, (value, _) in law.quantities().items():
        assert np.ravel(back.quantities()[key][0]) == pytest.approx(np.ravel(value), rel=1e-13), key


@pytest.mark.parametrize(
    ("program", "text", "message"),
    [
        (abaqus, "*HYPERELASTIC, VAN DER WAALS\n1,2,3", "VAN DER WAALS has no counterpart"),
        (abaqus, "*HYPERFOAM\n1,2,3", r"\*HYPERFOAM has no counterpart"),
        (abaqus, "*ELASTIC\n210000, 0.3", "st-venant-kirchhoff"),
        (abaqus, "*ELASTIC, TYPE=LAMINA\n1,1,0,1,1,1", "TYPE=LAMINA has no counterpart"),
        (abaqus, "*ELASTIC, TYPE=ORTHO\n1,2,3", "has 3 constants, not 9"),
        (abaqus, "*ELASTIC, TYPE=ORTHO\n1,2,1,2,2,1,1,1\n1", "is unstable"),
        (abaqus, f"*ELASTIC, TYPE=ANISO{4 * chr(10)}{', '.join(21 * ['1'])}", "coupled shears"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,0\n*VISCOELASTIC\n0.1,0.1,1", r"\*VISCOELASTIC has no counterpart"),
        (abaqus, "*HYPERELASTIC, YEOH, TEST DATA INPUT", "hpcinv fit"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,0,20\n2,0,40", "temperature"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,x", "'x' is not a number"),
        (abaqus, "*HYPERELASTIC, OGDEN, N=9\n1,2", "N must be from 1 to 6"),
        (abaqus, "*HYPERELASTIC, YEOH\n0.3,0,0,0,1", "D1 is 0"),
        (abaqus, "*HYPERELASTIC, OGDEN, N=2\n1,2,3,4,0.1,0.2", "D2 and higher"),
        (abaqus, "*MATERIAL, NAME=a\n*HYPERELASTIC, NEO HOOKE\n1,0\n*MATERIAL, NAME=b", "several materials: a, b"),
        (abaqus, "*NODE\n1, 0, 0, 0", "has no material"),
        (abaqus, "*ANISOTROPIC HYPERELASTIC, FUNG-ORTHOTROPIC\n1", "FUNG-ORTHOTROPIC has no counterpart"),
        (ansys, "TB,HYPER,1,,2,FOAM\nTBDATA,1,1,2", "FOAM has no counterpart"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1,1\nTB,PRONY,1\nTBDATA,1,1", "TB,PRONY has no counterpart"),
        (ansys, "TB,HYPER,1,,4,MOONEY\nTBDATA,1,1", "2, 3, 5 or 9 parameters, not 4"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1,2*X", "is not a number"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1e9,1", "from 1 to 100"),
        (febio, material("Shenoy", mu=1), "law Shenoy"),
        (
            febio,
            '<material id="1" type="solid mixture"><solid type="elastic damage"><E>1</E></solid></material>',
            "solid mixture with elastic damage has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="solid mixture">'
            + 2 * '<solid type="Gent"><G>1</G><Jm>9</Jm><k>9</k></solid>'
            + "</material>",
            r"several uncoupled solids \(Gent\) has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="uncoupled solid mixture"><k>9</k><solid type="neo-Hookean"/></material>',
            "uncoupled solid mixture with neo-Hookean has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="uncoupled solid mixture"><solid type="Gent"><G>1</G><Jm>9</Jm></solid></material>',
            "uncoupled solid mixture without k has no counterpart",
        ),
        (febio, material("Mooney-Rivlin", c1=1, c2=0), "k is not a number"),
        (febio, material("Gent", G=1, Jm=0, k="nan"), "k is not a number"),
        (febio, '<material id="1" type="Gent"><G lc="2">1</G></material>', "load curve 2"),
        (febio, "<material", "is not XML"),
        (febio, '<!DOCTYPE a [<!ENTITY b "c">]><material/>', "entities"),
    ],
)
def test_card_options_without_a_counterpart_are_refused_by_name(program: ModuleType, text: str, message: str) -> None:
    with pytest.raises(CardError, match=message):
        program.read(text)


@pytest.mark.parametrize(
    ("program", "data", "message"),
    [
        (abaqus, {"law": "neo-hookean", "young": 1, "poisson": 0.3}, "take isochoric-neo-hookean"),
        (abaqus, {"law": "gent", "mu": 1, "jm": 30, "kappa": 9}, "'gent' has no counterpart in Abaqus"),
        (abaqus, {"law": "yeoh", "c1": 1, "c2": 0, "c3": 0, "kappa": 9, "volumetric": "liu"}, "'quadratic', not 'liu'"),
        (abaqus, laws()["holzapfel-gasser-ogden"].example, "invariants of C"),
        (ansys, laws()["guccione"].example, "'guccione' has no counterpart in Ansys"),
        (febio, {"law": "gent", "mu": 1, "jm": 30, "kappa": "incompressible"}, "no exactly incompressible law"),
        (febio, {"law": "gent", "mu": 1, "jm": 30, "kappa": 9, "volumetric": "liu"}, "no volumetric energy 'liu'"),
        (
            febio,
            {
                "law": "formula",
                "energy": "m*(I1_bar - 3) + m*abs(I1_bar - 3)**2",
                "parameters": {"m": "1 Pa"},
                "kappa": 9,
            },
            "its energy has 'abs'",
        ),
        (ansys, {"law": "gent", "mu": "1 kPa*(1 + X/(1 m))", "jm": 30, "kappa": 9}, "vary over the body"),
    ],
)
def test_laws_without_a_card_are_refused_by_name(program: ModuleType, data: dict[str, Any], message: str) -> None:
    law = laws()[data["law"]].model_validate(data)
    with pytest.raises(UnknownLaw, match=message):
        program.write(Values(law, program.PROGRAM, 1.0), "tissue")


def test_the_command_prints_sections_of_a_job_and_writes_cards(tmp_path: Path, capsys: Any) -> None:
    card = "*HYPERELASTIC, MOONEY-RIVLIN\\n0.1, 0.15, 0.001"
    assert main(["laws", "--from", "abaqus", card]) == 2
    assert "--stress-unit MPa" in capsys.readouterr().err
    assert main(["laws", "--from", "abaqus", card, "--stress-unit", "mm"]) == 2
    assert "not a stress" in capsys.readouterr().err
    job = tmp_path / "wall.yaml"
    assert main(["laws", "--from", "abaqus", card, "--stress-unit", "MPa", "--output", str(job)]) == 0
    section = yaml.safe_load(job.read_text())["material"]
    assert section == {"law": "mooney-rivlin", "c1": "0.1 MPa", "c2": "0.15 MPa", "d1": "1000 MPa"}
    assert main(["laws", "--to", "ansys", str(job)]) == 2
    assert "--stress-unit" in capsys.readouterr().err
    assert main(["laws", "--to", "ansys", str(job), "--stress-unit", "kPa"]) == 0
    assert capsys.readouterr().out == "! wall\nTB,HYPER,1,,2,MOONEY\nTBDATA,1,100,150,1e-06\n"
    assert main(["laws", "--from", "abaqus", str(tmp_path / "none.inp"), "--stress-unit", "MPa"]) == 2
    assert "none.inp: cannot be read" in capsys.readouterr().err
    assert main(["laws", "--from", "abaqus", "*HYPERELASTIC, NEO HOOKE\n-1, 0", "--stress-unit", "MPa"]) == 2
    assert "*HYPERELASTIC, NEO HOOKE: mu: must be above 0" in capsys.readouterr().err


def test_files_that_state_their_units_need_no_option(tmp_path: Path, capsys: Any) -> None:
    model = tmp_path / "model.feb"
    first, second = material("neo-Hookean", E=2, v=0.3), material("neo-Hookean", E=3, v=0.3)
    materials = first.replace('id="1"', 'id="1" name="fat"') + second.replace('id="1"', 'id="2" name="gland"')
    model.write_text(
        '<?xml version="1.0"?><febio_spec version="4.0"><Module type="solid"><units>mm-N-s</units></Module>'
        f"<Material>{materials}</Material></febio_spec>"
    )
    assert main(["laws", "--from", "febio", str(model)]) == 2
    assert "several materials: fat, gland; choose one with --name" in capsys.readouterr().err
    assert main(["laws", "--from", "febio", str(model), "--name", "gland"]) == 0
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed == {"material": {"law": "neo-hookean", "young": "3 N/mm^2", "poisson": 0.3}}
    assert main(["laws", "--from", "febio", str(model), "--name", "fat", "--stress-unit", "kPa"]) == 2
    assert "states N/mm^2 as its unit of stress" in capsys.readouterr().err
    assert main(["laws", "--from", "ansys", "/UNITS,SI\\nTB,HYPER,1,,,NEO\\nTBDATA,1,5e5,1e-9"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["material"]["mu"] == "500000 Pa"
