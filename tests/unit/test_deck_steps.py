"""Supports and loads of the steps of input files of Abaqus and CalculiX: what holds at the end of the last one."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hpcinv.base.reading.inp_files import read_inp
from hpcinv.formats.cards.abaqus_deck import read_deck
from hpcinv.formats.cards.card import CardError
from hpcinv.formats.cards.deck import Deck, Measure

SETS = {"FOOT": frozenset((1, 2)), "TOP": frozenset((3, 4)), "WIDE": frozenset((4, 5))}
HEAD = """*MATERIAL, NAME=rubber
*ELASTIC
10, 0.3
*DENSITY
1e-9
*SOLID SECTION, ELSET=EALL, MATERIAL=rubber
"""


def deck_of(text: str) -> Deck:
    return read_deck(HEAD + text.replace(" | ", "\n"), SETS)


def step(text: str) -> str:
    return f"*STEP, NLGEOM | *STATIC | {text} | *END STEP | "


def pressures(deck: Deck) -> dict[str, float]:
    return {effect["region"]: effect["pressure"].value for effect in deck.effects if "pressure" in effect}


def test_op_new_ends_earlier_steps_and_not_its_own() -> None:
    first = step("*BOUNDARY | FOOT, 1, 3 | *DSLOAD | SIDE, P, 0.3 | *CLOAD | TOP, 3, 5.")
    second = step(
        "*BOUNDARY, OP=NEW | TOP, 1, 2 | *BOUNDARY, OP=NEW | WIDE, 3"
        " | *DSLOAD, OP=NEW | A, P, 0.1 | *DSLOAD, OP=NEW | B, P, 0.2"
        " | *CLOAD, OP=NEW | TOP, 1, 1. | *CLOAD, OP=NEW | WIDE, 2, 2."
    )
    deck = deck_of(first + second)
    assert deck.supports == [{"region": "TOP", "fix": ["x", "y"]}, {"region": "WIDE", "fix": ["z"]}]
    assert pressures(deck) == {"A": 0.1, "B": 0.2}
    assert [(f.region, f.forces) for f in deck.forces] == [
        ("TOP", {3: (1.0, 0.0, 0.0), 4: (1.0, 0.0, 0.0)}),
        ("WIDE", {4: (0.0, 2.0, 0.0), 5: (0.0, 2.0, 0.0)}),
    ]
    assert not deck.unused


@pytest.mark.parametrize("keyword", ["BOUNDARY", "DLOAD", "DSLOAD", "CLOAD"])
def test_late_op_new_is_said(keyword: str) -> None:
    line = "TOP, 1, 1." if keyword in ("BOUNDARY", "CLOAD") else "TOP, P1, 1."
    deck = deck_of(step(f"*{keyword} | {line} | *{keyword}, OP=NEW | {line}"))
    assert any("OP=NEW" in text and keyword in text for text in deck.unused)


def test_loads_of_one_step_add_up_and_those_of_a_later_step_replace() -> None:
    loads = "*DSLOAD | SIDE, P, 0.2 | *DSLOAD | side, P, 0.25 | *CLOAD | TOP, 3, 0.02 | *CLOAD | TOP, 3, 0.03"
    loads += " | *DLOAD | 7, P1, 0.5 | 7, P1, 0.25 | *CLOAD | 9, 1, 2. | 9, 1, 3."
    deck = deck_of(step(loads))
    assert pressures(deck) == {"SIDE": 0.45, "pressed": 0.75}
    assert [f.forces for f in deck.forces] == [
        dict.fromkeys((3, 4), (0.0, 0.0, pytest.approx(0.05))),
        {9: (5.0, 0.0, 0.0)},
    ]
    later = deck_of(step(loads) + step("*DSLOAD | SIDE, P, 0.1 | *CLOAD | 4, 3, 1. | *DLOAD | 7, P1, 0.125"))
    assert pressures(later) == {"SIDE": 0.1, "pressed": 0.125}
    # a force on node 4 replaces what the set of an earlier step has there
    assert later.forces[0].forces == {3: (0.0, 0.0, pytest.approx(0.05)), 4: (0.0, 0.0, 0.0)}


def test_gravity_has_a_direction_and_adds_up() -> None:
    (effect,) = deck_of(step("*DLOAD | EALL, GRAV, 9810., 0, 0, -2. | EALL, GRAV, 100., 3, , 0")).effects
    assert [component.value for component in effect["acceleration"]] == [100.0, 0.0, -9810.0]
    again = deck_of(step("*DLOAD | EALL, GRAV, 1., 0, 0, -2.") + step("*DLOAD | EALL, GRAV, 3., 0, 0, -1."))
    assert [component.value for component in again.effects[0]["acceleration"]] == [0.0, 0.0, -3.0]
    assert not again.unused
    turned = deck_of(step("*DLOAD | EALL, GRAV, 1., 0, 0, -1") + step("*DLOAD | EALL, GRAV, 3., 1, 0, 0"))
    assert any("Abaqus replaces" in text for text in turned.unused)


def test_absolute_amplitudes_are_values() -> None:
    curve = "*AMPLITUDE, NAME=A, VALUE=ABSOLUTE | 0, 0, 1, 0.4 | "
    deck = deck_of(curve + step("*BOUNDARY, AMPLITUDE=A | TOP, 3, 3, 2. | *DSLOAD, AMPLITUDE=A | SIDE, P, 7."))
    assert deck.supports == [{"region": "TOP", "displacement": [None, None, Measure(0.4, length=1)]}]
    assert pressures(deck) == {"SIDE": 0.4}
    assert deck_of(curve.replace("ABSOLUTE", "RELATIVE") + step("*DSLOAD, AMPLITUDE=A | S, P, 7.")).effects[0][
        "pressure"
    ].value == pytest.approx(2.8)


def test_total_time_goes_on_in_later_steps() -> None:
    curve = "*AMPLITUDE, NAME=A, TIME=TOTAL TIME | 0, 0, 4, 1 | "
    text = "*STEP, NLGEOM | *STATIC | 0.1, 1. | *DSLOAD, AMPLITUDE=A | SIDE, P, 8. | *END STEP | "
    assert pressures(deck_of(curve + text + "*STEP, NLGEOM | *STATIC | 0.1, 3. | *END STEP"))["SIDE"] == 8.0


def consistent(tmp_path: Path, kind: str) -> tuple[Deck, frozenset[int]]:
    """Return the deck of the forces of a unit traction along z on the top of one element, and its loaded region."""

    if kind == "C3D10":
        corners, top = [(0, 0, 1), (0, 1, 1), (1, 0, 1), (0, 0, 0)], (0, 1, 2)
        edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
        corner, middle = 0.0, 1 / 6
    else:
        corners = [(x, y, z) for z in (1, 0) for x, y in ((0, 0), (0, 1), (1, 1), (1, 0))]
        edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
        top = (0, 1, 2, 3)
        corner, middle = -1 / 12, 1 / 3
    nodes = [*corners, *([(a + b) / 2 for a, b in zip(corners[i], corners[j], strict=True)] for i, j in edges)]
    loads = [f"{i + 1}, 3, {corner}" for i in top if corner]
    loads += [f"{len(corners) + k + 1}, 3, {middle}" for k, edge in enumerate(edges) if {*edge} <= {*top}]
    text = "*NODE | " + " | ".join(f"{i}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(nodes, 1))
    numbers = [*map(str, range(1, len(nodes) + 1))]
    text += f" | *ELEMENT, TYPE={kind} | 1, {', '.join(numbers[:15])}"
    text += f", | {', '.join(numbers[15:])} | " if numbers[15:] else " | "
    text += step("*CLOAD | " + " | ".join(loads))
    (tmp_path / "a.inp").write_text(text.replace(" | ", "\n"))
    arrays = read_inp(tmp_path / "a.inp")[1]
    sets = {k[6:]: frozenset(arrays["node_tags"][v].tolist()) for k, v in arrays.items() if k.startswith("nodes:")}
    assert sets.keys() == {"loaded" if kind == "C3D10" else "loaded-2"}
    return read_deck(text.replace(" | ", "\n"), sets), next(iter(sets.values()))


@pytest.mark.parametrize(("kind", "area"), [("C3D10", 0.5), ("C3D20", 1.0)])
def test_forces_on_middle_nodes_are_of_the_whole_face(kind: str, area: float, tmp_path: Path) -> None:
    deck, region = consistent(tmp_path, kind)
    (forces,) = deck.forces
    assert region >= {1, 2, 3}
    assert forces.region is not None
    assert sum(z for _, _, z in forces.forces.values()) == pytest.approx(area)


def test_small_displacements_of_the_file_are_said() -> None:
    assert deck_of("*STEP | *STATIC | *END STEP").is_linear
    assert not deck_of("*STEP, NLGEOM=YES | *STATIC | *END STEP").is_linear
    assert deck_of("*STEP, NLGEOM=NO | *STATIC | *END STEP").is_linear


@pytest.mark.parametrize(
    ("held", "section"),
    [
        ("", {"remote": None}),
        ("*BOUNDARY | RP, 1, 6", {"fix": ["x", "y", "z"]}),
        ("*BOUNDARY | RP, 1, 6 | 9, 1, 1, 0.5", {"displacement": [0.5, 0.0, 0.0]}),
        ("*BOUNDARY | RP, 1, 6 | RP, 6, 6, 0.5", {"motion": None}),
        ("*BOUNDARY | RP, 1, 3", None),
    ],
)
@pytest.mark.parametrize("node", ["9", "RP"])
def test_reference_points_have_loads_and_motions(node: str, held: str, section: dict[str, object] | None) -> None:
    text = "*NODE, NSET=RP | 9, 1, 2, 3 | *COUPLING, SURFACE=END, REF NODE=RP | *KINEMATIC | "
    load = f"*CLOAD | {node}, 1, 0.25 | {node}, 6, 2." if not held else held.replace("RP", node)
    deck = deck_of(text + step(load))
    if section is None:
        assert not deck.remotes
        assert any("*COUPLING of END" in text for text in deck.unused)
        return
    (rigid,) = deck.remotes
    assert (rigid.region, rigid.of, rigid.section.keys()) == ("END", "surface", section.keys())
    point = [Measure(x, length=1) for x in (1.0, 2.0, 3.0)]
    if "remote" in section:
        assert rigid.section["remote"] == {
            "force": [Measure(x, length=2, stress=1) for x in (0.25, 0.0, 0.0)],
            "moment": [Measure(x, length=3, stress=1) for x in (0.0, 0.0, 2.0)],
            "about": point,
        }
    elif "motion" in section:
        motion = rigid.section["motion"]
        assert motion["about"] == point
        assert motion["axis"] == [0.0, 0.0, 1.0]
        assert float(motion["rotate"].split()[0]) == pytest.approx(28.6478897565412)
    elif "displacement" in section:
        assert [part.value for part in rigid.section["displacement"]] == section["displacement"]


def test_components_of_other_fields_are_said() -> None:
    deck = deck_of(step("*BOUNDARY | FOOT, 11, 11, 300. | 7, 8"))
    assert [text[:25] for text in deck.unused] == ["*BOUNDARY of component 11", "*BOUNDARY of component 8,"]
    assert not deck.supports


def test_pressures_of_several_steps_on_several_names_are_said() -> None:
    deck = deck_of(step("*DSLOAD | A, P, 1.") + step("*DSLOAD | B, P, 2."))
    assert pressures(deck) == {"A": 1.0, "B": 2.0}
    assert any("order of the pressures on A, B" in text for text in deck.unused)


def test_sets_may_be_named_with_their_instance() -> None:
    deck = deck_of(step("*CLOAD | Part-1.TOP, 1, 2. | *BOUNDARY | Part-1.FOOT, 3"))
    assert deck.forces[0].forces == dict.fromkeys((3, 4), (2.0, 0.0, 0.0))
    assert deck.supports == [{"region": "Part-1.FOOT", "fix": ["z"]}]
    assert not deck.unused


def test_axes_of_a_part_that_is_turned_are_refused() -> None:
    axes = "*ORIENTATION, NAME=o | 1, 0, 0, 0, 1, 0 | "
    turned = "*INSTANCE, NAME=i, PART=p | 0, 0, 0 | 0, 0, 0, 0, 0, 1, 90 | *END INSTANCE | "
    deck_of(f"*PART, NAME=p | *END PART | {axes}{turned}")
    with pytest.raises(CardError, match=r"\*ORIENTATION in a part that \*INSTANCE turns"):
        deck_of(f"*PART, NAME=p | {axes}*END PART | {turned}")


CUBE = """*NODE
1,0,0,0 | 2,1,0,0 | 3,1,1,0 | 4,0,1,0 | 5,0,0,1 | 6,1,0,1 | 7,1,1,1 | 8,0,1,1
*ELEMENT, TYPE=C3D8, ELSET=EALL
1, 1,2,3,4,5,6,7,8
*NSET, NSET=FOOT | 1,2,3,4 | *NSET, NSET=TOP | 5,6,7,8 | *NSET, NSET=WIDE | 7,8
*ELSET, ELSET=ONE | 1 | *SURFACE, NAME=ROOF | ONE, S2
*MATERIAL, NAME=rubber | *ELASTIC | 1e4, 0.3 | *DENSITY | 0.01
*SOLID SECTION, ELSET=EALL, MATERIAL=rubber
*AMPLITUDE, NAME=HALF | 0,0, 1,0.5
*BOUNDARY | FOOT, 1, 3
"""
STEPS = [
    step("*CLOAD | TOP, 1, 1. | *CLOAD | TOP, 1, 2. | WIDE, 1, 4."),
    step("*CLOAD | TOP, 1, 1.") + step("*CLOAD | WIDE, 1, 5. | *DSLOAD | ROOF, P, 2."),
    step("*CLOAD | TOP, 1, 1.") + step("*CLOAD, OP=NEW | WIDE, 2, 5. | *CLOAD, OP=NEW | WIDE, 2, 1. | 5, 3, 2."),
    step("*DLOAD | EALL, P2, 3. | 1, P2, 1. | *DLOAD, AMPLITUDE=HALF | EALL, P3, 4."),
    step("*DLOAD | EALL, GRAV, 100., 0,0,-2. | EALL, GRAV, 30., 3.,0,0 | EALL, GRAV, 20., 0,0,-1."),
    step("*DLOAD | EALL, GRAV, 100., 0,0,-2. | ONE, GRAV, 30., 3.,0,0")
    + step("*DLOAD | EALL, GRAV, 50., 0,0,-7. | ONE, GRAV, 10., 1.,0,0"),
    step("*DLOAD | EALL, P2, 3. | 1, P4, 1.") + step("*DLOAD, OP=NEW | 1, P2, 1."),
    step("*CLOAD, AMPLITUDE=HALF | TOP, 3, 8.") + step("*BOUNDARY | FOOT, 1, 3"),
]


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
@pytest.mark.parametrize("steps", STEPS)
def test_calculix_finds_the_same_force_on_the_foot(steps: str, tmp_path: Path) -> None:
    text = (CUBE + steps.replace(", NLGEOM", "")).replace(" | ", "\n")
    (tmp_path / "a.inp").write_text(text)
    arrays = read_inp(tmp_path / "a.inp")[1]
    sets = {k[6:]: frozenset(arrays["node_tags"][v].tolist()) for k, v in arrays.items() if k.startswith("nodes:")}
    deck = read_deck(text, sets)
    normals = {"1": (0, 0, -1), "2": (0, 0, 1), "3": (0, -1, 0), "4": (1, 0, 0)}
    faces = {key[6:]: str(rows[0, 1] + 1) for key, rows in arrays.items() if key.startswith("faces:")}
    total = np.zeros(3)
    for forces in deck.forces:
        total += np.sum(list(forces.forces.values()), axis=0)
    on_foot = np.zeros(3)  # half of what acts on the whole body or on a side of it
    for effect in deck.effects:
        if effect["effect"] == "gravity":
            on_foot += [0.01 * part.value / 2 for part in effect["acceleration"]]
        else:
            push = -effect["pressure"].value * np.array(normals[faces[effect["region"]]])
            on_foot += push if push[2] else push / 2
    output = "*NODE PRINT, NSET=FOOT, TOTALS=ONLY\nRF\n*END STEP"
    (tmp_path / "ref.inp").write_text(text.replace("*END STEP", output))
    subprocess.run(["ccx", "-i", "ref"], cwd=tmp_path, capture_output=True, check=True, timeout=60)
    rows = [line.split() for line in (tmp_path / "ref.dat").read_text().splitlines()]
    reaction = np.array([float(x) for x in [row for row in rows if len(row) == 3][-1]])
    np.testing.assert_allclose(total + on_foot, -reaction, atol=2e-5)
    assert [text for text in deck.unused if "Abaqus" not in text] == []
