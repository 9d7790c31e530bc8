"""Rules between sections of a job, which hold after all sections are valid by themselves."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.quantity import positive
from hpcinv.base.quantity.schema import Faults, KeyPath, collected, dotted_key, raise_if_any, repeated, shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.updates import UPDATES
from hpcinv.job.mesh_file import ExpectedShape
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.job.settings import Discretisation, FixedPoint, Output
from hpcinv.job.state_differences import parts
from hpcinv.job.states import StateSpec, given_on_current, rest_of
from hpcinv.job.support import Support
from hpcinv.job.vocabulary import AXES
from hpcinv.physics.effects import Direction, Effect
from hpcinv.physics.effects.contact import Contact
from hpcinv.physics.materials import MaterialLaw

NEARLY_INCOMPRESSIBLE = 10.0  # bulk-to-shear ratio above which the displacement form locks


def below(place: KeyPath, faults: Faults) -> Faults:
    """Faults of a part at its place in the whole."""
    yield from (((*place, *inner_place), text) for inner_place, text in faults)


def wants_pressure(laws: Mapping[str, MaterialLaw]) -> bool:
    """Return whether the displacement form would lock and the mixed form is possible."""
    nearly_incompressible = any((law.stiffness_ratio or 0.0) > NEARLY_INCOMPRESSIBLE for law in laws.values())
    return nearly_incompressible and all(law.is_split for law in laws.values())


def unsuited(discretisation: Discretisation, laws: Mapping[str, MaterialLaw], *, would_lock: bool) -> Faults:
    """Faults of spaces that are not suitable for the material.

    Args:
        would_lock: whether the formulation is chosen here, and the displacement form would lock (`wants_pressure`).
    """
    chosen = discretisation.formulation
    whole = [where for where, law in laws.items() if not law.is_split]
    is_incompressible = any(law.is_incompressible for law in laws.values())
    if whole and chosen == "mixed":
        text = f"must be displacement: {whole[0]} has no separate volumetric energy (give it kappa)"
        yield ("formulation",), text
    elif whole and is_incompressible:
        yield (), f"must be mixed for the incompressible law, but {whole[0]} cannot be: give it kappa"
    elif chosen == "displacement" and is_incompressible:
        yield ("formulation",), "must be mixed (or auto), since the material is incompressible"
    elif would_lock and discretisation.displacement == 1:
        text = (
            "must be 2 or more: the material is nearly incompressible, and the mixed form has no stable pressure "
            "at 1 (or state 'formulation: displacement')"
        )
        yield ("displacement",), text
    elif chosen == "auto" and not whole and not would_lock:
        varying = [where for where, law in laws.items() if law.varies_freely][:1]
        text = "must be stated, displacement or mixed, since the moduli of {} vary over the body"
        yield from ((("formulation",), text.format(where)) for where in varying)


def unsuited_effects(
    effects: Sequence[Effect],
    needed: Collection[str],
    first: Direction,
    where: str,
    fibres: Collection[str],
    cases: Collection[str],
) -> Faults:
    """Faults of effects that are not possible in a needed direction, or refer to unknown fibres or load cases.

    Args:
        first: the direction that is solved on the given body.
        where: the analysis or state, for messages.
    """
    for i, effect in enumerate(effects):
        if set(needed) - effect.directions:
            yield (i,), f"is not possible {where}, only with {', '.join(sorted(effect.directions))}"
        own, unknown = effect.faults(first), unknown_families(effect, fibres)
        for place, text in (*own, *unknown, *unknown_case(effect.case, cases)):
            yield (i, *place), text
        if effect.is_unknown and effect.case in list(cases)[1:]:
            yield (
                (i, "case"),
                f"must be the first load case, or give '{effect.finds}', which the solve finds; leave it out",
            )


def loaded_vertices(effects: Sequence[Effect], single: Collection[str]) -> Faults:
    """Faults of effects on regions that are ``single`` vertices."""
    for i, effect in enumerate(effects):
        for name, key in effect.surfaces.items():
            if name in single:
                yield (i, key), f"'{name}' is a set of vertices, which only supports can hold: name facets"


def unsuited_supports(supports: Sequence[Support], effects: Sequence[Effect], cases: Collection[str]) -> Faults:
    """Faults of supports that leave the body free, refer to unknown load cases, or repeat each other."""
    holding = [support for support in supports if support.remote is None]
    free = set(AXES).difference(*(s.held for s in holding), *(e.holds for e in effects))
    if free and not any(s.slides for s in supports):  # which axes a normal holds is known on the mesh only
        yield (), f"leave the body free to move along {' and '.join(sorted(free))}: hold it there in some region"
        return
    for i, support in enumerate(supports):
        for place, text in unknown_case(support.case, cases):
            yield (i, *place), text
    taken: set[tuple[str, str]] = set()
    for i, support in enumerate(supports):
        held = {(support.region, axis) for axis in support.components}
        for region, axis in sorted(held & taken):
            yield (i,), f"prescribes {axis} on '{region}' a second time"
        taken |= held


def unsuited_states(states: Sequence[StateSpec], fibres: Collection[str], cases: Collection[str]) -> Faults:
    """Faults of the effects and supports of states, with their places in the list of states."""
    for i, state in enumerate(states):
        direction: Direction = "inverse" if state.given else "forward"
        where = f"in a state that is solved {direction}"
        own_effects = unsuited_effects(state.effects, {direction}, direction, where, fibres, cases)
        yield from below((i, "effects"), own_effects)
        if state.supports is not None:
            yield from below((i, "supports"), unsuited_supports(state.supports, state.effects, cases))


def unsuited_shared(supports: Sequence[Support], states: Sequence[StateSpec], cases: Collection[str]) -> Faults:
    """Faults of the supports of a job in the first state in which they have any."""
    for state in states:
        if not state.is_rest and state.supports is None:
            faults = [
                (place, f"in state '{state.name}': {text}")
                for place, text in unsuited_supports(supports, state.effects, cases)
            ]
            yield from faults
            if faults:
                return


def given_on_rest(states: Sequence[StateSpec], parts: Mapping[str, Ingredient]) -> Faults:
    """Fault of laws, fibres and effects that are given on the current body, if the given state is the rest shape.

    Args:
        parts: laws, families of fibres and effects of the states, by their keys in the job.
    """
    if not any(state.given and state.is_rest for state in states):
        return
    for owner, part in parts.items():
        for place in given_on_current(part):
            text = f"{owner}{dotted_key(('', *place))} is given on the current body, but the given one,"
            remedy = "give it on the reference body (in a formula by X, Y, Z)"
            yield (), f"{text} '{rest_of(states)}', is the rest shape: {remedy}"
            return


def unknown_families(part: Ingredient, known: Collection[str]) -> Faults:
    """Faults of a law or effect that needs unknown families of fibres."""
    for family, field in part.families.items():
        if family not in known:
            hint = did_you_mean(family, known) if known else ""
            yield (field,), f"there are no fibres '{family}'; define them in 'fibres'.{hint}".removesuffix(".")


def unknown_case(case: str | None, known: Collection[str]) -> Faults:
    """Fault of an unknown load case."""
    if case is not None and case not in known:
        hint = f".{did_you_mean(case, known)}" if known else ""
        yield ("case",), f"'{case}' is not among 'load_cases'{hint}"


def contradicting_directions(
    analysis: str, first: str | None, method: str, fixed_point: FixedPoint, states: Sequence[StateSpec]
) -> Faults:
    """Faults of keys that are not valid with the analysis, the states or the method of a job."""
    if first is not None and analysis != "round_trip" and not states:
        yield ("first",), "is valid only with 'analysis: round_trip'"
    if method == "direct":
        if fixed_point.model_fields_set:
            yield ("fixed_point",), f"is not valid with 'method: direct'; choose {', '.join(UPDATES)}"
    elif any(state.given and state.is_rest for state in states):
        text = "is not valid if the given state is the rest shape: the others are solved from it directly"
        yield ("method",), text
    elif analysis == "forward":
        text = "is valid only in an inverse analysis or a round trip; a forward one is always direct"
        yield ("method",), text


def contradicting_meshes(mesh: MeshSpec, output: Output, expected: ExpectedShape | None) -> Faults:
    """Faults of files that do not suit a mesh with or without parts."""
    if mesh.is_partitioned and {"msh", "vtu"} & set(output.mesh or ()):
        text = "of a partitioned mesh must be bp; 'hpcinv mesh gather shape.bp shape.msh' converts it to one file"
        yield ("output", "mesh"), text
    if expected is not None and expected.has_nodes and expected.is_partitioned != mesh.is_partitioned:
        text = "must be a partitioned mesh (.bp) if and only if the mesh of the job is"
        yield ("expected_shape", "file"), f"{text}: 'hpcinv mesh partition' makes one, with the same --parts"


def quantities_of_states(
    quantities: Sequence[QuantityOfInterest],
    supports: Sequence[Support],
    effects: Sequence[Effect],
    states: Sequence[StateSpec],
) -> tuple[QuantityOfInterest, ...]:
    """Return the quantities; for one that names no state, one for each loaded state under names such as NAME-STATE.

    Raises:
        Problems: names are duplicated, or a state does not have the support, contact or prestrain of a quantity.
    """
    loaded = {state.name: state for state in states if not state.is_rest}
    raise_if_any(_at_places(enumerate(quantities), lambda q: _unknown_states(q, loaded)))
    numbered = [(i, quantity) for i, q in enumerate(quantities) for quantity in _one_for_each_state(q, loaded)]
    names = [q.name for _, q in numbered]
    raise_if_any(
        ((numbered[i][0], "name"), f"'{names[i]}' is the name of another quantity in a state") for i in repeated(names)
    )
    effects_of: dict[str, Sequence[Effect]] = {name: state.effects for name, state in loaded.items()} or {"": effects}
    numbered_parts = [(i, part) for i, q in numbered for part in parts(q)]
    raise_if_any(_at_places(numbered_parts, lambda part: _missing_parts(part, supports, effects_of, loaded)))
    return tuple(quantity for _, quantity in numbered)


def _at_places(
    quantities: Iterable[tuple[int, QuantityOfInterest]], faults: Callable[[QuantityOfInterest], Faults]
) -> Faults:
    """Faults of quantities, with their places in the list."""
    return (((i, *place), text) for i, quantity in quantities for place, text in faults(quantity))


def _unknown_states(quantity: QuantityOfInterest, loaded: Iterable[str]) -> Faults:
    """Faults of the states of a quantity."""
    for key, state in (("state", quantity.state), ("from", quantity.from_state)):
        if state is not None and state not in loaded:
            yield (key,), f"there is no loaded state '{state}'.{did_you_mean(state, loaded)}"
    if quantity.from_state is not None and quantity.from_state == quantity.state:
        yield ("from",), f"is the state '{quantity.state}' itself; name another one"


def _one_for_each_state(quantity: QuantityOfInterest, loaded: Iterable[str]) -> list[QuantityOfInterest]:
    """Return the quantity; if it names no state, one for each loaded state, whose name is added to the quantity's."""
    if quantity.state is not None or not loaded:
        return [quantity]
    return [
        quantity.model_copy(update={"name": f"{quantity.name}-{name}", "state": name})
        for name in loaded
        if name != quantity.from_state
    ]


