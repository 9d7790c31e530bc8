"""Scaled parameters of a weak form.

Numbers are entries of one constant of its forms, so that new values need no compilation; fields are functions or
formulas of position. There is only one constant because UFL sorts constants by the text of their running numbers: with
several, the order would change between the 9th and the 10th, and the same form would get another program.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import basix.ufl
import dolfinx.fem.petsc as fem_petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.classes import ListTensor

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.nondimensional import LengthsOfBody, Scales
from hpcinv.base.quantity.spatial_fields import ByData, ByFormula, Field
from hpcinv.base.quantity.units import Dimension
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import DataArray
from hpcinv.model.fields import BodyFields
from hpcinv.physics.kinematics.kinematics import Kinematics, OtherState
from hpcinv.physics.kinematics.ufl_formulas import position_formula


@dataclass(frozen=True)
class ParameterDirection:
    """Rates of change of the scaled parameters: for entries of the constant, and pairs of function and rate."""

    entries: npt.NDArray[np.float64]
    functions: tuple[tuple[fem.Function, fem.Function], ...]


@dataclass(frozen=True)
class _Formula:
    """A formula, and the indices of its unit and of its constants."""

    formula: Expression
    scale: int
    constants: Mapping[str, int]


class Parameters:
    """The load factors of the load cases, and the finite quantities of laws, effects and families of fibres.

    Args:
        ingredients: laws, effects and families of fibres, with their names in messages.
        kin: positions for their formulas.
        may_grow: whether forces that act at any load factor can be made to grow with it (see `growing`).

    Attributes:
        constant: the one constant of the forms, whose first entries are the load factors.

    Raises:
        MeshError: on all ranks, if the mesh lacks what a field needs.
    """

    def __init__(
        self,
        ingredients: Sequence[tuple[str, Ingredient]],
        kin: Kinematics,
        fields: BodyFields,
        scales: Scales,
        cases: int,
        *,
        may_grow: bool = False,
    ) -> None:
        self.fields, self._scales, self._cases = fields, scales, cases
        self._values = [0.0] * cases
        self._first: npt.NDArray[np.float64] | None = None  # entries where a line begins
        self._metre: int | None = None
        self._functions: dict[str, tuple[fem.Function, Dimension]] = {}
        self._arrays: dict[str, DataArray] = {}  # of the mesh, which functions have
        self._places = [self._places_of(where, ingredient) for where, ingredient in ingredients]
        self._growing = self._append(0.0) if may_grow else None
        self._numbers = {where: number for number, (where, _) in enumerate(ingredients)}
        self.constant = fem.Constant(fields.body.mesh, self._values)
        self._namespaces = [
            SimpleNamespace(
                **{n: self._entry(p, kin.data_state if part.is_attached(n) else kin) for n, p in places.items()}
            )
            for (_, part), places in zip(ingredients, self._places, strict=True)
        ]

    def load(self, case: int) -> Any:
        """Return the load factor of a case, from 0 to 1, as a UFL scalar."""
        return self.constant[case]

    def set_load(self, value: float) -> None:
        """Set the load factors of all cases, which are applied in turn, for the share ``value`` of the whole load.

        On a line from other numbers (`begin_line`), set all entries for the share ``value`` of the way.
        """
        factors = [load_factor(value, case, self._cases) for case in range(self._cases)]
        if self._first is not None:
            factors = [1.0] * self._cases
            self.constant.value[:] = (1 - value) * self._first + value * np.array(self._values)
        self.constant.value[: self._cases] = factors

    def load_rates(self, value: float) -> list[float]:
        """Return the rates of the load factors of all cases by the share of the whole load, from ``value`` on."""
        present = min(math.floor(self._cases * value + 1e-9), self._cases - 1)
        return [float(self._cases) if case == present else 0.0 for case in range(self._cases)]

    @property
    def path_entries(self) -> tuple[int, ...]:
        """Numbers of the entries of the constant that change along the present path, the load factors or others."""
        if self._first is None:
            return tuple(range(self._cases))
        return tuple(int(i) for i in np.flatnonzero(self._first != np.array(self._values)))

    def path_rates(self, value: float) -> list[float]:
        """Return the rates of `path_entries` by the share of the path, from ``value`` on."""
        if self._first is None:
            return self.load_rates(value)
        return [float(self._values[i] - self._first[i]) for i in self.path_entries]

    @property
    def is_on_line(self) -> bool:
        """True between `begin_line` and `end_line`."""
        return self._first is not None

    def begin_line(self, ingredients: Sequence[tuple[str, Ingredient]]) -> None:
        """Let the load factor lead at full load from the numbers of other ingredients (0) to the present ones (1)."""
        self._first = self._entries_of(ingredients)

    def end_line(self) -> None:
        """Let the load factor scale the loads of the present numbers again."""
        self._first = None
        self.constant.value[:] = self._values

    @property
    def growing(self) -> Any:
        """1 while forces that act at any load factor grow with it, else 0."""
        return 0 if self._growing is None else self.constant[self._growing]

    @property
    def may_grow(self) -> bool:
        """True if there are such forces."""
        return self._growing is not None

    def grow(self, *, growing: bool) -> None:
        """Let forces that act at any load factor grow with it, or act in full again."""
        if self._growing is not None:
            self._values[self._growing] = self.constant.value[self._growing] = float(growing)

    def quantities(self, index: int) -> Any:
        """Return the quantities of the ``index``-th ingredient by name, vectors as UFL vectors."""
        return self._namespaces[index]

    def update_parameters(self, ingredients: Sequence[tuple[str, Ingredient]], scales: Scales) -> None:
        """Set the numbers of other ingredients, of a job of the same reuse group, in other scales."""
        for function, dimension in self._functions.values():
            function.x.array[:] *= self._scales.unit_of(dimension) / scales.unit_of(dimension)
        self._scales = scales
        self._values[:] = self._entries_of(ingredients)
        self.end_line()
        self._read_changed_arrays(ingredients)

    def _read_changed_arrays(self, ingredients: Sequence[tuple[str, Ingredient]]) -> None:
        """Take values of data arrays that the mesh has by now; collective."""
        for where, ingredient in ingredients:
            for name, (value, dimension) in ingredient.quantities().items():
                key = f"{where}.{name}"
                if isinstance(value, ByData) and self._arrays[key] is not self.fields.body.source.data[value.array]:
                    scale = self._scales.unit_of(dimension)
                    self._functions[key][0].x.array[:] = self.fields.function(value, scale, key).x.array
                    self._arrays[key] = self.fields.body.source.data[value.array]

    def _entries_of(self, ingredients: Sequence[tuple[str, Ingredient]]) -> npt.NDArray[np.float64]:
        """Return the entries of the constant for other ingredients, in the present scales."""
        kept_values, kept_metre = self._values, self._metre
        self._values, self._metre = [0.0] * self._cases, None
        for where, ingredient in ingredients:
            self._places_of(where, ingredient)
        if self._growing is not None:
            self._append(0.0)
        entries = np.array(self._values)
        self._values, self._metre = kept_values, kept_metre
        assert len(entries) == len(self._values)
        return entries

    def set_number(self, index: int, name: str, value: float) -> None:
        """Set a uniform quantity of the ``index``-th ingredient to a scaled value."""
        place: int = self._places[index][name]
        self.constant.value[place] = self._values[place] = value

    def number_direction(self, index: int, name: str) -> npt.NDArray[np.float64]:
        """Return the rates of the entries of the constant as a uniform quantity of an ingredient grows by 1, scaled."""
        entries = np.zeros(len(self._values))
        entries[self._places[index][name]] = 1.0
        return entries

    def function_of(self, where: str, name: str) -> fem.Function | None:
        """Return the function that is a quantity of an ingredient; ``None`` if the quantity is a number or formula."""
        place = self._places[self._numbers[where]].get(name) if where in self._numbers else None
        return place if isinstance(place, fem.Function) else None

    @property
    def functions(self) -> tuple[fem.Function, ...]:
        """Quantities of the forms that are functions."""
        return tuple(function for function, _ in self._functions.values())

    def direction(self, rates: Mapping[str, Mapping[str, tuple[Any, Dimension]]]) -> ParameterDirection:
        """Return the direction in which the parameters change for given rates (SI) of quantities.

        Args:
            rates: rate and dimension by ingredient and by name of the quantity.
        """
        entries = np.zeros(len(self._values))
        functions: list[tuple[fem.Function, fem.Function]] = []

        def follow(place: Any, rate: Any, dimension: Dimension, name: str) -> None:
            match place:
                case int():
                    entries[place] = rate / self._scales.unit_of(dimension)
                case list():
                    for i, (p, r) in enumerate(zip(place, rate, strict=True)):
                        follow(p, r, dimension, f"{name}[{i}]")
                case _Formula():
                    for name, slope in rate.numbers.items():
                        entries[place.constants[name]] = slope
                case fem.Function() if rate.is_regional:
                    functions.append((place, self.fields.function(rate, self._scales.unit_of(dimension), name)))

        for where, ingredient_rates in rates.items():
            places = self._places[self._numbers[where]]
            for name, (rate, dimension) in ingredient_rates.items():
                follow(places[name], rate, dimension, f"{where}.{name}")
        return ParameterDirection(entries, tuple(functions))

    @contextmanager
    def moved(self, direction: ParameterDirection, step: float) -> Iterator[None]:
        """Context with the parameters a step along a direction; afterwards they are restored exactly."""
        vectors = [
            (self.constant.value, direction.entries),
            *((f.x.array, rate.x.array) for f, rate in direction.functions),
        ]
        kept_values = [values.copy() for values, _ in vectors]
        for values, rate in vectors:
            values += step * rate
        try:
            yield
        finally:
            for (values, _), kept in zip(vectors, kept_values, strict=True):
                values[:] = kept

    def _places_of(self, where: str, ingredient: Ingredient) -> dict[str, Any]:
        return {
            name: self._place(value, dimension, f"{where}.{name}")
            for name, (value, dimension) in ingredient.quantities().items()
            if value is not None and value != math.inf
        }

    def _place(self, value: Any, dimension: Dimension, where: str) -> Any:
        """Return the representation of a quantity: an index of the constant, a function, or a formula."""
        if isinstance(value, tuple):
            return [self._place(v, dimension, f"{where}[{i}]") for i, v in enumerate(value)]
        if isinstance(value, LengthsOfBody):
            return self._append(value * self.fields.body.length)
        scale = self._scales.unit_of(dimension)
        if isinstance(value, ByFormula):
            if self._metre is None:
                self._metre = self._append(self._scales.length)
            constants = {name: self._append(constant) for name, constant in value.numbers.items()}
            return _Formula(value.formula, self._append(1 / scale), constants)
        if isinstance(value, Field):
            if where not in self._functions:
                self._functions[where] = self.fields.function(value, scale, where), dimension
                if isinstance(value, ByData):
                    self._arrays[where] = self.fields.body.source.data[value.array]
            return self._functions[where][0]
        return self._append(value / scale)

    def _append(self, value: float) -> int:
        self._values.append(value)
        return len(self._values) - 1

    def _entry(self, place: Any, k: Kinematics | OtherState) -> Any:
        match place:
            case int():
                return self.constant[place]
            case list():
                return ufl.as_vector([self._entry(p, k) for p in place])
            case _Formula(formula, scale, constants):
                named = {name: self.constant[i] for name, i in constants.items()}
                assert self._metre is not None
                return self.constant[scale] * position_formula(formula, k, self.constant[self._metre], named)
            case _:
                return place


def present_value(entry: Any) -> Any:
    """Return the present value of an entry of a UFL constant, or of a vector of entries (n,); SI over its scale."""
    if isinstance(entry, ListTensor):
        return np.array([present_value(component) for component in entry.ufl_operands])
    values, index = entry_of(entry)
    return float(values[index])


def entry_of(entry: Any) -> tuple[npt.NDArray[np.float64], int]:
    """Return the values of a UFL constant, and the index of an entry of it."""
    constant, index = entry.ufl_operands
    return constant.value, int(index[0])


def load_factor(value: float, case: int, cases: int) -> float:
    """Return the load factor of one of ``cases`` successive load cases, for the share ``value`` of the whole load.

    Below 0 and above 1, which a path may reach between limit points, the first and the last case are extrapolated.
    """
    low = 0.0 if case > 0 else -math.inf
    high = 1.0 if case < cases - 1 else math.inf
    return min(max(cases * value - case, low), high)


class ParameterDerivative:
    """Derivative of a weak form's residual in any direction of its parameters, as one form.

    UFL differentiates by coefficients, not by constants: a coefficient replaces the constant of all parameters during
    differentiation. Parameters and their rates are then two halves of one constant (see `Parameters`).
    """

    def __init__(self, residual: Any, par: Parameters, mesh: Mesh) -> None:
        self._parameters, count = par, par.constant.value.size
        self._point_and_way = both = fem.Constant(mesh, np.zeros(2 * count))
        space = ufl.FunctionSpace(mesh.ufl_domain(), basix.ufl.element("DG", mesh.basix_cell(), 0, shape=(count,)))
        point, way = ufl.Coefficient(space), ufl.Coefficient(space)
        self._functions, self._rates = par.functions, [fem.Function(f.function_space) for f in par.functions]
        residual = ufl.replace(residual, {par.constant: point})
        derivative = ufl.derivative(residual, (point, *self._functions), (way, *self._rates))
        halves = (ufl.as_vector([both[i] for i in part]) for part in (range(count), range(count, 2 * count)))
        form = ufl.replace(derivative, dict(zip((point, way), halves, strict=True)))
        self._form = fem.form(form)

    def assemble(self, direction: ParameterDirection, b: PETSc.Vec) -> None:
        """Assemble the derivative at the present state and load into ``b``, for the cells of this rank."""
        self._point_and_way.value[:] = np.concatenate([self._parameters.constant.value, direction.entries])
        for function, rate in zip(self._functions, self._rates, strict=True):
            given = [rate_function for known, rate_function in direction.functions if known is function]
            rate.x.array[:] = given[0].x.array if given else 0.0
        with b.localForm() as local:
            local.set(0.0)
            fem_petsc.assemble_vector(b, self._form)
