"""Contradictions between sections of a job that are valid by themselves.

Each function has a job, and yields faults with their places. It reads only sections, so that a case of a sweep is
checked by those functions alone that read what the case changes (`hpcinv.job.section_memo`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hpcinv.base.quantity.schema import Faults
from hpcinv.job import rules
from hpcinv.job.cavities import unknown_cavities, unsuited_controls
from hpcinv.job.combinations import refused_combinations
from hpcinv.job.identification import faults_of_identification
from hpcinv.job.interfaces import faults_of_interfaces
from hpcinv.job.kind_rules import KIND_RULES
from hpcinv.job.owners import numbered
from hpcinv.job.region_rules import VertexSet


def _ways_to_solve(job: Any) -> Faults:
    for key in ("analysis", "first"):
        if job.states and key in job.model_fields_set:
            yield (key,), "is not valid with 'states': one of them is the given state; remove it"
    yield from rules.contradicting_directions(job.analysis, job.first, job.method, job.fixed_point, job.states)


def _meshes(job: Any) -> Faults:
    yield from rules.contradicting_meshes(job.mesh, job.output, job.expected_shape)


def _kind(job: Any) -> Faults:
    yield from KIND_RULES[job.mesh.kind.name].unsuited(job)


def _interfaces(job: Any) -> Faults:
    yield from faults_of_interfaces(job.interfaces, job.effects, job.directions, job.uncertainty)


def _laws(job: Any) -> Faults:
    for where, law in job.laws.items():
        yield from rules.below(tuple(where.split(".", 1)), rules.unknown_families(law, job.fibres))


def _loading(job: Any) -> Faults:
    """Faults of effects and supports that other sections do not allow."""
    single = {name for name, rule in job.regions.items() if isinstance(rule, VertexSet)}
    yield from rules.below(("effects",), rules.loaded_vertices(job.effects, single))
    for i, state in enumerate(job.states):
        yield from rules.below(("states", i, "effects"), rules.loaded_vertices(state.effects, single))
    if not job.states:
        needed, where = set(job.directions), f"with 'analysis: {job.analysis}'"
        faults = rules.unsuited_effects(job.effects, needed, job.directions[0], where, job.fibres, job.load_cases)
        yield from rules.below(("effects",), faults)
        yield from rules.below(("supports",), rules.unsuited_supports(job.supports, job.effects, job.load_cases))
        return
    if job.effects[: job.own_effect_count]:
        text = "belong to states in a job with 'states': move them to 'effects' of each state that has them"
        yield ("effects",), text
    yield from rules.below(("states",), rules.unsuited_states(job.states, job.fibres, job.load_cases))
    yield from rules.below(("supports",), rules.unsuited_shared(job.supports, job.states, job.load_cases))
    states = {f"states[{i}]": state for i, state in enumerate(job.states)}
    effects = {k: v for where, s in states.items() for k, v in numbered(f"{where}.effects", s.effects).items()}
    fibres = {f"fibres.{name}": family for name, family in job.fibres.items()}
    yield from rules.below(("states",), rules.given_on_rest(job.states, {**effects, **fibres, **job.laws}))


def _spaces(job: Any) -> Faults:
    would_lock = job.discretisation.formulation == "auto" and job.wants_pressure
    yield from rules.below(("discretisation",), rules.unsuited(job.discretisation, job.laws, would_lock=would_lock))


def _quantities(job: Any) -> Faults:
    yield from rules.below(("quantities",), unknown_cavities(job.quantities, job.cavities, job.states))


def _sensitivities(job: Any) -> Faults:
    if job.sensitivities:
        yield from rules.below(("sensitivities",), KIND_RULES[job.mesh.kind.name].unsuited_sensitivities(job))


def _identification(job: Any) -> Faults:
    if job.identify is not None:
        faults = faults_of_identification(job.identify, job._owners_in_states, job.quantities, job.states, job.cavities)
        yield from rules.below(("identify",), faults)


def _fibres(job: Any) -> Faults:
    given_rest = any(state.given and state.is_rest for state in job.states)
    is_reference = given_rest if job.states else job.directions[0] == "forward"
    mesh, shape = ("reference", "undeformed") if is_reference else ("current", "deformed")
    text = f"must be '{mesh}' for a rule, which is evaluated on the mesh of the job, the {shape} body"
    ruled = ((name, family) for name, family in job.fibres.items() if family.rule is not None)
    yield from ((("fibres", name, "given_on"), text) for name, family in ruled if family.given_on != mesh)


CONTRADICTIONS: tuple[Callable[[Any], Faults], ...] = (
    _ways_to_solve,
    _meshes,
    _kind,
    unsuited_controls,
    refused_combinations,
    _interfaces,
    _laws,
    _loading,
    _spaces,
    _quantities,
    _sensitivities,
    _identification,
    _fibres,
)
"""in the order in which faults are reported"""
