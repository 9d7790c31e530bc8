"""The jobs of the benchmark set: a slender beam and a chunky block, of about as many unknowns as are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

type JobData = Mapping[str, Any]

_HERE = Path(__file__).resolve().parent
MESHES = _HERE / "meshes" if (_HERE / "meshes").is_dir() else _HERE.parents[1] / "meshes"
"""The copy in an installed package, or the directory ``meshes`` of a clone."""

WITHOUT_CERTIFICATE = {"round_trip": "off", "stability": False, "estimate": False, "overlap": False}

_BEAM_SIZE, _BEAM_UNKNOWNS = 2.2e-3, 32_528  # m; of jobs/pdms-beam.yaml
_CURVED, _COARSEST = 4e-3, 8.5e-3  # m; larger cells cannot follow the curved side, or have no room


def beam(unknowns: int, **changes: Any) -> JobData:
    """The silicone beam of Mazier et al. (2022), doi:10.1007/s00366-021-01597-z, under its own weight; mixed form."""
    size = min(_BEAM_SIZE * (_BEAM_UNKNOWNS / unknowns) ** (1 / 3), _COARSEST)
    degree = 2 if size <= _CURVED else 1
    mesh = {"file": str(MESHES / "pdms_beam.py"), "parameters": {"size": round(size, 6)}, "geometry_degree": degree}
    return {
        "job": "beam",
        "mesh": mesh,
        "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
        "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
        "checkpoint": {"every": 0},
        "output": {"fields": False, "mesh": []},
        **changes,
    }


def block(unknowns: int, **changes: Any) -> JobData:
    """A cube of the same silicone, 1 m high, which stands on its clamped bottom under its own weight; mixed form."""
    divisions = min(range(1, 100), key=lambda n: abs(block_unknowns(n) - unknowns))
    parameters = dict.fromkeys(("nx", "ny", "nz"), divisions)
    return {
        **beam(unknowns),
        "job": "block",
        "mesh": {"file": str(MESHES / "box.py"), "parameters": parameters},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 963}],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        **changes,
    }


def block_unknowns(divisions: int) -> int:
    """Quadratic displacements and linear pressures of a block of n × n × n bricks."""
    return int(3 * (2 * divisions + 1) ** 3 + (divisions + 1) ** 3)


BODIES: Mapping[str, Callable[..., JobData]] = {"beam": beam, "block": block}
