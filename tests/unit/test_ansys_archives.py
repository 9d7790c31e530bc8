"""Archives of Ansys as other programs write them: formats of blocks, abbreviated commands, properties, contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hpcinv.base.reading.cdb_files import read_cdb
from hpcinv.formats.cards import ansys
from hpcinv.formats.cards.ansys_deck import read_deck
from hpcinv.formats.cards.card import CardError
from hpcinv.formats.cards.deck import Measure

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]


def archive(form: str = "(3i9,6e16.9)", more: str = "") -> str:
    first = 7 if form.startswith("(1i7") else 9
    nodes = "".join(f"{i:{first}d}{0:9d}{0:9d}{x:16.9f}{y:16.9f}{z:16.9f}\n" for i, (x, y, z) in enumerate(POINTS, 1))
    element = "".join(f"{value:9d}" for value in (1, 1, 1, 1, 0, 0, 0, 0, 4, 0, 1, 1, 2, 3, 4))
    blocks = (
        f"NBLOCK,6,SOLID,4,4\n{form}\n{nodes}N,R5.3,LOC,       -1,\nEBLOCK,19,SOLID,1,1\n(19i9)\n{element}\n       -1\n"
    )
    return f"/PREP7\net,1,285\n{blocks}{more}FINISH\n"


def read(tmp_path: Path, text: str) -> tuple[list[str], Any]:
    (tmp_path / "a.cdb").write_text(text)
    head, arrays = read_cdb(tmp_path / "a.cdb")
    return head["ignored"], arrays


@pytest.mark.parametrize("form", ["(3i9,6e16.9)", "(1i7,2i9,6e16.9)", "(1i7, 2i9, 6e16.9)"])
def test_integers_of_several_widths(form: str, tmp_path: Path) -> None:
    _, arrays = read(tmp_path, archive(form))
    assert arrays["points"].tolist() == [list(map(float, point)) for point in POINTS]


def test_types_of_elements_in_a_block(tmp_path: Path) -> None:
    block = "ETBLOCK,        1,        1\n(2i9,19a9)\n        1      285        0        0\n       -1\n"
    ignored, arrays = read(tmp_path, archive().replace("et,1,285\n", block))
    assert (ignored, len(arrays["cells"])) == ([], 1)


def test_contacts_and_components_of_the_geometry_are_left_out_and_named(tmp_path: Path) -> None:
    more = (
        "*set,cid,3\net,cid,174\net,tid,170\neblock,10,,,2\n(15i9)\n      901        3        3        3        0\n-1\n"
    )
    more += "CMBLOCK,EDGES,KP  ,       2  ! of keypoints\n(8i10)\n         1        -2\n"
    ignored, arrays = read(tmp_path, archive(more=more))
    assert ignored == ["1 elements that are not solids", "ET,tid", "component EDGES of keypoints"]
    assert len(arrays["cells"]) == 1
    assert not [name for name in arrays if "EDGES" in name]
    assert any("contacts" in text for text in read_deck(archive(more=more), {}).unused)


@pytest.mark.parametrize(
    "lines",
    [
        "MP,EX,1,10.\nMP,NUXY,1,0.3\n",
        "MPTEMP,R5.0, 1, 1, 0.,\nMPDATA,R5.0, 1,EX  ,     1, 1,  10.0    ,\nMPDATA,R5.0, 1,PRXY, 1, 1, 0.3,\n",
        "MPTEMP,1,0\nMPDATA,EX,1,,10.\nMPDATA,PRXY,1,1,0.3\n",
        "*SET,mid,1\nMPDAT,EX,mid,,10.\nMP,PRXY,mid,0.3\n",
    ],
)
def test_linear_properties_are_read_as_archives_have_them(lines: str) -> None:
    deck = read_deck(archive(more=lines), {})
    assert deck.linear["1"].material["poisson"] == 0.3
    assert deck.linear["1"].material["young"].value == 10.0
    assert not deck.unused


def test_unread_commands_of_an_archive_are_listed() -> None:
    more = "MPDATA,EX,1,,10.,20.\nMP,EY,1,3.\nCERIG,1,2\nSFE,1,1,CONV,,1\n/GOPR\n*IF,a,EQ,1,THEN\nb=3\n"
    unused = ", ".join(read_deck(archive(more=more), {}).unused)
    for name in ("EX of material 1 at further temperatures", "MP,EY of material 1", "CERIG", "SFE,CONV"):
        assert name in unused
    assert "GOPR" not in unused


def test_names_of_four_letters_are_read() -> None:
    card = ansys.read("TB,HYPER,1,,2,MOON\nTBDAT,1,0.1,0.2,0.3\n")
    whole = ansys.read("TB,HYPER,1,,2,MOONEY\nTBDATA,1,0.1,0.2,0.3\n")
    assert card.law == whole.law


FOOT = "CMBLOCK,FOOT,NODE,2\n(8i10)\n         1        -3\n"
TIP = "CMBLOCK,TIP,NODE,1\n(8i10)\n         4\n"


def loads(commands: str) -> Any:
    return read_deck(archive(more=f"{FOOT}{TIP}MP,EX,1,1.\nMP,PRXY,1,0.3\nMP,DENS,1,2.\n{commands}"), {})


@pytest.mark.parametrize(
    "commands",
    [
        "D,1,UX,0\nD,2,UX,0\nD,3,UX,0\n",
        "D,FOOT,UX,0\n",
        "d,foot,ux\n",
        "D,1,UX,0,,3,1\n",
        "CMSEL,S,FOOT\nD,ALL,UX,0\nALLSEL,ALL\n",
        "D,1,UX,7,,3\nD,FOOT,UX,0\n",  # the later one
        "SOLVE\nNLGEOM,ON\nD,FOOT,UX,0.,0.,,,,,,,\n",
    ],
)
def test_supports_of_a_component_are_read_however_they_are_written(commands: str) -> None:
    deck = loads(commands)
    assert deck.supports == [{"region": "FOOT", "fix": ["x"]}]
    assert not deck.unused
    assert not deck.is_linear


def test_a_support_of_two_components_is_one_of_each_and_of_other_nodes_their_own() -> None:
    assert loads("D,FOOT,UZ,0\nD,4,UZ,0\n").supports == [
        {"region": "FOOT", "fix": ["z"]},
        {"region": "TIP", "fix": ["z"]},
    ]
    assert loads("D,1,UZ,0\nD,2,UZ,0\n").supports == [{"region": "held-z", "fix": ["z"]}]


@pytest.mark.parametrize(
    ("command", "place"),
    [("SFE,1,1,PRES,,5.\n", 0), ("SFE,1,1,PRES,1,R5.0\n 5. 5. 5. 5.\n", 0), ("SFE,1,4,PRES,0,5.,5.,5.\n", 3)],
)
def test_pressures_are_read_by_face(command: str, place: int, tmp_path: Path) -> None:
    deck = loads(command)
    name = "FOOT" if place == 0 else "pressed"
    assert deck.effects == [{"effect": "pressure", "region": name, "pressure": Measure(5.0, stress=1)}]
    assert not deck.unused
    _, arrays = read(tmp_path, archive(more=f"{FOOT}{command}"))
    assert arrays[f"faces:{name}"].tolist() == [[0, place]]


def test_acceleration_of_the_frame_pulls_the_body_the_other_way() -> None:
    [gravity] = loads("ACEL,0,0,9.81\n").effects
    assert [component.value for component in gravity["acceleration"]] == [0, 0, -9.81]
    assert gravity["density"].value == 2.0


def test_forces_on_a_component_are_one_load() -> None:
    [load] = loads("F,FOOT,FX,2.\nF,FOOT,FZ,1.\n").forces
    assert (load.region, load.forces) == ("FOOT", dict.fromkeys((1, 2, 3), (2.0, 0.0, 1.0)))


@pytest.mark.parametrize(
    ("commands", "unread"),
    [
        ("D,1,ROTX,0\n", "D,ROTX (1)"),
        ("D,HEEL,UX,0\n", "D of HEEL (1)"),
        ("NSEL,S,LOC,Z,0\nD,ALL,UX,0\n", "D of ALL (1)"),
        ("F,1,MX,1.\n", "F,MX (1)"),
        ("SFE,1,1,PRES,2,5.\n", "SFE,PRES of 1 (1)"),
        ("SFE,1,1,PRES,,5.,6.,7.\n", "SFE,PRES that varies over a face (1)"),
        ("SFE,1,5,PRES,,5.\n", "SFE,PRES on 1 faces that are not of solid elements"),
        ("SFE,9,1,PRES,,5.\n", "SFE,PRES on 1 faces that are not of solid elements"),
        ("DDELE,1,UX\n", "DDELE"),
        ("OMEGA,1\n", "OMEGA"),
        ("CE,NEXT,1.,1,UX,1\n", "CE (1)"),
        ("CE,NEXT,0,1,UX,1,2,UX,-1\n", "CE (1)"),
        ("CE,7,0,1,UX,1\n", "CE (1)"),
        ("CE,NEXT,0,1,UX,1\n", "CE of 1 nodes that are not a component in a plane"),
    ],
)
def test_what_is_not_read_of_supports_and_loads_is_listed(commands: str, unread: str) -> None:
    assert loads(commands).unused == [unread]


def test_many_different_values_are_listed() -> None:
    nodes = "".join(f"{i:9d}{0:9d}{0:9d}{float(i):16.9f}\n" for i in range(5, 40))
    block = f"NBLOCK,6,SOLID,39,35\n(3i9,6e16.9)\n{nodes}N,R5.3,LOC,       -1,\n"
    given = "".join(f"D,{i},UX,{i}.\nF,{i},FX,{i}.\nF,{i},FY,1.\n" for i in range(5, 40))
    unused = " ".join(loads(f"{block}{given}").unused)
    assert "D of more than 20 different displacements" in unused
    assert "F of more than 20 different directions" in unused


@pytest.mark.parametrize(
    "command", ["D,1,UX,fast", "F,1,FX,%table%", "ACEL,0,0,1x", "SFE,1,1,PRES,,much", "D,1,UX,,,9999999"]
)
def test_damaged_numbers_of_conditions_are_an_error(command: str, tmp_path: Path) -> None:
    with pytest.raises(CardError, match=command.partition(",")[0]):
        loads(f"{command}\n")
    read(tmp_path, archive(more=f"{command}\n"))  # the mesh is read


def test_a_file_that_ends_within_its_loads_says_so() -> None:
    text = archive(more="D,1,UX,0\n")
    assert not read_deck(text, {}).unused
    assert "no FINISH" in read_deck(text.removesuffix("FINISH\n"), {}).unused[-1]


def test_a_solution_without_large_displacements_is_linear() -> None:
    assert loads("/SOLU\nSOLVE\n").is_linear
    assert not loads("/SOLU\nNLGEOM,ON\nSOLVE\n").is_linear
    assert not loads("").is_linear  # a model alone


@pytest.mark.parametrize("third", ["CE,NEXT,,3,UX,-1.5,3,UY,-2.\n", "D,3,UX,0\nD,3,UY,0\n"])
def test_equations_of_the_nodes_of_a_plane_are_a_sliding_support(third: str) -> None:
    deck = loads(f"CE,NEXT,0,1,UX,3.,1,UY,4.\nCE,NEXT,0,2,UY,0.8,2,UX,0.6\n{third}")
    assert deck.supports[-1] == {"region": "FOOT", "fix": ["normal"], "normal": [0.6, 0.8, 0.0]}
    assert not deck.unused


def test_equations_of_a_curved_face_are_listed() -> None:
    nodes = "".join(f"{i:9d}{0:9d}{0:9d}{float(i):16.9f}\n" for i in range(5, 40))
    block = f"NBLOCK,6,SOLID,39,35\n(3i9,6e16.9)\n{nodes}N,R5.3,LOC,       -1,\n"
    deck = loads(block + "".join(f"CE,NEXT,0,{i},UX,1,{i},UY,{i}\n" for i in range(5, 40)))
    assert deck.unused == ["CE of 35 nodes that are not a component in a plane"]


def test_what_acts_along_rotated_axes_of_nodes_is_listed() -> None:
    """Node 1 is clamped, which any axes say; THXY of nodes 1 to 3 is 30 degrees."""
    nodes = "".join(f"{i:9d}{0:9d}{0:9d}{0.0:16.9f}{0.0:16.9f}{0.0:16.9f}{30.0:16.9f}\n" for i in (11, 12, 13))
    block = f"NBLOCK,6,SOLID,13,3\n(3i9,6e16.9)\n{nodes}N,R5.3,LOC,       -1,\n"
    deck = loads(f"{block}D,11,ALL,0\nD,12,UX,0\nF,13,FY,5\nD,FOOT,UX,0\n")
    assert deck.unused == ["D, F and CE on nodes whose axes are rotated (NBLOCK) (2)"]
    assert not deck.forces
    assert {"region": "FOOT", "fix": ["x"]} in deck.supports
