"""Shells that benchmarks solve on coarse and fine meshes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.readers import read_surface
from hpcinv.mesh.source import Floats, MeshSource

sys.path[:0] = [str(Path(__file__).parents[1] / "tests")]

from helpers.sheets import save_sphere_octant, sheet  # noqa: E402

type Map = Callable[[Floats, Floats], list[Floats]]

LAW = {"law": "neo-hookean", "young": 1e6, "poisson": 0.3}
LINEAR = {"law": "st-venant-kirchhoff", "young": 1.2e6, "poisson": 0.0}
CLAMPED = {"region": "x0", "fix": ["x", "y", "z"]}
_BALLOON = 0.05, 1.2  # thickness of a unit sphere, stretch of its inner face


@dataclass(frozen=True)
class Scene:
    """A shell on a map of the unit square, ``wide`` cells for each cell along the second axis.

    Attributes:
        job: without mesh; quantity ``q`` is compared.
        shell: section of the mesh.
        surface: its surface of n cells, instead of the map.
        exact: values of quantities in closed form.
    """

    place: Map
    wide: int
    shell: Mapping[str, Any]
    job: Mapping[str, Any]
    surface: Callable[[Path, int], MeshSource] | None = None
    exact: Mapping[str, float] = field(default_factory=dict)

    def save(self, path: Path, n: int) -> MeshSource:
        """Write and return its surface of n cells along the first axis."""
        if self.surface is not None:
            return self.surface(path, n)
        rows = max(n // self.wide, 1)
        source = sheet(path, n, rows, lambda s, t: np.column_stack(self.place(s, t)))
        save_msh(path, source, source.points)
        return source

    def as_job(self, path: Path) -> dict[str, Any]:
        """Return the job on the surface in a file."""
        return {"material": LAW, **self.job, "mesh": {"file": str(path), "shell": dict(self.shell)}}


def _flat(length: float, width: float) -> Map:
    return lambda s, t: [length * s, width * t, 0 * s]


def _bellows(s: Floats, t: Floats) -> list[Floats]:
    radius = 1 + 0.15 * np.cos(2 * np.pi * s)
    return [radius * np.cos(np.pi / 2 * t), radius * np.sin(np.pi / 2 * t), 0.5 * s]


def _vessel(s: Floats, t: Floats) -> list[Floats]:
    return [np.cos(np.pi / 2 * s), np.sin(np.pi / 2 * s), t]


def _outer_stretch(radius: float) -> float:
    """Stretch of an incompressible unit sphere at a radius, by the stretch of its inner face."""
    thickness, stretch = _BALLOON
    inner = 1 - thickness / 2
    return float((radius**3 + (stretch**3 - 1) * inner**3) ** (1 / 3) / radius)


def _balloon_pressure(modulus: float) -> float:
    there, back = (1 / (2 * s**4) + 2 / s for s in (_BALLOON[1], _outer_stretch(1 + _BALLOON[0] / 2)))
    return modulus * (back - there)


SCENES = {
    "sagging sheet": Scene(
        _flat(1, 0.6),
        2,
        {"thickness": 0.01},
        {
            "analysis": "inverse",
            "effects": [
                {"effect": "gravity", "density": 1000, "acceleration": [0, 0, -0.05], "density_in": "reference"}
            ],
            "supports": [CLAMPED],
            "quantities": [{"name": "q", "of": "uz", "at": [1, 0.3, 0]}],
        },
    ),
    "pinched ring": Scene(
        lambda s, t: [np.sin(np.pi / 2 * s), 0.2 * t, np.cos(np.pi / 2 * s)],
        4,
        {"thickness": 0.01},
        {
            "analysis": "forward",
            "effects": [{"effect": "traction", "region": "x0", "traction": [0, 0, -20], "area_in": "reference"}],
            "supports": [
                {"region": "x0", "fix": ["x"]},
                {"region": "x1", "fix": ["z"]},
                {"region": "y0", "fix": ["y"]},
            ],
            "quantities": [{"name": "q", "of": "uz", "at": [0, 0, 1]}],
        },
    ),
    "inflated bellows": Scene(
        _bellows,
        2,
        {"thickness": 0.01},
        {
            "analysis": "inverse",
            "effects": [{"effect": "pressure", "region": "inner", "pressure": 40}],
            "supports": [
                CLAMPED,
                {"region": "y0", "fix": ["y"]},
                {"region": "y1", "fix": ["x"]},
            ],
            "quantities": [{"name": "q", "of": "uz", "on": "x1", "reduce": "mean", "over": "current"}],
        },
    ),
    "vessel with fibres": Scene(
        _vessel,
        1,
        {"thickness": 0.1},
        {
            "analysis": "inverse",
            "material": {
                "law": "holzapfel-gasser-ogden",
                "mu": 3e4,
                "k1": 2e4,
                "k2": 1.0,
                "dispersion": 0.1,
                "kappa": "incompressible",
            },
            "fibres": {
                f"fibre{number}": {"direction": ["-0.8*Y", "0.8*X", f"{sign}0.6*norm(X, Y)"], "given_on": "reference"}
                for number, sign in ((1, ""), (2, "-"))
            },
            "effects": [{"effect": "pressure", "region": "inner", "pressure": 3e3}],
            "supports": [
                {"region": "x0", "fix": ["y"]},
                {"region": "x1", "fix": ["x"]},
                {"region": "y0", "fix": ["x", "y", "z"]},
                {"region": "y1", "fix": ["z"]},
            ],
            "quantities": [{"name": "q", "of": "ux", "at": [1, 0, 1]}],
        },
    ),
    "cantilever of Sze et al.": Scene(
        _flat(10, 1),
        8,
        {"thickness": 0.1},
        {
            "analysis": "forward",
            "material": LINEAR,
            "effects": [{"effect": "traction", "region": "x1", "traction": [0, 0, 40], "area_in": "reference"}],
            "supports": [CLAMPED],
            "quantities": [{"name": "q", "of": "uz", "at": [10, 0.5, 0]}],
        },
    ),
    "bimetal strip": Scene(
        _flat(10, 0.4),
        100,
        {"thickness": 0.1, "layers": {"bottom": 0.5, "top": 1}},
        {
            "analysis": "forward",
            "material": {"bottom": LINEAR | {"young": 2.4e6}, "top": LINEAR},
            "effects": [
                {
                    "effect": "thermal-expansion",
                    "coefficient": {"bottom": 2e-5, "top": 1e-5},
                    "temperature_change": 1000,
                }
            ],
            "supports": [
                {"region": "x0", "fix": ["x", "z"]},
                {"region": "y0", "fix": ["y"]},
                {"region": "y1", "fix": ["y"]},
            ],
            "quantities": [{"name": "q", "of": "uz", "at": [10, 0.2, 0]}],
        },
    ),
    "balloon": Scene(
        _flat(1, 1),
        1,
        {"thickness": _BALLOON[0]},
        {
            "analysis": "forward",
            "material": {"law": "isochoric-neo-hookean", "mu": 1e5, "kappa": "incompressible"},
            "effects": [{"effect": "pressure", "region": "inner", "pressure": _balloon_pressure(1e5)}],
            "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            "quantities": [{"name": "q", "of": "ux", "at": [1, 0, 0]}],
        },
        lambda path, n: read_surface(save_sphere_octant(path, max(n // 4, 1))),
        {"q": _outer_stretch(1.0) - 1},
    ),
}
"""Lengths in m, stresses in Pa."""
