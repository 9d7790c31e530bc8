"""Rules of jobs with a shell: each fault with its place, and the remedy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hpcinv.base.quantity.schema import Faults, KeyPath
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.sections import MeshSpec, Support
from hpcinv.physics.effects.effect import Effect

SUFFIXES = (".msh", ".py", ".geo", ".vtu", ".vtk", ".inp", ".stl", ".ply", ".obj", ".vtp")
"""suffixes of meshes of shells"""
SAVED = frozenset({"inp", "msh", "vtu"})
_LABELLED = (".vtu", ".vtk")
_WITH_FACES = (".msh", ".vtu")
"""suffixes of shape files, which have both faces"""
_MESH = ("geometry_degree", "faces", "size", "grade")


def unsuited_shell(job: Any) -> Faults:
    """Faults of sections of a job that are not possible with a shell; of supports and loads of shells alone."""
    if job.mesh.shell is None:
        yield from _hinges(job)
        yield from _effects_of_shells(job)
        return
    yield from ((("mesh", *place), text) for place, text in _unsuited_mesh(job.mesh))
    spaces = job.discretisation
    if spaces.displacement != 2:
        yield ("discretisation", "displacement"), "must be 2 in a shell, which does not lock: take smaller cells"
    if spaces.quadrature is not None:
        yield (
            ("discretisation", "quadrature"),
            "is not valid with a shell, whose own one keeps it from locking",
        )
    if job.mesh.shell.surface_level is None:
        for place in _hinged(job):
            yield place, "is not possible where the surface is inside of a layer: let it be between two, or a face"
    if not SAVED.issuperset(job.output.mesh or ()):
        text = "must be inp, msh or vtu, which hold a shell: 'hpcinv export' writes its thick body in other formats"
        yield ("output", "mesh"), text


def _unsuited_mesh(mesh: MeshSpec) -> Faults:
    suffix = suffix_of(mesh.file)
    if suffix not in SUFFIXES:
        yield ("shell",), f"needs a surface in a file of {', '.join(SUFFIXES)}: save others as .vtu or .msh"
        return
    for key in _MESH:
        if key in mesh.model_fields_set and getattr(mesh, key):
            yield (key,), "is not valid with a shell"
    if mesh.array_labels is not None and suffix not in _LABELLED:
        yield ("labels",), "of a shell can be in a .vtu or .vtk file only; give other formats named regions"
    if mesh.shell is not None and mesh.shell.director == "data" and suffix not in _WITH_FACES:
        yield ("shell", "director"), "can be from data in a .msh or .vtu file only"


def unsuited_thickness(job: Any) -> Faults:
    """Faults of a derivative by the thickness where motions of supports depend on the place."""
    key = "mesh.shell.thickness"
    if not any(number.key == key for parameter in job.differentiated for number in (parameter, *parameter.ties)):
        return
    supports = [*job.supports, *(support for state in job.states for support in state.supports or ())]
    for support in supports:
        formulas = [formula for formula in support.displacement or () if formula is not None]
        if (support.motion is not None and support.motion.rotate) or any(
            formula.names & {"x", "y", "z"} for formula in formulas
        ):
            text = f"there is no derivative by {key} where '{support.region}' is moved by a formula of the place"
            yield (), f"{text} or a rotation"
            return


def _hinges(job: Any) -> Faults:
    for place in _hinged(job):
        yield place, "is valid only with 'mesh: {shell: …}'; other bodies turn about an edge"


def _effects_of_shells(job: Any) -> Faults:
    lists: list[tuple[KeyPath, Iterable[Effect]]] = [(("effects",), job.effects)]
    lists += [(("states", i, "effects"), state.effects) for i, state in enumerate(job.states)]
    for place, effects in lists:
        for i, effect in enumerate(effects):
            if effect.is_of_shells:
                text = "is valid only with 'mesh: {shell: …}'; give other bodies a pressure or traction by a formula"
                yield (*place, i, "effect"), text


def _hinged(job: Any) -> Iterable[KeyPath]:
    lists: list[tuple[KeyPath, Iterable[Support]]] = [(("supports",), job.supports)]
    lists += [(("states", i, "supports"), state.supports or ()) for i, state in enumerate(job.states)]
    yield from (
        (*place, i, "hinge") for place, supports in lists for i, support in enumerate(supports) if support.hinge
    )