def _missing_parts(
    quantity: QuantityOfInterest,
    supports: Sequence[Support],
    effects_of: Mapping[str, Sequence[Effect]],
    loaded: Mapping[str, StateSpec],
) -> Faults:
    """Faults of a quantity of supports, contact or prestrain that its state does not have.

    Args:
        effects_of: effects by the names of loaded states; by an empty name in a job without states.
        loaded: the loaded states by name.
    """
    state = quantity.state or ""
    if quantity.prestrain_names and not any(effect.writes_its_stress for effect in effects_of[state]):
        where = f" of state '{state}'" if state else ""
        yield ("of",), f"has '{quantity.prestrain_names[0]}', but there is no prestrain among the effects{where}"
    if quantity.is_contact:
        yield from _missing_contact(quantity, effects_of)
    elif quantity.is_reaction:
        own_supports = loaded[state].supports if state else None
        yield from _missing_support(quantity, supports if own_supports is None else own_supports, loaded)


def _missing_support(
    quantity: QuantityOfInterest, supports: Sequence[Support], loaded: Mapping[str, StateSpec]
) -> Faults:
    """Faults of a reaction on a region that has none of its state's supports."""
    regions = list(dict.fromkeys(support.region for support in supports))
    if quantity.on not in regions:
        where = f"those with supports are {', '.join(regions)}" if regions else "the job has no supports"
        state_text = f" in state '{quantity.state}'" if quantity.state else ""
        held = [name for name, other in loaded.items() if quantity.on in [s.region for s in other.supports or ()]]
        text = f"{shown(quantity.on)} is not the region of a support{state_text}: {where}{_state_to_give(held)}"
        yield ("on",), text


