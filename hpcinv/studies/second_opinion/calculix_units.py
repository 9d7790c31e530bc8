"""Units in which the absolute limits of CalculiX 2.20 do not count.

It refuses cells below 1e-20 cubed units of length, takes compliances of a law below 1e-10 for 0, and a largest residual
force below 1e-6 for 0, whatever tolerance is asked for. A soft body of a few grams has less than that at each node if
forces are in N: CalculiX ends too early, and where a body is about to buckle its displacement then differs by a half.
"""

from __future__ import annotations

import numpy as np

from hpcinv.base.quantity.spatial_fields import is_uniform
from hpcinv.physics.materials import MaterialLaw
from hpcinv.studies.second_opinion.loaded_body import LoadedBody
from hpcinv.studies.second_opinion.nodal_forces import cell_forces, facet_forces
from hpcinv.studies.second_opinion.units import Units

_SIZE = 1e3
"""Size of a body in its deck, at least. Much raised, the volumes of its cells are too large for single precision."""
_BULK = 1e5
"""Largest bulk modulus in a deck, at least, in units of stress. Raised, rounding errors count as residual forces;
lowered, CalculiX ends at a larger residual."""

_NO_RESIDUAL, _SMALL = 1e-6, 1e-4
"""Residual force, in its units, that CalculiX takes for 0; and relative to a load, the largest that does not matter."""


def fitting_units(body: LoadedBody) -> Units:
    """Return powers of ten that fit the size and the largest bulk modulus of a body."""
    length = _power_below(float(np.ptp(body.rest.points, axis=0).max()) / _SIZE)
    return Units(length, _power_below(max(map(_bulk_modulus, body.laws.values())) * length**2 / _BULK))


def coarse_residual(body: LoadedBody, units: Units) -> str | None:
    """Return a note if the residual force that CalculiX takes for 0 is not small, compared to the loads of a body."""
    load = _mean_load(body)
    if not load or units.force * _NO_RESIDUAL <= _SMALL * load:
        return None
    return (
        f"CalculiX takes residual forces below {_NO_RESIDUAL:g} units of force for 0, and a node carries"
        f" {load / units.force:.1g} units on average: give a smaller unit, such as --force-unit uN"
    )


def _mean_load(body: LoadedBody) -> float:
    """Return the force at a node, N, by the sum of the sizes of all loads."""
    rest, along_x = body.rest, np.array([1.0, 0.0, 0.0])
    sizes = [float(np.linalg.norm(body.forces, axis=1).sum())]
    sizes += [float(np.linalg.norm(remote.force)) for remote in body.remotes]
    if weight := body.density * float(np.linalg.norm(body.acceleration)):
        sizes.append(weight * float(cell_forces(rest, rest.points, along_x).sum()))
    for group, pressure in body.pressures:
        facets = rest.facets[group.members]
        sizes.append(abs(pressure) * float(facet_forces(rest, rest.points, facets, along_x).sum()))
    return sum(sizes) / len(rest.points)


def _power_below(value: float) -> float:
    return float(10.0 ** np.floor(np.log10(value)))


def _bulk_modulus(law: MaterialLaw) -> float:
    """Return the bulk modulus (Pa) of a law that is the same everywhere and compressible; others have no card."""
    if law.is_incompressible or not all(is_uniform(value) for value, _ in law.quantities().values()):
        return 1.0
    young, poisson = law.young_and_poisson()
    return young / (3 * (1 - 2 * poisson))
