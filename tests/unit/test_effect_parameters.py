"""What effects refuse: parameters without a meaning when the job is read, and regions before anything is solved."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from helpers.mesh_cases import write_msh22
from helpers.verification import BOX, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body
from hpcinv.physics.effects import effects
from hpcinv.solver.equations import Equations

MATERIAL = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
HELD = [{"region": "z0", "fix": ["x", "y", "z"]}]
FIBRES = {"muscle": {"direction": [1, 0, 0], "given_on": "reference"}}


def case(effect: dict[str, Any], **changes: Any) -> Job:
    """A block under one effect: its example, with some of its keys replaced, or removed (``...``)."""
    given = {k: v for k, v in (effects()[effect["effect"]].example | effect).items() if v is not ...}
    common: dict[str, Any] = {"mesh": {"file": BOX}, "material": MATERIAL, "supports": HELD, "fibres": FIBRES}
    return job(**(common | {"effects": [given]} | changes))


TENSOR = "must be a tensor, 3 rows of 3 numbers, or 3 numbers on its diagonal, not "
AXES = {"effect": "prestrain", "tensor": ..., "given_on": ..., "fibres": ["muscle"]}
ALONG = {"fibre": "muscle", "stretch": ..., "along": 1.2, "across": 0.9}

CASES: list[tuple[dict[str, Any], str]] = [
    ({"effect": "centrifugal", "axis": [0, 0.0, 0]}, ".axis: must not be zero"),
    ({"effect": "centrifugal", "axis": ["1 m", 0, 0]}, ".axis[0]: must be "),
    ({"effect": "centrifugal", "angular_velocity": "3 m/s"}, ".angular_velocity: must be "),
    ({"effect": "hydrostatic-pressure", "acceleration": [0, 0, 0]}, ".acceleration: must not be zero: without gravity"),
    ({"effect": "hydrostatic-pressure", "level": [0, 0, "9.81 m/s^2"]}, ".level[2]: must be a length"),
    ({"effect": "elastic-foundation", "normal": ..., "tangential": ...}, ": needs a stiffness: normal, tangential or"),
    ({"effect": "elastic-foundation", "normal": -1}, ".normal: must be at least 0, not -1"),
    ({"effect": "elastic-foundation", "normal": "5 kPa"}, ".normal: must be "),
    ({"effect": "elastic-foundation", "case": "first"}, ".case: is not valid here: springs act in every load case"),
    ({"effect": "traction", "area_in": ...}, ".area_in: is needed: configuration whose area"),
    ({"effect": "traction", "area_in": "spatial"}, ".area_in: must be 'reference' or 'current', not 'spatial'"),
    ({"effect": "traction", "traction": [1, 2]}, ".traction[2]: is needed"),
    ({"effect": "traction", "region": ...}, ".region: is needed: region of the boundary"),
    ({"effect": "pressure", "pressure": "12 mm"}, ".pressure: must be "),
    ({"effect": "gravity", "density_in": "deformed"}, ".density_in: must be 'reference' or 'current'"),
    ({"effect": "thermal-expansion", "coefficient": "3e-4 1/m"}, ".coefficient: must be "),
    (
        {"effect": "thermal-expansion", "coefficient": 1e-2, "temperature_change": -100},
        ".coefficient: gives the stretch 1 + alpha ΔT = 0, which must be above 0: correct 0.01 1/K, or the temperature",
    ),
    (
        {"effect": "thermal-expansion", "coefficient": 1e-2, "temperature_change": {"block": -150, "elsewhere": 1}},
        ".coefficient: gives the stretch 1 + alpha ΔT = -0.5 in region 'block'",
    ),
    (
        {"effect": "thermal-expansion", "coefficient": {"block": -1, "elsewhere": 0}, "temperature_change": 2},
        ".coefficient: gives the stretch 1 + alpha ΔT = -1 in region 'block'",
    ),
    (
        {
            "effect": "thermal-expansion",
            "coefficient": 1e-2,
            "temperature_change": ...,
            "temperature": "0 °C",
            "reference_temperature": "200 °C",
        },
        ".coefficient: gives the stretch 1 + alpha ΔT = -1, which",
    ),
    ({"effect": "growth", "stretch": ...}, ".stretch: is needed in growth without fibres"),
    ({"effect": "growth", "stretch": 0}, ".stretch: must be above 0, not 0"),
    ({"effect": "growth", "stretch": -1.1}, ".stretch: must be above 0, not -1.1"),
    ({"effect": "growth", "along": 1.2}, ".along: is not valid in growth without fibres"),
    ({"effect": "growth", "across": 1.2}, ".across: is not valid in growth without fibres"),
    ({"effect": "growth"} | ALONG | {"stretch": 1.1}, ".stretch: is not valid in growth along fibres"),
    ({"effect": "growth"} | ALONG | {"across": ...}, ".across: is needed in growth along fibres"),
    ({"effect": "growth"} | ALONG | {"along": -0.1}, ".along: must be above 0, not -0.1"),
    ({"effect": "growth"} | ALONG | {"fibre": "muscel"}, ".fibre: there are no fibres 'muscel'; define them in"),
    ({"effect": "prestrain", "tensor": ...}, ": needs exactly one of 'tensor' (F0) and 'fibres' (with stretches"),
    ({"effect": "prestrain", "given_on": ...}, ".given_on: is needed: body on which the tensor is given"),
    ({"effect": "prestrain", "tensor": 1.1}, f".tensor: {TENSOR}1.1"),
    ({"effect": "prestrain", "tensor": [[1, 0], [0, 1]]}, f".tensor: {TENSOR}[[1, 0], [0, 1]]"),
    ({"effect": "prestrain", "tensor": [[1, 0, 0], [0, 1], [0, 0, 1]]}, ".tensor[1]: must be a row of 3 numbers, not"),
    ({"effect": "prestrain", "tensor": [1, "1 mm", 1]}, ".tensor[1][1]: must be a pure number, but '1 mm' is a length"),
    ({"effect": "prestrain", "tensor": [1, 1, math.nan]}, ".tensor[2][2]: must be finite, not nan"),
    ({"effect": "prestrain", "tensor": {"data": "F0", "unit": "mm"}}, ".tensor: must be a pure number, but 'mm' is a"),
    ({"effect": "prestrain", "tensor": {}}, ".tensor: must name regions"),
    ({"effect": "prestrain", "tensor": {"block": [1, 1], "elsewhere": [1, 1, 1]}}, f".tensor.block: {TENSOR}[1, 1]"),
    ({"effect": "prestrain", "tensor": [1, -1, 1]}, ".tensor: inverts the material: det F0 must be above 0, not -1"),
    ({"effect": "prestrain", "tensor": {"block": [1, 0, 1]}}, ".tensor.block: inverts the material: det F0 must be"),
    ({"effect": "prestrain", "tensor": [-1.1, -1, 1]}, ".tensor: inverts the material on the way from I to F0"),
    ({"effect": "prestrain", "stretches": [1, 1]}, ".stretches: are not valid without 'fibres'"),
    (AXES, ".stretches: must be 2, along and across the fibres, not 0"),
    (AXES | {"stretches": [1, 1, 1]}, ".stretches: must be 2, along and across the fibres, not 3"),
    (AXES | {"stretches": [1, -1]}, ".stretches[1]: must be above 0, not -1"),
    (
        AXES | {"stretches": [1, 1], "given_on": "current"},
        ".given_on: is not valid with 'fibres', which say themselves",
    ),
    (AXES | {"fibres": ["muscle"] * 2, "stretches": [1, 1, 1]}, ".fibres[1]: 'muscle' is duplicated"),
    (AXES | {"fibres": ["muscel"], "stretches": [1, 1]}, ".fibres: there are no fibres 'muscel'; define them in"),
    ({"effect": "active-stress", "fibre": "muscel"}, ".fibre: there are no fibres 'muscel'; define them in 'fibres'"),
    ({"effect": "active-stress", "fibre": "muscel"}, "Did you mean 'muscle'?"),
    ({"effect": "gravity", "case": "secnd"}, ".case: 'secnd' is not among 'load_cases'. Did you mean 'second'?"),
]


@pytest.mark.parametrize(("effect", "message"), CASES, ids=[f"{e['effect']}{message[:50]}" for e, message in CASES])
def test_meaningless_effect_values_are_refused_with_their_place(effect: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError) as caught:
        case(effect, load_cases=["first", "second"])
    (problem,) = caught.value.problems
    place, text = problem.split(": ", 1)[1].split(":", 1)
    assert place.startswith("effects[0]")
    assert message in f"{place.removeprefix('effects[0]')}:{text}"


OF_SOLIDS = {name: effect for name, effect in effects().items() if not effect.only_of_kind}


@pytest.mark.parametrize("name", OF_SOLIDS)
def test_every_example_can_be_read_and_no_other_key(name: str) -> None:
    families = effects()[name].model_validate(effects()[name].example).families
    fibres = dict.fromkeys(families, FIBRES["muscle"])
    assert case({"effect": name}, fibres=fibres).effects[0].effect == name  # type: ignore[attr-defined]
    with pytest.raises(JobError, match=r"effects\[0\]\.strength: unknown key"):
        case({"effect": name, "strength": 1}, fibres=fibres)


def test_springs_hold_a_body_that_nothing_else_holds() -> None:
    assert case({"effect": "elastic-foundation"}, supports=[]).supports == ()
    with pytest.raises(JobError, match="supports: leave the body free to move along x and y and z"):
        case({"effect": "gravity"}, supports=[])


def refused(case: Job) -> str:
    """Return why a valid job has no weak form."""
    with pytest.raises(MeshError) as caught:
        Equations(case, build_body(case.mesh, case.regions, MPI.COMM_SELF, resolve=case.resolve), Timings()).weak_form(
            "inverse"
        )
    return str(caught.value)


@pytest.mark.everyday(
    "elastic-foundation", "hydrostatic-pressure", "pressure", "smooth-pressure", "smooth-traction", "traction"
)
@pytest.mark.parametrize("name", [name for name, effect in OF_SOLIDS.items() if "region" in effect.model_fields])
def test_a_region_must_be_one_of_the_boundary(name: str, tmp_path: Path) -> None:
    unknown = refused(case({"effect": name, "region": "x10"}))
    assert unknown.startswith("effects[0].region: ")
    assert "box.py: no region 'x10'. Did you mean 'x1'?" in unknown
    assert "The regions are: block, boundary, x0, x1, y0, y1, z0, z1." in unknown
    assert "box.py: region 'block' has cells but no facets" in refused(case({"effect": name, "region": "block"}))
    # Two tetrahedra, and the triangle between them.
    write_msh22(
        tmp_path / "two.msh",
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)],
        [(4, 1, 1, (1, 2, 3, 4)), (4, 1, 1, (2, 3, 4, 5)), (2, 2, 2, (2, 3, 4)), (2, 3, 3, (1, 2, 3))],
        [(3, 1, "body"), (2, 2, "between"), (2, 3, "z0")],
    )
    effect = effects()[name].example | {"region": "between"}
    data = {"mesh": {"file": "two.msh"}, "material": MATERIAL, "supports": HELD, "effects": [effect]}
    inside = refused(parse(data, tmp_path / "job.yaml"))
    assert "two.msh: region 'between' has 1 facets inside the body\n  A surface load needs a region of" in inside


def test_a_stretch_that_is_not_positive_somewhere_is_reported_before_the_solve() -> None:
    message = refused(case({"effect": "growth", "stretch": "1 - 2*X/(1 m)"}))
    assert "box.py: effects[0].stretch must be above 0, but is " in message


@pytest.mark.parametrize(
    "heat",
    [
        {"coefficient": "1e-2*X/(1 m)/(1 K)", "temperature_change": "-150 K"},
        {"coefficient": "1e-2 1/K", "temperature_change": "-150 K * X/(1 m)"},
        {"coefficient": {"block": 1e-2}, "temperature_change": "-150 K * X/(1 m)"},
    ],
)
def test_heat_that_leaves_no_stretch_somewhere_is_reported_before_the_solve(heat: dict[str, Any]) -> None:
    message = refused(case({"effect": "thermal-expansion"} | heat))
    assert "box.py: effects[0]: the stretch 1 + alpha ΔT must be positive, but is -" in message


def test_a_prestrain_that_inverts_somewhere_or_has_no_axes_is_reported_before_the_solve() -> None:
    def prestrained(**data: Any) -> str:
        axes = {"tensor": ..., "given_on": ...} if "fibres" in data else {}
        fibres = FIBRES | {"other": {"direction": [2, "0*Y/(1 m)", 0], "given_on": "current"}}
        return refused(case({"effect": "prestrain"} | axes | data, fibres=fibres))

    def diagonal(first: str) -> str:
        return prestrained(tensor=[first, -1 if first.startswith("-") else 1, 1])

    assert "box.py: effects[0]: det F0 must be positive, but is " in diagonal("1 - 2*X/(1 m)")
    assert "effects[0].tensor must be finite, but is " in diagonal("sqrt(x/(1 m) - 0.5)")
    assert "det F0 on the way from I to F0 (give it without rotation) must be positive, but is " in diagonal(
        "-1 - Z/(1 m)"
    )
    spanned = "effects[0]: the volume that the directions of its fibres span must be positive, but is 0 in some cell"
    assert spanned in prestrained(fibres=["muscle", "other"], stretches=[1.1, 1, 1])
    missing = prestrained(tensor={"data": "F0"})
    assert "box.py: no data array 'F0'" in missing
    assert "The mesh has none; " in missing
    unknown = prestrained(tensor={"blok": [1, 1, 1]})
    assert unknown.startswith("effects[0].tensor: ")
    assert "no region 'blok'. Did you mean 'block'?" in unknown
