"""Rules of a job by the kind of its body: each fault with its place, and the remedy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hpcinv.base.quantity.schema import Faults, KeyPath
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.body_kinds import SHELL, SOLID
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.support import Support
from hpcinv.physics.effects.effect import Effect

SUFFIXES = (".msh", ".py", ".geo", ".vtu", ".vtk", ".inp", ".stl", ".ply", ".obj", ".vtp")
"""suffixes of meshes of shells"""
_LABELLED = (".vtu", ".vtk")
_WITH_FACES = (".msh", ".vtu")
"""suffixes of shape files, which have both faces"""
_MESH = ("geometry_degree", "faces", "size", "grade")


class KindRules:
    """Rules of a job by the kind of its body."""

    def unsuited(self, job: Any) -> Faults:
        """Faults of sections of a job that are not possible with the kind of its body."""
        for place in _hinged(job):
            yield place, "is valid only with 'mesh: {shell: …}'; other bodies turn about an edge"
        yield from self.unsuited_effects(job)

    def unsuited_effects(self, job: Any) -> Faults:
        """Faults of effects of another kind of body."""
        lists: list[tuple[KeyPath, Iterable[Effect]]] = [(("effects",), job.effects)]
        lists += [(("states", i, "effects"), state.effects) for i, state in enumerate(job.states)]
        for place, effects in lists:
            for i, effect in enumerate(effects):
                if effect.only_of_kind not in ("", job.mesh.kind.name):
                    text = f"is valid only with 'mesh: {{{effect.only_of_kind}: …}}'"
                    yield (*place, i, "effect"), f"{text}; give other bodies a pressure or traction by a formula"

    def unsuited_sensitivities(self, job: Any) -> Faults:
        """Faults of derivatives that are not possible with the kind of its body."""
        yield from ()


class ShellRules(KindRules):
    """Rules of a job with a shell."""

    def unsuited(self, job: Any) -> Faults:
        yield from ((("mesh", *place), text) for place, text in _unsuited_mesh(job.mesh))
        yield from self.unsuited_effects(job)
        spaces, (section,) = job.discretisation, job.mesh.sections_of_kind.values()
        if spaces.displacement != 2:
            yield ("discretisation", "displacement"), "must be 2 in a shell, which does not lock: take smaller cells"
        if spaces.quadrature is not None:
            yield (
                ("discretisation", "quadrature"),
                "is not valid with a shell, whose own one keeps it from locking",
            )
        if section.surface_level is None:
            for place in _hinged(job):
                text = "is not possible where the surface is inside of a layer: let it be between two, or a face"
                yield place, text
        if not set(job.mesh.kind.saved).issuperset(job.output.mesh or ()):
            text = "must be inp, msh or vtu, which hold a shell: 'hpcinv export' writes its thick body in other formats"
            yield ("output", "mesh"), text

    def unsuited_sensitivities(self, job: Any) -> Faults:
        """Faults of a derivative by the thickness where motions of supports depend on the place."""
        key = "mesh.shell.thickness"
        if not any(number.key == key for parameter in job.differentiated for number in (parameter, *parameter.ties)):
            return
        supports = [*job.supports, *(support for state in job.states for support in state.supports or ())]
        if moved := next(filter(_is_moved_by_place, supports), None):
            text = f"there is no derivative by {key} where '{moved.region}' is moved by a formula of the place"
            yield (), f"{text} or a rotation"


def _is_moved_by_place(support: Any) -> bool:
    formulas = [formula for formula in support.displacement or () if formula is not None]
    rotates = support.motion is not None and bool(support.motion.rotate)
    return rotates or any(formula.names & {"x", "y", "z"} for formula in formulas)


KIND_RULES: Mapping[str, KindRules] = {SOLID.name: KindRules(), SHELL.name: ShellRules()}
"""by the name of the kind"""


def _unsuited_mesh(mesh: MeshSpec) -> Faults:
    suffix, (section,) = suffix_of(mesh.file), mesh.sections_of_kind.values()
    if suffix not in SUFFIXES:
        yield ("shell",), f"needs a surface in a file of {', '.join(SUFFIXES)}: save others as .vtu or .msh"
        return
    for key in _MESH:
        if key in mesh.model_fields_set and getattr(mesh, key):
            yield (key,), "is not valid with a shell"
    if mesh.array_labels is not None and suffix not in _LABELLED:
        yield ("labels",), "of a shell can be in a .vtu or .vtk file only; give other formats named regions"
    if section.director == "data" and suffix not in _WITH_FACES:
        yield ("shell", "director"), "can be from data in a .msh or .vtu file only"


def _hinged(job: Any) -> Iterable[KeyPath]:
    lists: list[tuple[KeyPath, Iterable[Support]]] = [(("supports",), job.supports)]
    lists += [(("states", i, "supports"), state.supports or ()) for i, state in enumerate(job.states)]
    yield from (
        (*place, i, "hinge") for place, supports in lists for i, support in enumerate(supports) if support.hinge
    )
