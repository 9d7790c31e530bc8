"""Bodies on which linear solvers are compared."""

from typing import Any

from helpers.silicone_beam import beam
from helpers.verification import box

MATERIALS: dict[str, dict[str, Any]] = {
    "compressible": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "nearly incompressible": {"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": 5e6},
    "incompressible": {"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": "incompressible"},
}
SHELF: dict[str, Any] = {
    "mesh": box((2, 2, 2)),
    "effects": [{"effect": "gravity", "acceleration": [0, -1.0, 0], "density": 600}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
BEAM = beam()
