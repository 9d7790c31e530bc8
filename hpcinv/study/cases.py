"""Cases of a study: combinations of parameters, in a grid, side by side, or at random."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, model_validator

from hpcinv.quantity.keys import JobKey
from hpcinv.quantity.schema import ListOf, Location, Spec, raise_if_any, shown
from hpcinv.quantity.units import as_float, parse_quantity


def _range(value: object) -> tuple[float, float]:
    """The ends of a range, in SI."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError(f"must be the two ends of a range, such as [2 kPa, 200 kPa], not {shown(value)}")
    ends = []
    for end in value:
        if isinstance(end, bool) or not isinstance(end, str | int | float):
            raise ValueError(f"must have numbers or quantities at its ends, not {shown(end)}")
        ends.append(parse_quantity(end) if isinstance(end, str) else (as_float(end), None))
    (low, one), (high, other) = ends
    if one != other:
        raise ValueError(f"must have the same unit at both ends, not {value[0]} and {value[1]}")
    if not low < high < math.inf:
        raise ValueError(f"must begin below its end, not {value[0]} and {value[1]}")
    return low, high


class Cases(Spec):
    """Several cases: every combination (grid), values side by side (zip), or a random sample; else one (set alone)."""

    set: Mapping[JobKey, Any] = {}
    """values that all these cases have"""
    grid: Mapping[JobKey, ListOf[Any]] | None = None
    """values by key: each combination is a case, the last key changing fastest"""
    zip: Mapping[JobKey, ListOf[Any]] | None = None
    """values by key: the first of each are a case, the second are, …"""
    random: Mapping[JobKey, Annotated[tuple[float, float], PlainValidator(_range)]] | None = None
    """ranges by key, from which values are drawn independently of each other"""
    distribution: Literal["uniform", "log-uniform"] = "uniform"
    """of random values; log-uniform has as many in each decade"""
    count: Annotated[int, Field(ge=1)] | None = None
    """number of random cases"""
    seed: int = 0
    """the same seed draws the same cases, on any machine"""

    @model_validator(mode="after")
    def _is_one_kind(self) -> Self:
        problems: list[tuple[Location, str]] = []
        given = [kind for kind in ("grid", "zip", "random") if getattr(self, kind) is not None]
        if len(given) > 1:
            problems.append((("cases",), f"may be one of grid, zip and random, not {' and '.join(given)}"))
        if (self.random is None) != (self.count is None):
            problems.append((("count",), "is needed for random cases, and has no other use"))
        if self.random is None:
            idle = {"seed", "distribution"} & self.model_fields_set
            problems += [((key,), "has no use without 'random'") for key in sorted(idle)]
        elif self.distribution == "log-uniform":
            low = {key: ends[0] for key, ends in self.random.items() if ends[0] <= 0}
            problems += [(("random", key), "must begin above 0 to be log-uniform") for key in low]
        for kind in ("grid", "zip"):
            empty = (key for key, values in (getattr(self, kind) or {}).items() if not values)
            problems += [((kind, key), "must have at least one value") for key in empty]
        if self.zip and len(lengths := {len(values) for values in self.zip.values()}) > 1:
            problems.append((("zip",), f"needs as many values of each key, not {sorted(lengths)}"))
        for key in self.set:
            problems += [((kind, key), "stands in 'set' too") for kind in given if key in getattr(self, kind)]
        raise_if_any(problems)
        return self

    @property
    def size(self) -> int:
        """Number of the cases."""
        if self.random is not None:
            return self.count or 0
        if self.zip is not None:
            return len(next(iter(self.zip.values()), ()))
        return math.prod(len(values) for values in (self.grid or {}).values())

    def listed(self) -> Iterator[dict[str, Any]]:
        """The cases in order: values by key, without those of ``set``."""
        if self.random is not None:
            yield from self._drawn()
        elif self.grid is not None:
            for values in itertools.product(*self.grid.values()):
                yield dict(zip(self.grid, values, strict=True))
        elif self.zip is not None:
            for values in itertools.zip_longest(*self.zip.values()):
                yield dict(zip(self.zip, values, strict=True))
        else:
            yield {}

    def _drawn(self) -> Iterator[dict[str, float]]:
        source = random.Random(self.seed)  # its random() gives the same numbers in every version of Python
        for _ in range(self.count or 0):
            yield {key: self._between(low, high, source.random()) for key, (low, high) in (self.random or {}).items()}

    def _between(self, low: float, high: float, share: float) -> float:
        if self.distribution == "uniform":
            return low + share * (high - low)
        return float(low * (high / low) ** share)
