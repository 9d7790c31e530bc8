"""SI units of costs and of the numbers of a summary."""

from hpcinv.job.job import Job
from hpcinv.job.sections import FIELDS, POSITIONS, REACTIONS
from hpcinv.quantity.units import NAMES, parse_unit

COSTS = {"time": "s", "run": "s", "solver": "s", "compile": "s", "memory": "B"}
_IN_SUMMARY = {"max": "m", "rms": "m", "strain_energy": "J", "total": "s"}


def unit_of(key: str, job: Job) -> str:
    """Return the unit of the number at a key of the summary; empty for pure numbers and where it is not known."""
    names = {quantity.name: quantity for quantity in job.quantities}
    name = key.removeprefix("quantities.").partition("[")[0]
    if not key.startswith("quantities.") or name not in names:
        return _IN_SUMMARY.get(key.rpartition(".")[2], "")
    if names[name].is_displacement:
        return "m"
    if names[name].is_reaction:
        return REACTIONS[names[name].of.source.strip()]
    if names[name].reduce == "integral":  # over a volume or an area, which only the mesh determines
        return ""
    dimension = names[name].of.check(POSITIONS | FIELDS)
    return next((unit for unit in NAMES if parse_unit(unit)[1] == dimension), "")
