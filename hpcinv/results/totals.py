"""Size, volume, mass and load of the meshed part of a body, and warnings of what looks like a mistake in a unit.

The warnings are not a verdict: bodies of micrometres and strains of 1e-10 exist. They are not lines of the certificate;
``output.unit_warnings: false`` leaves them out.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.units import Dimension, length_symbol, readable
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.job.plausibility import convention, doubtful_moduli, largest_bulk_modulus
from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, quadrature
from hpcinv.mesh.extent import extent
from hpcinv.mesh.regions import BOUNDARY, is_facet_condition
from hpcinv.mesh.source import Floats
from hpcinv.model.field_checks import young_moduli
from hpcinv.physics.effects import Direction, Effect
from hpcinv.solver.equations import Equations

LENGTHS = 1e-3, 10.0
"""Plausible lengths (m) of specimens, organs and parts; a file in mm that is read in m is outside, and vice versa."""
DENSITIES = 10.0, 25_000.0
"""Plausible densities (kg/m³), from aerogels to osmium; numbers in g/cm³ or t/mm³ are below."""
SELF_WEIGHT = 3.0
"""Plausible pressure of the weight over Young's modulus: the softest tissues and gels reach 1 at a size of 0.1 m."""
COMPRESSION = 3.0
"""Plausible load per area over the bulk modulus: at 1 the volume changes by its own size."""
LEAST_STRAIN = 1e-6
"""Largest displacement over the body's size: below, a shape differs by less than any scan resolves.

Weight alone does not show beforehand: bending multiplies its strain by the square of a body's slenderness.
"""

DENSITY = Dimension(length=-3, mass=1)
ACCELERATION = Dimension(length=1, time=-2)

_CHUNK = 50_000  # cells at a time
_ROUNDING = 1e-9  # of the sum of nodal forces: a resultant below is zero
_LEAST_LOAD = float(np.sqrt(np.finfo(float).tiny))  # norms are roots of sums of squares


@dataclass(frozen=True)
class Totals:
    """Totals of the meshed part of a body, in SI: half a body with a plane of symmetry has half the mass.

    Attributes:
        size: sides of the bounding box of the given mesh.
        volume: of the given mesh.
        mass: of that volume; densities by formula or data are sampled. ``None`` if no effect has a density.
        load: resultant of the loads at their full size on the given mesh as it lies, ``None`` if it is not finite.
        weight_strain: pressure of a column of the body's height over Young's modulus of its softest part; ``None``
            without gravity.
        warnings: what looks like a mistake in a unit.
    """

    size: tuple[float, float, float]
    volume: float
    mass: float | None
    load: tuple[float, float, float] | None
    weight_strain: float | None
    warnings: tuple[str, ...] = ()

    def as_data(self) -> dict[str, Any]:
        return asdict(self)

    def warned(self, largest_displacement: float, nominal: Callable[[], float]) -> Self:
        """Return the totals with the warnings that follow from the largest displacement (m) at full load.

        Args:
            nominal: returns the displacement (m) that loads and inelastic strains would cause without balance.
        """
        size = math.hypot(*self.size)
        if not largest_displacement < LEAST_STRAIN * size:
            return self
        expected = nominal()
        if expected > LEAST_STRAIN * size:
            return self
        text = (
            f"the largest displacement is {largest_displacement / size:.1g} of the body's size:"
            " check units of loads, moduli and mesh"
            if expected or largest_displacement
            else "nothing loads the body: state 'effects', or displacements of supports"
        )
        return replace(self, warnings=(*self.warnings, text))


def totals_of(equations: Equations, step: PlannedSolve) -> Totals:
    """Return the totals of the unloaded body in a step, and leave the equations in its unloaded state; collective."""
    job, body, direction = step.job, equations.body, step.direction
    equations.put(equations.unloaded(job))
    comm, length = body.mesh.comm, body.length_scale
    low, high = extent(comm, body.mesh.geometry.x)
    volumes = _cell_volumes(body)
    volume = float(comm.allreduce(float(volumes.sum())))
    # The density of an effect on a surface is a fluid's.
    heavy = [(w, effect) for w, effect in job.named_effects if _has(effect, "density", DENSITY) and not effect.surfaces]
    masses = [_mass(equations, where, effect, volumes) for where, effect in heavy]
    weights = [(e, m) for (_, e), m in zip(heavy, masses, strict=True) if _has(e, "acceleration", ACCELERATION)]
    load, scaled = _resultant(equations, direction)
    totals = Totals(
        size=_triple((high - low) * length),
        volume=volume,
        mass=masses[0] if masses else None,
        load=load,
        weight_strain=None,
    )
    softest, stiffest = young_moduli(job, equations.fields)
    pressure = max((_pressure(equations, effect, mass / volume) for effect, mass in weights), default=None)
    if pressure is not None:
        totals = replace(totals, weight_strain=pressure / softest)
    if not job.output.unit_warnings:
        return totals
    seen = list(_warnings(totals, body.source.unit or job.mesh.unit, masses, pressure, stiffest))
    moduli = list(doubtful_moduli(job))
    if not seen and not moduli:
        moduli += _compressions(job, totals.size, scaled * equations.scales.stress * equations.scales.length**2)
    return replace(totals, warnings=(*_vanishing(scaled), *seen, *moduli, *_regions_without_bounds(job, body)))


def _vanishing(load: float) -> Iterator[str]:
    """Yield a warning if there are loads whose norm is not known, or 0: checks take them for none."""
    if 0.0 < load < _LEAST_LOAD:
        yield (
            f"the loads are {load:.0e} of the shear modulus times length squared, as little as rounding errors:"
            " check units of loads, moduli and mesh"
        )


