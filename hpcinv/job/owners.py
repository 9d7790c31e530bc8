"""Parts of a job with numbers, such as laws, effects, supports and cavities, by their place in it."""

from collections.abc import Iterable, Mapping, Sequence

from hpcinv.base.quantity.component import Ingredient
from hpcinv.job.cavities import Cavity
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.sensitivities import Owner
from hpcinv.job.shell_section import Shell
from hpcinv.job.states import StateSpec
from hpcinv.job.support import Support
from hpcinv.physics.effects import Effect
from hpcinv.physics.materials import Material, MaterialLaw


def laws_of(material: MaterialLaw | Mapping[str, MaterialLaw]) -> dict[str, MaterialLaw]:
    if isinstance(material, MaterialLaw):
        return {"material": material}
    return {f"material.{region}": law for region, law in material.items()}


def families_of(parts: Iterable[Ingredient], fibres: Mapping[str, FibreFamily]) -> dict[str, FibreFamily]:
    """The families of fibres that laws and effects use, by their place in the job."""
    needed = dict.fromkeys(name for part in parts for name in part.families)
    return {f"fibres.{name}": fibres[name] for name in needed if name in fibres}


def owners_of(
    material: Material,
    effects: Sequence[Effect],
    fibres: Mapping[str, FibreFamily],
    supports: Sequence[Support],
    places: Mapping[str, str],
) -> dict[str, Owner]:
    """The parts of a job with numbers by which results can be differentiated, by their place in the job.

    Args:
        places: of the effects and of the supports in the job, where they are a state's.
    """
    parts: dict[str, Ingredient] = {**laws_of(material), **numbered(places.get("effects", "effects"), effects)}
    families = families_of(parts.values(), fibres)
    return {**parts, **families, **numbered(places.get("supports", "supports"), supports)}


def owners_in_states(
    material: Material,
    effects: Sequence[Effect],
    fibres: Mapping[str, FibreFamily],
    supports: Sequence[Support],
    states: Sequence[StateSpec],
    cavities: Mapping[str, Cavity],
    sections_of_kind: Mapping[str, Shell],
) -> dict[str, Owner]:
    """The parts with numbers of a job and of all its states.

    Args:
        sections_of_kind: of the mesh, by their keys.
    """
    owners = owners_of(material, effects, fibres, supports, {})
    owners |= {f"mesh.{name}": section for name, section in sections_of_kind.items()}
    owners |= {f"cavities.{name}": cavity for name, cavity in cavities.items()}
    owners |= {f"states[{i}]": state for i, state in enumerate(states)}
    for i, state in enumerate(states):
        state_supports = supports if state.supports is None else state.supports
        owners |= owners_of(material, state.effects, fibres, state_supports, places_of(i, state))
    return owners


def have_derivatives(effects: Iterable[Effect], states: Iterable[StateSpec]) -> bool:
    """Return whether solutions have derivatives."""
    everywhere = [*effects, *(effect for state in states for effect in state.effects)]
    return not any("multiplier" in effect.functions(1) for effect in everywhere)


def places_of(number: int, state: StateSpec) -> dict[str, str]:
    """Places of a state's sections in the job, by their names."""
    own = ["effects"] if state.supports is None else ["effects", "supports"]
    return {section: f"states[{number}].{section}" for section in own}


def numbered[T](section: str, entries: Sequence[T]) -> dict[str, T]:
    return {f"{section}[{i}]": entry for i, entry in enumerate(entries)}
