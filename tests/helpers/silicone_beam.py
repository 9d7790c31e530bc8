"""The silicone beam of Mazier et al. 2022 (doi:10.1007/s00366-021-01597-z): its numbers in SI units, and its job."""

from __future__ import annotations

from typing import Any

LENGTH, DIAMETER = 0.182, 0.0085
C1, C2, D1, DENSITY, GRAVITY = 101709.668, 151065.460, 7.965272689e8, 963.0, 9.81
MATERIAL: dict[str, Any] = {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": D1}
CLAMP: dict[str, Any] = {"region": "clamp", "fix": ["x", "y", "z"]}
SIZE = "5.5 mm"
"""Size of the cells, the largest of a few whose curved cells are valid."""
TIP: dict[str, Any] = {"name": "tip", "of": "norm(ux, uy, uz)", "at": [LENGTH, 0, 0]}


def weight(load: float = 1.0) -> dict[str, Any]:
    """The weight of the lying beam, times a load."""
    return {"effect": "gravity", "acceleration": [0, -GRAVITY * load, 0], "density": DENSITY}


def beam(size: str = SIZE, geometry_degree: int = 2, load: float = 1.0) -> dict[str, Any]:
    """Mesh, material, weight and clamp of a job in a directory next to ``meshes/``."""
    return {
        "mesh": {
            "file": "../meshes/pdms_beam.py",
            "parameters": {"size": size},
            "geometry_degree": geometry_degree,
        },
        "material": MATERIAL,
        "effects": [weight(load)],
        "supports": [CLAMP],
    }


def sagging(size: str, degree: int, certificate: dict[str, Any], geometry_degree: int = 2) -> dict[str, Any]:
    """A forward job with the displacement of the tip as a quantity."""
    return {
        "analysis": "forward",
        **beam(size, geometry_degree),
        "quantities": [TIP],
        "discretisation": {"displacement": degree},
        "certificate": certificate,
    }
