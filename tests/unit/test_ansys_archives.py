"""Archives of Ansys as other programs write them: formats of blocks, abbreviated commands, properties, contacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hpcinv.formats.cards import ansys
from hpcinv.formats.cards.ansys_deck import read_deck
from hpcinv.formats.cdb import read_cdb

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
    more = "MPDATA,EX,1,,10.,20.\nMP,EY,1,3.\nCERIG,1,2\nSFE,1,1,PRES,,1\n/GOPR\n*IF,a,EQ,1,THEN\nb=3\n"
    unused = ", ".join(read_deck(archive(more=more), {}).unused)
    for name in ("EX of material 1 at further temperatures", "MP,EY of material 1", "CERIG", "SFE"):
        assert name in unused
    assert "GOPR" not in unused


def test_names_of_four_letters_are_read() -> None:
    card = ansys.read("TB,HYPER,1,,2,MOON\nTBDAT,1,0.1,0.2,0.3\n")
    whole = ansys.read("TB,HYPER,1,,2,MOONEY\nTBDATA,1,0.1,0.2,0.3\n")
    assert card.law == whole.law
