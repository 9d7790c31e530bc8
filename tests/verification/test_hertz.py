"""Two elastic bodies that press on each other, next to Hertz' pressure between a cylinder and a block.

Plane strain, half of the width: a strip whose lower face is a parabola of radius R lies on a flat one. For a force P
per length, ``1/E* = (1 - ν₁²)/E₁ + (1 - ν₂²)/E₂``, ``a² = 4 P R/(π E*)`` and ``p₀ = 2 P/(π a)`` (Johnson, Contact
Mechanics, 1985, section 4.2). With n cells along a, linear pressures end within one cell of a: the width has an error
of at most 1/n. The lost rim of width a/n has a share ``(2/n)^1.5 · 4/(3π)`` of P; the rest is too high by this share.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

WIDTH = 0.02  # along the cylinder


def pressed(
    comm: MPI.Intracomm, cells: int, radius: float, moduli: tuple[float, float], down: float, **data: Any
) -> tuple[float, float, float, float]:
    """Return the largest pressure and half the contact's width over Hertz' ones, the latter over a cell, and p₀."""
    shape = {"lower_height": 1.0, "upper_height": 1.0, "ly": WIDTH, "across": 1, "gap": 1e-9}
    shape |= {"crown": 1 / (2 * radius), "cylinder": True}
    mesh = {"lower": cells, "upper": cells + 3, "layers": max(4, cells // 2), "hexahedra": True} | data.pop("mesh", {})
    lower, upper = ({"law": "neo-hookean", "young": modulus, "poisson": 0.3} for modulus in moduli)
    given: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {"file": "../meshes/two_blocks.py", "parameters": shape | mesh},
        "material": {"lower": lower, "upper": upper},
        "discretisation": {"displacement": 1},
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
            {"region": "y1", "fix": ["y"]},
            {"region": "z0", "fix": ["x", "z"]},
            {"region": "z1", "displacement": [0, None, -down]},
        ],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}],
    }
    contact = hpcinv.run(job(**given | data), comm).solutions[0].contacts[0]
    stiffness = 1 / sum((1 - 0.3**2) / modulus for modulus in moduli)
    force = 2 * abs(contact.force[2]) / WIDTH
    half = np.sqrt(4 * force * radius / (np.pi * stiffness))
    largest = 2 * force / (np.pi * half)
    assert 2 / cells < half < 0.4
    return contact.largest_pressure / largest, contact.area / WIDTH / half, half * cells, largest


def bound(cells: float) -> float:
    """Return the error of the pressure by the rim of one cell at the end of the contact."""
    return float((2 / cells) ** 1.5 * 4 / (3 * np.pi))


@pytest.mark.release
def test_cylinder_on_a_block_has_the_pressure_of_hertz(comm: MPI.Intracomm) -> None:
    pressure, width, cells, _ = pressed(comm, 12, 25.0, (1.0, 1.0), 0.003)
    assert pressure == pytest.approx(1.0, abs=bound(cells))
    assert width == pytest.approx(1.0, abs=1 / cells)


@pytest.mark.release
def test_pressure_of_hertz_is_approached_on_finer_meshes(comm: MPI.Intracomm) -> None:
    """On still finer meshes 3 % remain: the bodies are 3.7 a high and wide, and Hertz' are half-spaces."""
    errors = [abs(pressed(comm, n, 25.0, (1.0, 1.0), 0.003)[0] - 1) for n in (8, 12, 20)]
    assert errors[0] > 1.3 * errors[1] > 1.3**2 * errors[2]
    assert errors[2] < 0.04


RADIUS, LOAD = 0.05, 35e6  # m, N/m


def nafems(
    comm: MPI.Intracomm, cells: int, down: float, fine: float = 0.008, friction: float = 0.0
) -> tuple[float, float, float]:
    """Press NAFEMS' aluminium cylinder on its steel block (CGS-1).

    Reference: Konter, Advanced finite element contact benchmarks, NAFEMS 2006, benchmark 1: 35 kN per mm of length give
    3,585 MPa over a half width of 6.21 mm. Its friction is 0.1.

    Returns:
        Largest pressure (Pa) and half width (m), scaled to 35 kN/mm as Hertz' are; cells along half of the contact.
    """
    moduli, thickness = {"cylinder": 70e9, "block": 210e9}, 0.001
    given: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {"file": "../meshes/cylinder_on_block.py", "parameters": {"fine": fine, "divisions": cells}},
        "material": {name: {"law": "neo-hookean", "young": E, "poisson": 0.3} for name, E in moduli.items()},
        "discretisation": {"displacement": 1},
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
            {"region": "y1", "fix": ["y"]},
            {"region": "z0", "fix": ["x", "z"]},
            {"region": "z1", "displacement": [0, None, -down]},
        ],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact", "friction": friction}],
    }
    contact = hpcinv.run(job(**given), comm).solutions[0].contacts[0]
    scale = np.sqrt(LOAD * thickness / (2 * abs(contact.force[2])))
    half = contact.area / thickness
    print(f"NAFEMS CGS-1: {contact.largest_pressure * scale / 1e6:.0f} MPa, {half * scale * 1e3:.2f} mm")
    return contact.largest_pressure * scale, half * scale, half * cells / fine


