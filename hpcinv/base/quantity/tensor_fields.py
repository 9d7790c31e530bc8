"""Tensors that may vary over the body: nine numbers or formulas, a tensor for each region, or mesh data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, TypeGuard

from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.schema import KeyPath, collected, raise_if_any, shown
from hpcinv.base.quantity.spatial_fields import ByData, ByRegion, VaryingQuantity

_FORM = "must be a tensor, 3 rows of 3 numbers, or 3 numbers on its diagonal"


@dataclass(frozen=True)
class TensorQuantity(VaryingQuantity):
    """Metadata of a field that is a tensor; ``unit`` and bounds hold for each component."""

    def read(self, value: object, definitions: Mapping[str, Expression] = MappingProxyType({})) -> Any:
        """Rows of numbers (SI) and fields, or an array of nine components, row by row; ``ValueError`` if invalid.

        Args:
            definitions: formulas of the names in a formula.
        """
        if isinstance(value, ByData):
            return value
        if isinstance(value, Mapping):
            return replace(self._data(value), components=9) if "data" in value else self._regional_tensor(value)
        return self._rows(value, lambda entry: super(TensorQuantity, self).read(entry, definitions))

    def _regional_tensor(self, given: Mapping[Any, object]) -> tuple[tuple[Any, ...], ...]:
        if not given:
            raise ValueError("must name regions, such as {core: [1.1, 1, 1], elsewhere: [1, 1, 1]}")
        tensors: dict[str, Any] = {}
        problems: list[tuple[KeyPath, str]] = []
        for region, value in given.items():
            with collected(problems, str(region)):
                tensors[str(region)] = self._rows(value, self.parse)
        raise_if_any(problems)
        first, *others = tensors.values()
        varies = any(other != first for other in others)

        def component(i: int, j: int) -> Any:
            """Each component that varies is a function of its own; one at least keeps the regions."""
            values = {region: tensor[i][j] for region, tensor in tensors.items()}
            return ByRegion(values) if len({*values.values()}) > 1 or not varies else first[i][j]

        return tuple(tuple(component(i, j) for j in range(3)) for i in range(3))

    def _rows(self, value: object, read: Callable[[Any], Any]) -> tuple[tuple[Any, ...], ...]:
        if not _is_three(value):
            raise ValueError(f"{_FORM}, not {shown(value)}")
        if not any(isinstance(row, list | tuple) for row in value):
            value = [[x if i == j else 0.0 for j in range(3)] for i, x in enumerate(value)]
        problems: list[tuple[KeyPath, str]] = []
        rows: list[list[Any]] = []
        for i, row in enumerate(value):
            with collected(problems, i):
                if not _is_three(row):
                    raise ValueError(f"must be a row of 3 numbers, not {shown(row)}")
                rows.append([])
                for j, x in enumerate(row):
                    with collected(problems, i, j):
                        rows[-1].append(read(x))
        raise_if_any(problems)
        return tuple(map(tuple, rows))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        entry = super().__get_pydantic_json_schema__(schema, handler)
        three = {"type": "array", "minItems": 3, "maxItems": 3}
        tensor = {"anyOf": [three | {"items": three | {"items": entry}}, three | {"items": entry}]}
        *_, data, _ = entry["anyOf"]
        return {"anyOf": [*tensor["anyOf"], data, {"type": "object", "additionalProperties": tensor}]}


TensorField = Annotated[Any, TensorQuantity("")]


def components(tensor: Any) -> Any:
    """Samples of a tensor, (…, 3, 3), from an array or from rows of arrays and numbers."""
    import numpy as np

    if isinstance(tensor, tuple):
        entries = np.broadcast_arrays(*(np.asarray(x, dtype=float) for row in tensor for x in row))
        return np.stack(entries, axis=-1).reshape(*entries[0].shape, 3, 3)
    return np.asarray(tensor, dtype=float)


def least_determinant(tensor: Any) -> Any:
    """Least value of ``det(I + t (T - I))`` for t from 0 to 1, of tensors ``T`` (…, 3, 3)."""
    import numpy as np

    H = tensor - np.eye(3)
    trace = np.trace(H, axis1=-2, axis2=-1)
    a, b, c = trace, (trace**2 - np.trace(H @ H, axis1=-2, axis2=-1)) / 2, np.linalg.det(H)
    with np.errstate(all="ignore"):
        q = -(b + np.copysign(np.sqrt(b**2 - 3 * a * c), b))  # the slope a + 2 b t + 3 c t² vanishes at q/3c and a/q
        roots = [q / (3 * c), a / q]
    times = [np.where((t > 0) & (t < 1), t, 1.0) for t in roots]
    return np.minimum.reduce([1 + t * (a + t * (b + t * c)) for t in (*times, np.ones_like(a))])


def _is_three(value: object) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, list | tuple) and len(value) == 3
