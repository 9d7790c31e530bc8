"""Closed form of a thick incompressible sphere with a pressure inside, and a job of it.

``b³ - B³ = a³ - A³``, and with ``λ = r/R`` the pressure is ``g(λ_b) - g(λ_a)``, where
``g(λ) = c1 (4/λ + 1/λ⁴) + c2 (2/λ² - 4λ)``.
"""

from typing import Any

from helpers.command_line import NO_CERTIFICATE
from helpers.verification import job

INNER, OUTER, PRESSURE = 1.0, 1.5, 0.2


def carried(A: float, c1: float, c2: float) -> float:
    """Pressure that takes the inner radius from ``A`` to `INNER`."""

    def g(stretch: float) -> float:
        return c1 * (4 / stretch + stretch**-4) + c2 * (2 / stretch**2 - 4 * stretch)

    return g(OUTER / outer_radius(A)) - g(INNER / A)


def outer_radius(A: float) -> float:
    """The outer radius that belongs to an inner one."""
    return float((OUTER**3 - INNER**3 + A**3) ** (1 / 3))


ESTIMATE = NO_CERTIFICATE | {"estimate": True}


def sphere(divisions: int, hexahedra: bool) -> Any:
    """The job of the loaded octant, for its radii at rest and their estimated errors."""
    mesh = {"inner": INNER, "outer": OUTER, "radial": divisions, "along": divisions, "hexahedra": hexahedra}
    return job(
        mesh={"file": "../meshes/thick_sphere.py", "parameters": mesh, "geometry_degree": 2},
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": PRESSURE}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        quantities=[{"name": name, "of": "norm(X, Y, Z)", "on": name, "reduce": "mean"} for name in ("inner", "outer")],
        certificate=ESTIMATE,
    )