def test_half_of_the_load_of_nafems_presses_as_hertz_found(comm: MPI.Intracomm) -> None:
    """On a coarse mesh; the first load step fails, and what follows begins without the pressure of its prediction."""
    pressure, width, cells = nafems(comm, 8, 0.0007)
    assert pressure == pytest.approx(3585e6, rel=bound(cells))
    assert width == pytest.approx(6.21e-3, rel=1 / cells)


@pytest.mark.release
def test_cylinder_of_nafems_has_its_pressure_and_width(comm: MPI.Intracomm) -> None:
    """Hertz' bodies are half-spaces, and strains small: that leaves 2 % where a is R/8, on meshes of 8 to 20 cells.

    It is of the order of a²/R² = 1.6 % and p₀/E* = 6 %, and falls with the load.
    """
    pressure, width, cells = nafems(comm, 12, 0.00114)
    assert pressure == pytest.approx(3585e6, rel=bound(cells))
    assert width == pytest.approx(6.21e-3, rel=1 / cells)
    smaller, narrower, cells = nafems(comm, 12, 0.00011, fine=0.002)  # a sixteenth of the load, a quarter of the width
    assert abs(smaller / 3585e6 - 1) < 0.5 * abs(pressure / 3585e6 - 1)
    assert narrower == pytest.approx(6.21e-3, rel=1 / cells)


@pytest.mark.release
def test_friction_raises_the_pressure_of_the_cylinder_of_nafems(comm: MPI.Intracomm) -> None:
    """Most of the surface slides: tractions of at most 0.1 p change the pressure by less than that.

    The first load step fails in both ways of friction; what follows begins without the pressure of its prediction.
    """
    smooth, rough = nafems(comm, 8, 0.00114), nafems(comm, 8, 0.00114, friction=0.1)
    assert 1.0 < rough[0] / smooth[0] < 1.1
    assert rough[1] == pytest.approx(6.21e-3, rel=1 / rough[2])


def pressed_by_a_ball(comm: MPI.Intracomm, cells: int, radius: float, down: float) -> tuple[float, float, float]:
    """Press a quarter of a ball's cap on a quarter of a block of the same material, both 1 m wide and high.

    For equal moduli ``a³ = 3 P R (1 - ν²)/(2 E)`` and ``p₀ = 3 P/(2π a²)`` (Johnson, Contact Mechanics, 1985, 4.2).

    Returns:
        Largest pressure and radius of the contact over Hertz' ones; and cells along the radius.
    """
    modulus, focus = 1.0, 0.3
    shape = {"lower_height": 1.0, "upper_height": 1.0, "gap": 1e-9, "crown": 1 / radius, "focus": focus}
    law = {"law": "neo-hookean", "young": modulus, "poisson": 0.3}
    given: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {
            "file": "../meshes/two_blocks.py",
            "parameters": {"lower": cells, "upper": cells, "layers": cells, "hexahedra": True} | shape,
        },
        "material": law,
        "discretisation": {"displacement": 1},
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
            {"region": "z0", "fix": ["z"]},
            {"region": "z1", "displacement": [None, None, -down]},
        ],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}],
    }
    contact = hpcinv.run(job(**given), comm).solutions[0].contacts[0]
    force = 4 * abs(contact.force[2])
    half = (3 * force * radius * (1 - 0.3**2) / (2 * modulus)) ** (1 / 3)
    largest = 3 * force / (2 * np.pi * half**2)
    found = contact.largest_pressure / largest, float(np.sqrt(4 * contact.area / np.pi)) / half
    print(f"ball on a block, {cells} cells: p0 {found[0]:.4f}, a {found[1]:.4f} of Hertz', a = {half:.3f} m")
    shares = np.linspace(0, 1, cells + 1)  # of the ball, whose cells have the pressures
    along = shares * (focus + (1 - focus) * shares**7)
    return *found, float(np.interp(half, along, np.arange(cells + 1)))


def test_a_ball_on_a_block_presses_nearly_as_hertz_found(comm: MPI.Intracomm) -> None:
    """With three cells along the radius, the pressure at their ends is a sixth too high."""
    pressure, radius, cells = pressed_by_a_ball(comm, 6, 5.0, 0.006)
    assert pressure == pytest.approx(1.0, abs=0.25)
    assert radius == pytest.approx(1.0, abs=1 / cells)


@pytest.mark.release
def test_a_ball_on_a_block_has_the_pressure_of_hertz(comm: MPI.Intracomm) -> None:
    """Bodies of Hertz are half-spaces; these are 6 a high and wide."""
    coarse, fine = (pressed_by_a_ball(comm, cells, 5.0, 0.006) for cells in (8, 12))
    assert coarse[0] == pytest.approx(1.0, abs=0.03)
    assert fine[0] == pytest.approx(1.0, abs=0.02)
    assert abs(fine[1] - 1) < 0.75 * abs(coarse[1] - 1)
    assert fine[1] == pytest.approx(1.0, abs=0.5 / fine[2])