def _warnings(
    totals: Totals, unit: float, masses: list[float], pressure: float | None, stiffest: float
) -> Iterator[str]:
    longest = max(totals.size)
    if not LENGTHS[0] <= longest <= LENGTHS[1]:
        yield f"the body is {readable(longest, 'm')} long: is mesh.unit ({length_symbol(unit)}) what its mesh is in?"
    for mass in dict.fromkeys(masses):
        density = abs(mass) / totals.volume
        if density and not DENSITIES[0] <= density <= DENSITIES[1]:
            yield f"the mean density is {density:.3g} kg/m^3: is the unit of the density what is meant?"
    if len(masses) > 1 and max(masses) - min(masses) > 1e-6 * max(map(abs, masses)):
        yield f"effects give the body masses of {readable(min(masses), 'kg')} to {readable(max(masses), 'kg')}"
    if pressure is not None and pressure > SELF_WEIGHT * stiffest:
        yield (
            f"a column as high as the body weighs {readable(pressure, 'Pa')}, {pressure / stiffest:.2g} times the"
            " largest Young's modulus: check units of mesh, density and moduli"
        )


def _compressions(job: Job, size: tuple[float, float, float], load: float) -> Iterator[str]:
    """Yield a warning if loads (N, whatever their signs) per area of the body are far above its bulk modulus."""
    bulk = largest_bulk_modulus(job)
    stress = load / (math.prod(size) / min(size))  # on the largest side of the bounding box
    if bulk is not None and math.isfinite(stress) and stress > COMPRESSION * bulk:
        what = "; ".join(dict.fromkeys(text[2:] for law in job.laws.values() if (text := convention(law))))
        yield (
            f"nodal forces of {readable(stress, 'Pa')} per area of the largest side are {stress / bulk:.2g} times the"
            f" bulk modulus of the stiffest part, so that volumes collapse{what and f': {what}'}"
        )


def _regions_without_bounds(job: Job, body: Body) -> Iterator[str]:
    """Yield a warning for each support or load on a region whose condition on the position holds everywhere."""
    used = dict.fromkeys(str(getattr(user, "region", "")) for user in (*job.supports, *job.effects))
    for name in (name for name in used if name in job.regions):
        condition = job.regions[name]
        whole = body.regions[name].facet_count == body.regions[BOUNDARY].facet_count
        if whole and isinstance(condition, Expression) and not is_facet_condition(condition):
            yield (
                f"region '{name}' is the whole boundary: '{condition}' holds all over it"
                " (numbers without a unit are in m)"
            )


def _has(effect: Effect, name: str, dimension: Dimension) -> bool:
    """Return whether an effect has a quantity of this name and dimension."""
    return quantities_of(type(effect)).get(name) == dimension


def _pressure(equations: Equations, effect: Any, density: float) -> float:
    """Return the weight (Pa) of a column as high as the body, along an effect's acceleration."""
    g = np.array(effect.acceleration, dtype=float)
    size = math.hypot(*g)  # without the squares, which overflow
    if not size:
        return 0.0
    heights = equations.body.mesh.geometry.x @ (g / size)
    low, high = extent(equations.body.mesh.comm, np.repeat(heights[:, None], 3, axis=1))
    return abs(density) * size * float(high[0] - low[0]) * equations.body.length_scale


def _mass(equations: Equations, where: str, effect: Any, volumes: Floats) -> float:
    density = equations.fields.samples(effect.density, f"{where}.density").mean(axis=1)
    each = np.broadcast_to(density, (len(volumes),)) if len(density) == 1 else density[: len(volumes)]
    return float(equations.body.mesh.comm.allreduce(float(each @ volumes)))


def _cell_volumes(body: Body) -> Floats:
    """Return the volumes (m³) of the owned cells, exact for straight and curved ones."""
    kind, degree = body.source.kind, body.degree
    points, weights = quadrature(kind, 3 * degree)
    cells = body.mesh.geometry.dofmaps[0][: body.mesh.topology.index_map(3).size_local]
    volumes: Floats = np.zeros(len(cells))
    for start in range(0, len(cells), _CHUNK):
        nodes = body.mesh.geometry.x[cells[start : start + _CHUNK]]
        volumes[start : start + _CHUNK] = np.abs(np.linalg.det(jacobians(kind, degree, nodes, points))) @ weights
    return volumes * body.length_scale**3


def _resultant(equations: Equations, direction: Direction) -> tuple[tuple[float, float, float] | None, float]:
    """Return the resultant (N) of all loads: their virtual work along translations of the unloaded body; collective.

    Also return the largest sum of their nodal forces along an axis, whatever their signs are, scaled.
    """
    unknowns, comm = equations.unknowns, equations.body.mesh.comm
    equations.unload()
    equilibrium = equations.equilibrium(equations.weak_form(direction))
    system, contacts = equilibrium.system, equilibrium.system.weak_form.contacts
    forces, response = system.forces(0.0), contacts.response()
    forces -= system.forces(1.0)
    response -= contacts.response()
    resultant, total = np.zeros(3), np.zeros(3)
    dofs = unknowns.owned_displacement_dofs.reshape(-1, 3)
    for axis in range(3):
        work = np.zeros_like(forces)
        work[dofs[:, axis]] = forces[dofs[:, axis]]
        resultant[axis], total[axis] = comm.allreduce(work.sum()), comm.allreduce(np.abs(work).sum())
    resultant += response  # the response of an obstacle that has travelled on is not a load
    equations.put_load(0.0)
    equations.release(equilibrium)
    if not np.isfinite(total).all():
        return None, math.inf
    resultant[np.abs(resultant) <= _ROUNDING * total.max()] = 0.0
    return _triple(resultant * equations.scales.stress * equations.scales.length**2), float(total.max())


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
