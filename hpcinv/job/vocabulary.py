"""Names and dimensions that formulas, regions and quantities of a job may use."""

from typing import Literal

from hpcinv.base.quantity.stress_measures import COMPONENTS, MEASURES, PRESTRAIN_COMPONENTS, PRESTRAIN_STRESSES
from hpcinv.base.quantity.units import Dimension

type AxisName = Literal["x", "y", "z"]
AXES: tuple[AxisName, ...] = ("x", "y", "z")
LENGTH = Dimension(length=1)
CUBIC = Dimension(length=3)
COORDINATES: dict[str, Dimension | None] = dict.fromkeys(AXES, LENGTH)
POSITIONS = COORDINATES | dict.fromkeys(("X", "Y", "Z", "ux", "uy", "uz"), LENGTH)
FITTED_SURFACES = ("sphere", "cylinder")
REGION_NAMES = COORDINATES | dict.fromkeys(("nx", "ny", "nz", "cavity"), Dimension())
"""what conditions of regions may use: position, outer normal, and the number of a cavity"""
STRESS = Dimension(length=-1, mass=1, time=-2)
STRESSES = (*COMPONENTS, *MEASURES, "energy")
NORMALS = ("nx", "ny", "nz")
FIELDS: dict[str, Dimension | None] = {
    "J": Dimension(),
    **dict.fromkeys(STRESSES, STRESS),
    **dict.fromkeys(NORMALS, Dimension()),
    **dict.fromkeys(PRESTRAIN_STRESSES, STRESS),
    **dict.fromkeys(PRESTRAIN_COMPONENTS, Dimension()),
}
CONTACTS = {"contact_force": "N", "contact_area": "m^2", "contact_penetration": "m"}
CAVITY_QUANTITIES = {"volume": CUBIC, "pressure": STRESS}
"""quantities of cavities with their dimensions"""
REACTIONS = {"reaction": "N", "reaction_moment": "N m", **CONTACTS}
