"""The section ``accuracy`` of a job: largest allowed errors of quantities of interest."""

from collections.abc import Mapping, Sequence

from hpcinv.job.sections import QuantityOfInterest
from hpcinv.quantity.quantity import positive
from hpcinv.quantity.schema import Location, shown
from hpcinv.quantity.suggestions import did_you_mean


def read_demands(
    given: object, quantities: Sequence[QuantityOfInterest]
) -> tuple[dict[str, float], list[tuple[Location, str]]]:
    """Largest errors (SI) by the names of quantities, and the faults of the ``given`` section.

    The error of a displacement is the length of its error vector.
    """
    if not isinstance(given, Mapping):
        return {}, [((), f"must be a mapping of names of quantities to their largest errors, not {shown(given)}")]
    known = {q.name: q for q in quantities}
    demands: dict[str, float] = {}
    problems: list[tuple[Location, str]] = []
    for name, value in given.items():
        if name not in known:
            fault = f"there is no such quantity in 'quantities'.{did_you_mean(str(name), known)}"
            problems.append(((str(name),), fault))
            continue
        if known[name].is_reaction:
            fault = "is a reaction, for which there is no error estimate; any other kind of quantity is possible"
            problems.append(((name,), fault))
            continue
        try:
            demands[name] = positive(value, known[name].dimension, "the quantity")
        except ValueError as error:
            problems.append(((name,), str(error)))
    return demands, problems
