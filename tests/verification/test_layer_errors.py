"""Errors that the one layer of a shell leaves: stresses of thick shells and displacements near clamps."""

import math
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result
from hpcinv.output.text_report import _errors_of_quantity
from hpcinv.trust.discretisation import layer_errors

ESTIMATE = {"level": "off", "estimate": True}
INNER, OUTER = 0.9, 1.1  # m: R/t = 5


def law(poisson: float) -> dict[str, Any]:
    return {"law": "st-venant-kirchhoff", "young": 1.0, "poisson": poisson}


def assert_covered(result: Result, name: str, exact: float, most: float) -> None:
    """The estimate alone is far too small; with the layer's error it is 1 to ``most`` times the true one.

    Signs do not count.
    """
    assert result.estimate is not None
    value, estimated = np.abs([result.quantities[name], result.estimate.quantities[name]])
    error = abs(value - abs(exact))
    layer = result.estimate.layer[name]
    print(f"error {error:.2e}, estimated {estimated:.2e}, of the layer {layer.size:.2e}, {layer.cause}")
    assert estimated < 0.5 * error
    assert error <= estimated + layer.size <= most * error
    (note,) = _errors_of_quantity(result.statistics, name, lambda value, digits: f"{value:.{digits}g}")
    assert f"of its layer, {layer.cause}" in note


def quarter_cylinder(poisson: float, loads: dict[str, Any], **end: Any) -> Any:
    """In plane strain; ``hoop`` and ``radial`` are stresses of the inner face at 45°."""
    c = math.sqrt(0.5)
    at = [INNER * c, 0.05, 1 - INNER * c]
    return job(
        analysis="forward",
        mesh={
            "file": str(ROOT / "meshes" / "sheet.py"),
            "parameters": {"length": math.pi / 2, "width": 0.1, "radius": 1.0, "nx": 8, "ny": 1},
            "shell": {"thickness": OUTER - INNER},
        },
        material=law(poisson),
        effects=[loads],
        supports=[{"region": y, "fix": ["y"]} for y in ("y0", "y1")] + [{"region": "x0", "fix": ["x"]}, end],
        quantities=[
            {"name": name, "of": f"(sxx + szz) / 2 {sign} sxz", "at": at}
            for name, sign in (("hoop", "+"), ("radial", "-"))
        ],
        certificate=ESTIMATE,
    )


@pytest.mark.release
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_stresses_of_a_bent_thick_shell(poisson: float, comm: MPI.Intracomm) -> None:
    """Golovin's curved bar, whose stress is 3 or 20 % off at the inner face, and 7 or 26 % across it."""
    moment = 1e-8
    bent = {"effect": "edge-moment", "region": "x1", "moment": [0, moment, 0]}
    result = hpcinv.run(quarter_cylinder(poisson, bent, region="x0", fix=["z"], hinge=True), comm, progress=False)
    ratio, a, b = math.log(OUTER / INNER), INNER**2, OUTER**2
    exact = 4 * moment / ((b - a) ** 2 - 4 * a * b * ratio**2) * (2 * b * ratio - b + a)
    assert_covered(result, "hoop", exact, 3.0)
    assert_covered(result, "radial", 0.0, 1.2)


def test_stresses_of_a_thick_shell_under_pressure() -> None:
    """Lamé's cylinder, whose stress at the inner face is 5 % off."""
    pressure = 1e-7
    pressed = {"effect": "pressure", "region": "inner", "pressure": pressure}
    result = hpcinv.run(quarter_cylinder(0.45, pressed, region="x1", fix=["z"]), progress=False)
    exact = pressure * (INNER**2 + OUTER**2) / (OUTER**2 - INNER**2)
    assert_covered(result, "hoop", exact, 1.5)
    assert_covered(result, "radial", -pressure, 1.5)


def test_displacements_of_a_clamped_sheet() -> None:
    """The tip of graded cubic triangles in plane strain (`benchmarks/slabs/plane_strain.py`), fixed at one end."""
    thickness = 0.1
    sheet = job(
        analysis="forward",
        mesh={
            "file": str(ROOT / "meshes" / "sheet.py"),
            "parameters": {"length": 1.0, "width": 0.1, "nx": 16, "ny": 1},
            "shell": {"thickness": thickness},
        },
        material=law(0.3),
        effects=[{"effect": "gravity", "acceleration": [0, 0, -1e-3 * thickness**2 / 1.365], "density": 1.0}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}, *({"region": y, "fix": ["y"]} for y in ("y0", "y1"))],
        quantities=[{"name": "tip", "of": "uz", "at": [1, 0.05, 0]}],
        certificate=ESTIMATE,
    )
    assert_covered(hpcinv.run(sheet, progress=False), "tip", -1.00709e-3, 6.0)


@pytest.mark.parametrize("chunk", [1, 1000])
def test_nearest_points_are_those_of_a_tree(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    points, places = np.random.default_rng(1).random((2, 60, 3))
    monkeypatch.setattr(layer_errors, "_CHUNK", chunk)
    direct = layer_errors._nearest(points, places[:17])
    monkeypatch.setattr(layer_errors, "_DIRECT", 0)
    searched = layer_errors._nearest(points, places[:17])
    assert direct[1].tolist() == searched[1].tolist()
    assert direct[0] == pytest.approx(searched[0], rel=1e-14)