def _missing_contact(quantity: QuantityOfInterest, loads: Mapping[str, Iterable[Effect]]) -> Faults:
    """Fault of a result of contact on a region without one, with the effects of each loaded state."""
    state = quantity.state or ""
    regions = {name: [e.region for e in effects if isinstance(e, Contact)] for name, effects in loads.items()}
    if quantity.on in regions[state]:
        return
    where = f"those with contact are {', '.join(regions[state])}" if regions[state] else "there is no contact"
    remedy = _state_to_give([name for name, contact_regions in regions.items() if quantity.on in contact_regions])
    state_text = f" in state '{state}'" if state else ""
    yield ("on",), f"{shown(quantity.on)} is not the region of a contact{state_text}: {where}{remedy}"


def _state_to_give(states: Sequence[str]) -> str:
    """Return the end of a message that names the states in which a quantity has a value."""
    return f"; give the quantity the state that has one (state: {' or '.join(states)})" if states else ""


def read_demands(given: object, quantities: Sequence[QuantityOfInterest]) -> dict[str, float]:
    """Largest errors (SI) by the names of quantities, from the section ``accuracy``.

    The error of a displacement is the length of its error vector.

    Raises:
        Problems: the section has faults.
    """
    if not isinstance(given, Mapping):
        raise ValueError(f"must be a mapping of names of quantities to their largest errors, not {shown(given)}")
    known = {q.name: q for q in quantities}
    demands: dict[str, float] = {}
    problems: list[tuple[KeyPath, str]] = []
    for name, value in given.items():
        with collected(problems, str(name)):
            if name not in known:
                raise ValueError(f"there is no such quantity in 'quantities'.{did_you_mean(str(name), known)}")
            if known[name].is_reaction:
                raise ValueError("is a reaction, which has no error estimate; any other kind of quantity is possible")
            demands[name] = positive(value, known[name].dimension, "the quantity")
    raise_if_any(problems)
    return demands
