"""Cavities of a job on a body, and the equations of those whose pressure is unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np
from dolfinx.mesh import entities_to_geometry
from petsc4py import PETSc

from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.base.quantity.schema import KeyPath
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.cavities import Cavity
from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.enclosed_volume import EnclosedVolume
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.constraint_report import CavityReport
from hpcinv.model.weak_form import WeakForm

_UNEVEN = 0.1
"""Height of a rim over its plane, relative to √area, that is warned of; a larger one passes rims of symmetric parts."""
_EMPTY = 1e-9
"""Volume of a cavity, relative to its body's length cubed, that counts as 0; raised, thin gaps hold no gas."""


def enclosed_volume(job: Job, body: Body, name: str) -> EnclosedVolume:
    """Return a cavity of a job on a body, made once; collective.

    Raises:
        MeshError: on all ranks, if its regions do not enclose a cavity.
    """
    cavity = job.cavities[name]
    key = f"cavity {cavity.regions!r} {cavity.apex!r}"
    if key not in body.computed:
        with naming_field(f"cavities.{name}"):
            body.computed[key] = EnclosedVolume(body, list(cavity.regions), cavity.apex)
    enclosed: EnclosedVolume = body.computed[key]
    return enclosed


def check_cavities(job: Job, body: Body) -> list[str]:
    """Check that the regions of all cavities of a job enclose cavities; return warnings; collective.

    Raises:
        MeshError: on all ranks, if they do not.
    """
    warnings = []
    for places, names in [("cavities", job.controlled_cavities), *_controlled_in_states(job)]:
        _check_apart(job, body, places, list(names))
    for name, cavity in job.cavities.items():
        if cavity.lid_region is not None and not _touch(body, cavity.surface, cavity.lid_region):
            raise MeshError(
                f"{body.source.path}: cavities.{name}.lid: '{cavity.lid_region}' does not touch the cavity's surface",
                "Name the region that closes an opening of the surface, or leave out 'lid' for a planar one.",
            )
        enclosed = enclosed_volume(job, body, name)
        empty = _EMPTY * diagonal(body.mesh.comm, body.given_nodes) ** 3
        if cavity.gas is not None and abs(enclosed.volume(body.given_nodes)) < empty:
            raise MeshError(
                f"{body.source.path}: cavities.{name}.gas: its surface encloses no volume, so that there is no gas",
                "Give the loaded 'volume' of the cavity, or its pressure.",
            )
        if cavity.apex is None and enclosed.unevenness(body.given_nodes) > _UNEVEN:
            warnings.append(
                f"cavities.{name}: the rim of an opening is far from a plane, and its lid is a cone:"
                " a part of a symmetric body needs 'lid: {apex: [x, y, z]}'"
            )
    return warnings


def _controlled_in_states(job: Job) -> Iterator[tuple[str, list[str]]]:
    """Yield the cavities of unknown pressure of each state, with their place in the job."""
    for number, state in enumerate(job.states):
        key = "unloaded_volumes" if state.given else "volumes"
        yield f"states[{number}].{key}", [name for name in job.cavities if name in state.controlled]


def _check_apart(job: Job, body: Body, place: str, names: Sequence[str]) -> None:
    """Raise ``MeshError`` on all ranks for two cavities of unknown pressure on one facet."""
    facets = {name: [body.boundary_facets(region) for region in job.cavities[name].regions] for name in names}
    for i, name in enumerate(names):
        for other in names[:i]:
            shared = np.intersect1d(np.concatenate(facets[name]), np.concatenate(facets[other]))
            if body.mesh.comm.allreduce(len(shared)):
                raise MeshError(
                    f"{body.source.path}: {place}: the unknown pressures of '{other}' and '{name}' act on one surface",
                    "Give the volume of one of them, or give each its own surface.",
                )


