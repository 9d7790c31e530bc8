"""What jobs say about contact: what closes an inverse analysis, and shapes of obstacles with their distances."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import pytest
import ufl
from helpers.verification import box, job
from pydantic import TypeAdapter

from hpcinv.errors import JobError
from hpcinv.physics.effects.obstacles import AnyObstacle

FLOOR = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
LAYER = {"stiffness": "1 MPa/m"}


def refused(contact: dict[str, Any], message: str, **more: Any) -> None:
    data = {
        "mesh": box(),
        "material": {"law": "neo-hookean", "mu": 1e4, "lam": 1e4},
        "effects": [{"effect": "contact", "region": "z0", "obstacle": FLOOR, **contact}],
        "supports": [{"region": "z1", "fix": ["x", "y", "z"]}],
        "analysis": "forward",
    }
    with pytest.raises(JobError, match=message):
        job(**data | more)


@pytest.mark.parametrize("analysis", ["inverse", "round_trip"])
def test_an_inverse_analysis_needs_what_determines_the_pressure(analysis: str) -> None:
    refused(
        {},
        r"effects\[0\]: the contact pressure on a given deformed body is not determined.* give the 'stiffness'",
        analysis=analysis,
    )


def test_faults_name_their_field() -> None:
    refused({"pressure": "1 kPa"}, r"effects\[0\].pressure: is valid only on a given deformed body")
    refused({**LAYER, "penalty": "1 MPa/m"}, r"effects\[0\].penalty: is not valid with 'stiffness'")
    refused({"stand_off": "1 mm"}, r"effects\[0\].stand_off: is not valid without 'stiffness'")
    refused({"obstacle": {"shape": "cone"}}, r"effects\[0\].obstacle.shape: unknown shape 'cone'")
    refused({"obstacle": FLOOR | {"normal": [0, 0, 0]}}, r"obstacle.normal: must not be zero")
    refused({"obstacle": {"shape": "level-set", "formula": "z > 0"}}, r"obstacle.formula: must be a number")
    refused({"obstacle": {"shape": "level-set", "formula": "r"}}, r"obstacle.formula: unknown name 'r'")
    refused({"obstacle": {"shape": "surface", "file": "no.stl"}}, r"obstacle.file: there is no file")
    refused({"obstacle": {"shape": "surface", "file": "no.step"}}, r"obstacle.file: .* is not a readable surface")
    area = {"name": "touching", "of": "contact_area", "on": "x1"}
    refused(
        {}, r"quantities\[0\].on: 'x1' is not the region of a contact: those with contact are z0", quantities=[area]
    )
    refused({}, "sensitivities: are not possible with contact with a rigid", sensitivities=["material.mu"])


def test_quantity_of_contact_names_the_state_that_has_one() -> None:
    held, contact = [{"region": "z1", "fix": ["x", "y", "z"]}], {"effect": "contact", "region": "z0", "obstacle": FLOOR}
    states: list[dict[str, Any]] = [
        {"name": "scan", "given": True, "effects": [], "supports": held},
        {"name": "free", "effects": [], "supports": held},
        {"name": "pressed", "effects": [contact | LAYER], "supports": held},
    ]
    force = {"name": "grip", "of": "contact_force", "on": "z0"}
    data = {"mesh": box(), "material": {"law": "neo-hookean", "mu": 1e4, "lam": 1e4}, "states": states}
    with pytest.raises(JobError) as caught:
        job(**data, quantities=[force])
    message = "'z0' is not the region of a contact in state 'free': there is no contact; give the quantity the state"
    assert message in str(caught.value)
    assert "(state: pressed)" in str(caught.value)
    (quantity,) = job(**data, quantities=[force | {"state": "pressed"}]).quantities
    assert quantity.state == "pressed"


def test_untrusted_jobs_read_no_surface(tmp_path: Path) -> None:
    from hpcinv.job.job import parse

    (tmp_path / "bed.stl").write_text("solid bed\nendsolid bed\n")
    with pytest.raises(JobError, match=r"obstacle.file: 'bed.stl' is read by VTK .* refused with --untrusted"):
        parse(
            {"effects": [{"effect": "contact", "region": "z0", "obstacle": {"shape": "surface", "file": "bed.stl"}}]},
            tmp_path / "job.yaml",
            untrusted=True,
        )


HALF = 0.5
SHAPES: list[tuple[dict[str, Any], list[float], float, list[float]]] = [
    (FLOOR | {"normal": [0, 0, -2]}, [1, 2, 3], -3, [0, 0, -1]),
    ({"shape": "sphere", "centre": [1, 0, 0], "radius": 2}, [1, 3, 4], 3, [0, 0.6, 0.8]),
    ({"shape": "sphere", "centre": [1, 0, 0], "radius": 6, "hollow": True}, [1, 3, 4], 1, [0, -0.6, -0.8]),
    ({"shape": "cylinder", "point": [5, 0, 0], "axis": [3, 0, 0], "radius": 2}, [1, 3, 4], 3, [0, 0.6, 0.8]),
    ({"shape": "level-set", "formula": "3*y + 4*z - 5 m"}, [7, 1, 2], 6 / 5, [0, 0.6, 0.8]),
    ({"shape": "level-set", "formula": "(x^2 + y^2 + z^2)/(1 m) - 4 m"}, [0, 3, 4], 21 / 10, [0, 0.6, 0.8]),
]


@pytest.mark.parametrize(("shape", "point", "distance", "direction"), SHAPES)
def test_signed_distance_and_direction(
    shape: dict[str, Any], point: list[float], distance: float, direction: list[float]
) -> None:
    """In scaled lengths of half a metre."""
    obstacle = TypeAdapter(AnyObstacle).validate_python(shape)
    par = {
        name: value if np.ndim(value) == 0 else ufl.as_vector([v / (HALF if dimension.length else 1) for v in value])
        for name, (value, dimension) in obstacle.quantities().items()
    }
    par |= {name: par[name] / HALF for name in ("radius", "metre") if name in par}
    signed_distance, towards = obstacle.distance(ufl.as_vector([c / HALF for c in point]), SimpleNamespace(**par))
    assert float(ufl.as_ufl(signed_distance)(())) * HALF == pytest.approx(distance)
    assert [float(towards[i](())) for i in range(3)] == pytest.approx(direction, abs=1e-12)


@pytest.mark.parametrize(("shape", "point", "distance", "direction"), [s for s in SHAPES if "formula" in s[0]])
def test_formulas_have_their_distance_at_points_of_arrays(
    shape: dict[str, Any], point: list[float], distance: float, direction: list[float]
) -> None:
    """By differences; passages through obstacles are found by them."""
    obstacle = TypeAdapter(AnyObstacle).validate_python(shape)
    points = np.array(point)[:, None] / HALF
    signed_distance, towards = obstacle.distance(points, SimpleNamespace(metre=1 / HALF))
    assert signed_distance * HALF == pytest.approx([distance], rel=1e-6)
    assert towards[:, 0] == pytest.approx(direction, abs=1e-6)


def test_unit_of_triangles_is_written_like_a_meshs(tmp_path: Path) -> None:
    (file := tmp_path / "bed.stl").touch()
    given = [{"shape": "surface", "file": str(file), "unit": unit} for unit in ("mm", "1 mm", 1e-3)]
    assert {TypeAdapter(AnyObstacle).validate_python(obstacle).unit for obstacle in given} == {1e-3}
