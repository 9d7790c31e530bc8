"""Rules between sections of a job; each returns faults with their places in the later section."""

from collections.abc import Collection, Mapping, Sequence

from hpcinv.effects import Direction, Effect
from hpcinv.job.sections import AXES, ExpectedShape, MeshSpec, QuantityOfInterest, Support
from hpcinv.job.settings import Discretisation, FixedPoint, Output
from hpcinv.job.states import StateSpec
from hpcinv.materials import MaterialLaw
from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.quantity import positive
from hpcinv.quantity.schema import Faults, KeyPath, collected, raise_if_any, shown
from hpcinv.quantity.suggestions import did_you_mean

NEARLY_INCOMPRESSIBLE = 10.0  # bulk-to-shear ratio above which the displacement form locks


def wants_pressure(laws: Mapping[str, MaterialLaw]) -> bool:
    """Return whether the displacement form would lock and the mixed form is possible."""
    nearly_incompressible = any((law.stiffness_ratio or 0.0) > NEARLY_INCOMPRESSIBLE for law in laws.values())
    return nearly_incompressible and all(law.is_split for law in laws.values())


def unsuited(discretisation: Discretisation, laws: Mapping[str, MaterialLaw]) -> Faults:
    """Faults of spaces that are not suitable for the material."""
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
    elif chosen == "auto" and wants_pressure(laws):
        if discretisation.displacement == 1:
            text = (
                "must be 2 or more: the material is nearly incompressible, so the mixed form is chosen, in which 1 has "
                "no stable pressure (or state 'formulation: displacement')"
            )
            yield ("displacement",), text
    elif chosen == "auto" and not whole:
        unknown = (where for where, law in laws.items() if law.stiffness_ratio is None)
        if (where := next(unknown, None)) is not None:
            yield (
                ("formulation",),
                f"must be stated, displacement or mixed, since the moduli of {where} vary over the body",
            )


def unsuited_effects(
    effects: Sequence[Effect],
    needed: Collection[str],
    first: Direction,
    where: str,
    fibres: Collection[str] | None,
    cases: Collection[str] | None,
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


def unsuited_supports(supports: Sequence[Support], effects: Sequence[Effect], cases: Collection[str] | None) -> Faults:
    """Faults of supports that leave the body free, refer to unknown load cases, or repeat each other."""
    free = set(AXES).difference(*(s.held for s in supports), *(e.holds for e in effects))
    if free:
        yield (), f"leave the body free to move along {' and '.join(sorted(free))}: hold it there in some region"
        return
    for i, support in enumerate(supports):
        for place, text in unknown_case(support.case, cases):
            yield (i, *place), text
    taken: set[tuple[str, str]] = set()
    for i, support in enumerate(supports):
        held = {(support.region, axis) for axis in support.held}
        for region, axis in sorted(held & taken):
            yield (i,), f"prescribes {axis} on '{region}' a second time"
        taken |= held


def unknown_families(part: Ingredient, known: Collection[str] | None) -> Faults:
    """Faults of a law or effect that needs unknown families of fibres; no check if ``known`` is None."""
    for family, field in part.families.items():
        if known is not None and family not in known:
            hint = did_you_mean(family, known) if known else ""
            yield (field,), f"there are no fibres '{family}'; define them in 'fibres'.{hint}".removesuffix(".")


def unknown_case(case: str | None, known: Collection[str] | None) -> Faults:
    """Fault of an unknown load case; no check if ``known`` is None."""
    if known is not None and case is not None and case not in known:
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
            yield ("fixed_point",), "is not valid with 'method: direct'; choose sellier, aitken, anderson or rausch"
    elif any(state.given and state.is_rest for state in states):
        text = "is not valid if the given state is the rest shape, from which the others are solved directly"
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
                raise ValueError(
                    "is a reaction, for which there is no error estimate; any other kind of quantity is possible"
                )
            demands[name] = positive(value, known[name].dimension, "the quantity")
    raise_if_any(problems)
    return demands
