"""Moduli that look like a mistake in their convention or unit; no verdict, since auxetic materials exist."""

from collections.abc import Iterator, Mapping
from math import isinf
from typing import Any

from hpcinv.base.quantity.docstrings import meanings
from hpcinv.job.job import Job
from hpcinv.physics.materials import MaterialLaw
from hpcinv.physics.materials.moduli import young_and_poisson

_ROUNDING = 1e-6
"""Negative Poisson's ratio that counts as 0; lowered, a card or a decimal with few digits is warned of."""


def doubtful_moduli(job: Job) -> Iterator[str]:
    """Yield a warning for each law with a negative Poisson's ratio, unless the job gives that ratio itself."""
    for where, law in job.laws.items():
        if "poisson" in _section(job, where):
            continue
        for par in law.cases():
            mu, kappa = float(law.shear_modulus(par)), float(law.bulk_modulus(par))
            if (ratio := young_and_poisson(mu, kappa)[1]) < -_ROUNDING:
                yield (
                    f"{where}: Poisson's ratio is {ratio:.2g}, as the bulk modulus ({kappa:.3g} Pa) is below 2/3 of"
                    f" the shear modulus ({mu:.3g} Pa){convention(law)}"
                )
                break


def largest_bulk_modulus(job: Job) -> float | None:
    """Return the bulk modulus (Pa) of the stiffest part; ``None`` if a law is incompressible or has fields."""
    moduli = [float(law.bulk_modulus(par)) for law in job.laws.values() for par in law.cases()]
    is_known = all(any(True for _ in law.cases()) for law in job.laws.values())
    largest = max(moduli, default=0.0)
    return largest if is_known and largest > 0 and not isinf(largest) else None


def convention(law: MaterialLaw) -> str:
    """Return what the parameter of the volumetric energy means, as the end of a message."""
    if law.replaceable is None:
        return ""
    name = law.replaceable[1]
    return f"; {name}: {meaning}" if (meaning := meanings(type(law)).get(name)) else ""


def _section(job: Job, where: str) -> Mapping[str, Any]:
    """Return the section of a law as the file has it."""
    section: Any = job.data.get("material", {})
    region = where.partition(".")[2]
    section = section.get(region, {}) if region and isinstance(section, Mapping) else section
    return section if isinstance(section, Mapping) else {}
