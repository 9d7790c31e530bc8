"""Rules between sections of a job; each returns faults with their places in the later section."""

from collections.abc import Collection, Iterator, Mapping

from hpcinv.job.settings import Discretisation
from hpcinv.materials import MaterialLaw
from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.schema import Location
from hpcinv.quantity.suggestions import did_you_mean

type Faults = Iterator[tuple[Location, str]]

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
