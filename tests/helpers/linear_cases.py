"""Bodies on which linear solvers are compared."""

from typing import Any

from helpers.verification import box

MATERIALS: dict[str, dict[str, Any]] = {
    "compressible": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "nearly incompressible": {"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": 5e6},
    "incompressible": {"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": "incompressible"},
}
SHELF: dict[str, Any] = {
    "mesh": box((3, 3, 3)),
    "effects": [{"effect": "gravity", "acceleration": [0, -1.0, 0], "density": 600}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
BEAM: dict[str, Any] = {
    "mesh": {"file": "../meshes/pdms_beam.py", "parameters": {"size": "4 mm"}, "geometry_degree": 2},
    "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
    "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
    "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
}
