"""Keywords, options and lines of data of input files of Abaqus and CalculiX: none passes without a word."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.deck_keywords import names

from hpcinv.base.reading.abaqus_keywords import keywords_of_text
from hpcinv.base.reading.abaqus_options import USED, WITHOUT_EFFECT, remedy
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.inp_files import read_inp, read_inp_shells
from hpcinv.errors import HpcinvError
from hpcinv.formats.cards.abaqus_deck import read_deck

TET = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, , 1,
4, 0, 0, 1
*ELEMENT, TYPE=C3D4, ELSET=block
1, 1, 2, 3, 4
"""


def arrays_of(tmp_path: Path, text: str) -> tuple[list[str], dict[str, np.ndarray]]:
    (tmp_path / "a.inp").write_text(text)
    head, arrays = read_inp(tmp_path / "a.inp")
    return head["ignored"], arrays


def said_of(path: Path, text: str) -> str:
    """What the reader of the mesh and the reader of the job list or refuse."""
    path.write_text(f"{TET}{text}")
    try:
        mesh = ", ".join(read_inp(path)[0]["ignored"])
    except Fault as fault:
        mesh = fault.text
    try:
        return f"{mesh}; {', '.join(read_deck(text, {}).unused)}"
    except HpcinvError as error:
        return f"{mesh}; {error}"


def test_no_keyword_and_no_option_passes_without_a_word(tmp_path: Path) -> None:
    silent = []
    for keyword, options in names():
        known = {*USED.get(keyword, ()), *WITHOUT_EFFECT.get(keyword, ())}
        if keyword not in USED | WITHOUT_EFFECT and not keyword.endswith((" PRINT", " FILE", " OUTPUT")):
            said = said_of(tmp_path / "a.inp", f"*{keyword}\n").split("; ")
            silent += [f"*{keyword}" for entry in said if keyword not in entry and "is not read" not in said[0]]
        for option in options if keyword in USED | WITHOUT_EFFECT else ():
            material = ", MATERIAL=rubber" if keyword.endswith("SECTION") else ""
            text = f"*{keyword}{material}, {option}=1\n1, 1, 1\n"
            is_said = option in known or remedy(keyword, [option]) or option in said_of(tmp_path / "a.inp", text)
            if not is_said:
                silent.append(f"*{keyword}, {option}")
    assert not silent


def test_options_counted_as_used_occur_in_the_readers() -> None:
    places = [*(ROOT / "hpcinv/formats/cards").glob("abaqus*.py"), *(ROOT / "hpcinv/base/reading").glob("*.py")]
    source = "".join(path.read_text() for path in places if path.name != "abaqus_options.py")
    spelled = {"INCLUDE": "INCLUDE|", "INPUT": "INPUT"}  # in a pattern of lines
    unnamed = [
        f"{keyword}, {option}"
        for keyword, options in USED.items()
        for option in ("", *options)
        if f'"{option or keyword}"' not in source and spelled.get(option or keyword, "?") not in source
    ]
    assert not unnamed


def test_refused_options_are_named_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(Fault, match=r"line 8: \*SURFACE, COMBINE is not read"):
        arrays_of(tmp_path, f"{TET}*SURFACE, NAME=a, COMBINE=UNION\nb, c\n")


@pytest.mark.parametrize("kind", ["BX", "BY", "BZ", "HP", "NEWTON", "ROTA", "TRVEC", "TRSHR", "P1NU", "CORIO", ""])
def test_loads_of_other_kinds_are_listed(kind: str) -> None:
    for keyword in ("DLOAD", "DSLOAD"):
        for place in ("SIDE", "7"):
            unused = read_deck(f"*STEP\n*{keyword}\n{place}, {kind}, 1.\n", {}).unused
            assert any(keyword in text for text in unused)


def test_keywords_go_on_after_a_comma_and_swallow_no_data() -> None:
    text = '*NSET, NSET=foot,\n1, 2\n3\n*SURFACE, TYPE=ELEMENT, NAME=end,\nTOP, S2\n*NODE,\nNSET = "all of it",\n'
    text += "** a comment\nSYSTEM=C\n1, 2.,, 3,\n*HYPERELASTIC,\nMOONEY-RIVLIN\n1., 2., 3.\n*STATIC,\n"
    text += "*SOLIDSECTION,ELSET=a"
    found = {keyword.name: (dict(keyword.options), keyword.lines) for keyword in keywords_of_text(text)}
    assert found == {
        "NSET": ({"NSET": "foot"}, [["1", "2"], ["3"]]),
        "SURFACE": ({"TYPE": "ELEMENT", "NAME": "end"}, [["TOP", "S2"]]),
        "NODE": ({"NSET": "all of it", "SYSTEM": "C"}, [["1", "2.", "", "3"]]),
        "HYPERELASTIC": ({"MOONEY-RIVLIN": ""}, [["1.", "2.", "3."]]),
        "STATIC": ({}, []),
        "SOLID SECTION": ({"ELSET": "a"}, []),
    }


def test_entries_that_are_left_out_are_zero(tmp_path: Path) -> None:
    _, arrays = arrays_of(tmp_path, TET.replace("3, , 1,", "3, , 1., 0.5"))
    assert arrays["points"][2].tolist() == [0, 1, 0.5]
    deck = read_deck("*STEP, NLGEOM\n*DLOAD\nEALL, CENTRIF, 4., , 1., , , , 1.\n*DENSITY\n1.\n", {})
    assert not [text for text in deck.unused if "no line" in text]


