"""Jobs as a user writes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hpcinv.job.job import Job

GENERATOR = """
from hpcinv.base.quantity import Length
def build(gmsh, *, length: Length = 0.182, size: Length = 2e-3) -> None: ...
"""
BEAM = """
mesh: {file: ../meshes/beam.py, parameters: {size: 2 mm}, geometry_degree: 2}
material: {law: mooney-rivlin, c1: 101709.668 Pa, c2: 151065.460 Pa, d1: 7.965272689e8 Pa}
effects:
  - {effect: gravity, acceleration: [0, -9.81, 0], density: 963 kg/m^3, density_in: current}
supports:
  - {region: clamp, fix: [x, y, z]}
"""

type Edit = Callable[[dict[str, Any]], object]
type Loader = Callable[..., Job]