def _touch(body: Body, surface: Sequence[str], lid: str) -> bool:
    """Return whether the facets of a lid have a node of a cavity's surface; collective."""

    def nodes(names: Sequence[str]) -> Ints:
        facets = np.concatenate([body.facets(name) for name in names])
        local = entities_to_geometry(body.mesh, 2, facets).ravel() if len(facets) else np.zeros(0, np.int32)
        parts = body.mesh.comm.allgather(np.unique(body.mesh.geometry.index_map().local_to_global(local)))
        return np.unique(np.concatenate(parts))

    return bool(len(np.intersect1d(nodes(surface), nodes([lid]))))


class CavityEquation:
    """The equation ``C(x, q, λ) = 0`` of one cavity for its unknown pressure ``q``, in scaled quantities.

    With volumes V₀ of the unloaded and V of the loaded body, and V_m of the body of the mesh, which is one of them,

        C = V - V_m - λ (given - V_m),   or the same of V₀ in inverse problems,
        C = (q + a) V / a - (1 + λ (n - 1)) V₀ of a gas at the ambient pressure a, whose amount grows n-fold,
        C = V - V_m - λ (V_c - V_m) + c (q - λ p_c) of a windkessel of compliance c, whose pressure is p_c at V = V_c.

    Args:
        target_volume: volume (m³) of the unknown body, if the cavity has a given volume.

    Attributes:
        number: the pressure, scaled.
        unit: SI value of a scaled unit of it.
    """

    def __init__(
        self, name: str, job: Job, body: Body, weak_form: WeakForm, scales: Scales, target_volume: float | None
    ) -> None:
        self.name, self._body, self._weak_form, self._scales = name, body, weak_form, scales
        self._cavity: Cavity = job.cavities[name]
        self._enclosed = enclosed_volume(job, body, name)
        self._mesh_volume = self._enclosed.volume(body.nodes)
        self._target_volume = None if target_volume is None else target_volume / scales.length**3
        first = len(job.laws)
        self._places = [first + i for i in job.cavity_effects(name)]
        self.number, self.unit = 0.0, scales.stress

    def numbers(self) -> list[tuple[int, str, float]]:
        """Return places, name and value (scaled) of the pressure; forces are in proportion to the present load factor.

        Unknown pressures belong to the first load case.
        """
        load = float(self._weak_form.parameters.constant.value[0])
        return [(place, "pressure", self.number / load) for place in self._places]

    def on_mesh(self) -> CavityEquation:
        """Return the equation on the mesh as it lies now; collective."""
        moved = copy(self)
        moved._mesh_volume = self._enclosed.volume(self._body.nodes)
        return moved

    def value(self, load: float) -> float:
        """Return C at the present state; collective."""
        return self.evaluate(load)[0]

    def linearise(self, load: float, b: PETSc.Vec) -> float:
        """Set ``b`` to the derivative of C by the state, and return the derivative by the pressure; collective."""
        _, by_volume, by_pressure = self.evaluate(load)
        self.slope(b)
        b.scale(by_volume)
        return by_pressure

    def volume(self) -> float:
        """Return the volume (m³) in the unknown body at the present state; collective."""
        return self._enclosed.volume(self._nodes())

    def report(self, load: float) -> CavityReport:
        """Return the report of the present state; collective."""
        unloaded, loaded = self._weak_form.kinematics.reference_and_current(self._mesh_volume, self.volume())
        value, *_ = self.evaluate(load)
        return CavityReport(
            self.name,
            self._cavity,
            self.number * self._scales.stress,
            loaded,
            unloaded,
            abs(value) * self._scales.length**3 / max(abs(loaded), abs(unloaded)),
            self._compliance(loaded),
        )

    def _compliance(self, loaded: float) -> float:
        """Return ``-dV/dq`` (m³/Pa) of what holds the pressure at a volume of the loaded body (m³)."""
        if (windkessel := self._cavity.windkessel) is not None:
            return windkessel.compliance
        gas = self._cavity.gas
        return 0.0 if gas is None else loaded / (self.number * self._scales.stress + gas.ambient)

    def evaluate(self, load: float) -> tuple[float, float, float]:
        """Return C and its derivatives by the volume of the unknown body and by the pressure; collective."""
        kin, unit = self._weak_form.kinematics, self._scales.length**3
        mesh_volume, other = self._mesh_volume / unit, self.volume() / unit
        if self._target_volume is not None:
            return other - mesh_volume - load * (self._target_volume - mesh_volume), 1.0, 0.0
        unloaded, loaded = kin.reference_and_current(mesh_volume, other)
        if (windkessel := self._cavity.windkessel) is not None:
            compliance = windkessel.compliance * self._scales.stress / unit
            inflow = compliance * (self.number - load * windkessel.pressure / self._scales.stress)
            value = loaded - mesh_volume - load * (windkessel.volume / unit - mesh_volume) + inflow
            return value, kin.unknown_body_value(0.0, 1.0), compliance
        gas = self._cavity.gas
        assert gas is not None
        ambient, amount = gas.ambient / self._scales.stress, 1 + load * (gas.amount - 1)
        ratio = (self.number + ambient) / ambient
        return ratio * loaded - amount * unloaded, kin.unknown_body_value(-amount, ratio), loaded / ambient

    def number_rate(self, place: KeyPath) -> float:
        """Return the derivative of C at full load by a number (SI) of the cavity, at a place as in its `numbers`."""
        volume, stress = self._scales.length**3, self._scales.stress
        match place:
            case ("windkessel", "compliance"):
                assert self._cavity.windkessel is not None
                return (self.number * stress - self._cavity.windkessel.pressure) / volume
            case ("windkessel", "pressure"):
                assert self._cavity.windkessel is not None
                return -self._cavity.windkessel.compliance / volume
            case ("gas", key):
                assert self._cavity.gas is not None
                unloaded, loaded = self._weak_form.kinematics.reference_and_current(self._mesh_volume, self.volume())
                if key == "amount":
                    return float(-unloaded / volume)
                return float(-self.number * stress / self._cavity.gas.ambient**2 * loaded / volume)
        return -1 / volume  # a given volume, or the windkessel's

    def slope(self, b: PETSc.Vec) -> None:
        """Set ``b`` to the derivative of the unknown body's volume by the state; collective."""
        unknowns, body = self._weak_form.unknowns, self._body
        element = unknowns.displacement_space.element.basix_element
        points = scalar_element(body.source.kind, body.degree).points
        values = element.tabulate(0, points)[0, :, :, 0]  # of the displacement's functions at the nodes of the geometry
        dofs = unknowns.dofs_of_cells()[0]
        factor = self._weak_form.kinematics.sign / self._scales.length**2
        with b.localForm() as local:
            local.set(0.0)
            array = local.array
            for cells, slopes in self._enclosed.gradient(self._nodes()):
                np.add.at(array, dofs[cells], factor * np.einsum("nj,cni->cji", values, slopes))
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def _nodes(self) -> Floats:
        """Return the local geometry nodes of the unknown body (m)."""
        unknowns = self._weak_form.unknowns
        moved = self._weak_form.kinematics.sign * unknowns.geometry_values(unknowns.displacement())
        return np.asarray(self._body.nodes + self._scales.length * moved)


def cavity_equations(job: Job, body: Body, weak_form: WeakForm, scales: Scales) -> list[CavityEquation]:
    """Return the equations of the cavities of unknown pressure on the mesh as it lies; collective.

    In the second direction of a round trip, the volume of the unknown body is the one in the given body.
    """
    return list(_equations(job, body, weak_form, scales))


def _equations(job: Job, body: Body, weak_form: WeakForm, scales: Scales) -> Iterator[CavityEquation]:
    for name, cavity in job.controlled_cavities.items():
        target_volume = None
        if cavity.gas is None and cavity.windkessel is None:
            target_volume = weak_form.kinematics.unknown_body_value(cavity.unloaded_volume, cavity.volume)
            if target_volume is None:
                target_volume = enclosed_volume(job, body, name).volume(body.given_nodes)
        yield CavityEquation(name, job, body, weak_form, scales, target_volume)