@pytest.mark.parametrize(
    ("system", "node", "point"),
    [
        ("C", "2., 90., 3.", (0, 2, 3)),
        ("c", "2., 180., ", (-2, 0, 0)),
        ("S", "2., 90., 0.", (0, 2, 0)),  # longitude, then latitude
        ("S", "2., 0., 30.", (3**0.5, 0, 1)),
        ("R", "2., 90., 3.", (2, 90, 3)),
    ],
)
def test_nodes_in_cylindrical_and_spherical_coordinates(
    system: str, node: str, point: tuple[float, ...], tmp_path: Path
) -> None:
    _, arrays = arrays_of(tmp_path, f"{TET}*NODE, SYSTEM={system}\n4, {node}\n")
    np.testing.assert_allclose(arrays["points"][3], point, atol=1e-14)
    with pytest.raises(Fault, match=re.escape("SYSTEM=X is not R, C or S")):
        arrays_of(tmp_path, f"{TET}*NODE, SYSTEM=X\n4, {node}\n")


def test_nodes_of_elements_and_falling_ranges(tmp_path: Path) -> None:
    _, arrays = arrays_of(tmp_path, f"{TET}*NSET, NSET=a, ELSET=block\n*NSET, NSET=b, GENERATE\n4, 2, -2\n")
    assert arrays["nodes:a"].tolist() == [0, 1, 2, 3]
    assert arrays["nodes:b"].tolist() == [1, 3]


def test_normals_of_nodes_are_said(tmp_path: Path) -> None:
    ignored, _ = arrays_of(tmp_path, TET.replace("4, 0, 0, 1", "4, 0, 0, 1, 0, 0, 1"))
    assert ignored == ["normals of nodes"]


@pytest.mark.parametrize("keyword", ["PART, NAME=a", "STEP", "ASSEMBLY, NAME=a"])
def test_files_that_end_within_something_are_refused(keyword: str, tmp_path: Path) -> None:
    name = keyword.partition(",")[0]
    with pytest.raises(Fault, match=rf"line 1: \*{name} has no \*END {name}"):
        arrays_of(tmp_path, f"*{keyword}\n{TET}")


def assembly(instance: str = "", more: str = "") -> str:
    mesh = TET.replace("3, , 1,", "3, 0, 1, 0")
    placed = f"*INSTANCE, NAME=i, PART=p\n{instance}*END INSTANCE\n{more}"
    return f"*PART, NAME=p\n{mesh}*END PART\n*ASSEMBLY, NAME=all\n{placed}*END ASSEMBLY\n"


def test_instances_are_moved_and_then_turned(tmp_path: Path) -> None:
    # 90° about the axis through (1, 0, 0) along z, after the motion by (0, 0, 5)
    _, arrays = arrays_of(tmp_path, assembly("0, 0, 5\n1, 0, 0, 1, 0, 2, 90\n"))
    expected = [(1, -1, 5), (1, 0, 5), (0, -1, 5), (1, -1, 6)]
    np.testing.assert_allclose(arrays["points"], expected, atol=1e-14)
    with pytest.raises(Fault, match="two points of an axis and an angle"):
        arrays_of(tmp_path, assembly("0, 0, 5\n1, 0, 0, 1, 0, 0, 90\n"))


def test_reference_points_of_an_assembly_are_left_out(tmp_path: Path) -> None:
    more = "*NODE\n1, 9, 9, 9\n*NSET, NSET=point\n1,\n*NSET, NSET=foot, INSTANCE=i\n1, 2, 3\n"
    ignored, arrays = arrays_of(tmp_path, assembly(more=more))
    assert ignored == ["1 reference points"]
    assert len(arrays["points"]) == 4
    assert arrays["nodes:foot"].tolist() == [0, 1, 2]
    assert "nodes:point" not in arrays  # number 1 is another node in the part


def test_surfaces_of_nodes_have_names_apart_from_node_sets(tmp_path: Path) -> None:
    _, arrays = arrays_of(
        tmp_path, f"{TET}*NSET, NSET=a\n1, 2\n*SURFACE, NAME=A, TYPE=NODE\n3\n*SURFACE, NAME=b, TYPE=NODE\n4\n"
    )
    assert arrays["nodes:a"].tolist() == [0, 1]
    assert arrays["nodes:A-surface"].tolist() == [2]
    assert arrays["nodes:b"].tolist() == [3]


def test_shells_have_the_same_grammar(tmp_path: Path) -> None:
    text = "*NODE, SYSTEM=C\n1, 0\n2, 1.\n3, 1., 90.\n*ELEMENT, TYPE=S3\n1, 1, 2, 3\n*NSET, NSET=a,\n1, 2\n"
    (tmp_path / "a.inp").write_text(text)
    _, arrays = read_inp_shells(tmp_path / "a.inp")
    np.testing.assert_allclose(arrays["points"][2], [0, 1, 0], atol=1e-15)
    assert arrays["nodes:a"].tolist() == [0, 1]


def test_an_element_that_is_defined_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Fault, match="line 9: element 1 is defined twice"):
        arrays_of(tmp_path, f"{TET}*ELEMENT, TYPE=C3D4\n1, 2, 1, 3, 4\n")
