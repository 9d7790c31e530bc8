"""A law whose energy is a formula in the job."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import BulkModulusField, Faults, KeyPath, Name, raise_if_any
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import AnyMeasured, Measured
from hpcinv.base.quantity.schema import collected
from hpcinv.base.quantity.units import Dimension, parse_unit
from hpcinv.physics.materials.formula_law.algebras import FLOATS, ufl_functions
from hpcinv.physics.materials.formula_law.coefficients import Coefficient, recorded_decisions
from hpcinv.physics.materials.formula_law.evaluation import evaluate
from hpcinv.physics.materials.formula_law.invariants import ISOTROPIC, PrincipalStretches, families_in, fault_of_name
from hpcinv.physics.materials.formula_law.jet import Jet, Strains
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import Deformation

_NUMBER, _STRESS = Dimension(), parse_unit("Pa")[1]
_STRETCH = re.compile(r"lambda_?[123](_bar)?")
_SMALL = 1e-6  # strain of the differences for small-strain moduli


class Formula(IsochoricLaw):
    """Any energy that is a formula of invariants: ``psi = energy``, or ``psi = energy + U(J; kappa)``.

    The invariants are ``I1``, ``I2``, ``J``, ``I1_bar``, ``I2_bar``, and of families f, s of fibres ``I4_f``, ``I5_f``,
    ``I8_f_s = a0·(C - I) b0``. The energy must be stress-free at ``F = I``; however it is written, it keeps its
    digits at small strain (`hpcinv.physics.materials.formula_law`). Without ``kappa`` it is the whole energy, and the
    pressure is not an unknown.
    """

    replaceable = (None, "kappa")
    example: ClassVar = {
        "law": "formula",
        "energy": "mu/2*(I1_bar - 3) + b*(I1_bar - 3)**2",
        "parameters": {"mu": "10 kPa", "b": "2 kPa"},
        "kappa": "1 MPa",
    }

    law: Literal["formula"] = "formula"
    kappa: BulkModulusField | None = None
    """bulk modulus of a volumetric energy U, or 'incompressible'; by default there is no U"""
    parameters: Mapping[Name, AnyMeasured] = {}
    """values of further names in the energy, such as {mu: 10 kPa, n: 3}; a plain number has no dimension"""
    energy: Expression
    """energy per reference volume, a formula of invariants and parameters, such as mu/2*(I1 - 3) - mu*ln(J)"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        taken = {*FUNCTIONS, *CONSTANTS} | ({"kappa"} if self.kappa is not None else set())
        names = ((name, fault_of_name(name, taken)) for name in self.parameters)
        problems: list[tuple[KeyPath, str]] = [(("parameters", name), text) for name, text in names if text]
        if not problems:
            with collected(problems, "energy"):
                self._check_energy()
        yield from problems
        if problems:
            return
        yield from super()._contradictions(info)
        for name in sorted(self.parameters.keys() - self.energy.names - self.energy.further_units):
            yield ("parameters", name), "does not occur in the energy"
        if self.kappa is None and self.volumetric != type(self).model_fields["volumetric"].default:
            yield ("volumetric",), "is not valid without kappa"

    def _check_energy(self) -> None:
        """Raise ``ValueError`` if the energy is not one of a solid that is free of stress at ``F = I``."""
        energy, parameters = self.energy, self.parameters
        if twice := sorted(parameters.keys() & {name for name, _ in energy.definitions}):
            raise ValueError(
                f"'{twice[0]}' is a parameter of this law and a formula (let.{twice[0]}); rename one of them"
            )
        if stretches := sorted(name for name in energy.names - parameters.keys() if _STRETCH.fullmatch(name)):
            raise ValueError(
                f"'{stretches[0]}' is a principal stretch, which formulas do not have; take 'law: ogden', or an energy"
                f" of {', '.join(ISOTROPIC)}"
            )
        known: dict[str, Dimension | None] = {name: p.dimension for name, p in parameters.items()}
        known |= {name: _NUMBER for name in (*ISOTROPIC, *energy.names) if families_in(name) is not None}
        try:
            energy.expect(known, _STRESS)
        except ValueError as error:
            raise ValueError(f"{error}{_missing_units(energy, known, parameters)}") from None
        try:
            faults = list(_faults(_float_jet(energy, parameters, 0.0, 0.0, 0.0)))
            shear, bulk = _moduli(energy, tuple(parameters.items()))
        except (OverflowError, ZeroDivisionError):
            raise ValueError(f"'{energy}' has no finite value near F = I") from None
        except ValueError as error:
            raise ValueError(f"'{energy}' {error}") from None
        raise_if_any(((), f"'{energy}' {fault}") for fault in faults)
        if self.kappa is None and shear > 0 and not bulk > _SMALL * shear:
            raise ValueError(f"'{energy}' does not resist a change of volume: give kappa, or add an energy of J to it")

    @property
    def formula(self) -> str:  # type: ignore[override]
        return str(self.energy)

    @property
    def volumetric_formula(self) -> str:
        return "0" if self.kappa is None else super().volumetric_formula

    @property
    def is_split(self) -> bool:
        return self.kappa is not None

    @property
    def families(self) -> dict[str, str]:
        return {family: "energy" for name in sorted(self.energy.names) for family in families_in(name) or ()}

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        """Return ``kappa`` and the numbers of the formula in SI; ``_pascal`` converts its value to scaled units.

        The small-strain moduli of the energy are quantities too, so that forms with them are the same for all values.
        """
        shear, bulk = _moduli(self.energy, tuple(self.parameters.items()))
        derived = {"_pascal": 1.0, "_shear_modulus": shear, "_bulk_modulus": bulk}
        return (
            {"kappa": (self.kappa, _STRESS)}
            | {name: (p.value, _NUMBER) for name, p in self.parameters.items()}
            | {name: (value, _STRESS) for name, value in derived.items()}
        )

    def structure(self) -> list[bool]:
        """Return the decisions by the parameters about terms of the energy, such as that one is 0."""
        with recorded_decisions() as decisions:
            _float_jet(self.energy, self.parameters, _SMALL, 0.3 * _SMALL, -0.7 * _SMALL)
        return decisions

    def numbers(self) -> dict[KeyPath, Number | str]:
        absent = "is 0, so that its term is not in the law; give it a small value"  # by Coefficient.parameter
        return super().numbers() | {
            ("parameters", name): Number(p.value, p.dimension) if p.value else absent
            for name, p in self.parameters.items()
        }

    def shear_modulus(self, par: Any) -> Any:
        return par._shear_modulus

    def bulk_modulus(self, par: Any) -> Any:
        return par._bulk_modulus + self.volumetric_modulus(par)

    def volumetric_modulus(self, par: Any) -> Any:
        return 0.0 if self.kappa is None else par.kappa

    def isochoric_energy(self, k: Deformation, par: Any) -> Any:
        return par._pascal * self._evaluated(k, par)[0].remainder

    def domain(self, k: Deformation, par: Any) -> tuple[Any, ...]:
        return tuple(self._evaluated(k, par)[1].positive)

    def _evaluated(self, k: Deformation, par: Any) -> tuple[Jet, Strains]:
        constants = {n: Coefficient.parameter(p.value, getattr(par, n)) for n, p in self.parameters.items()}
        return evaluate(self.energy, constants, k, ufl_functions())


def _missing_units(energy: Expression, known: dict[str, Dimension | None], parameters: Iterable[str]) -> str:
    """Return the end of a message that names the parameters with which the energy would be a stress, if they were."""
    plain = [name for name in parameters if known[name] == _NUMBER]
    for names in (*([name] for name in plain), plain):
        with suppress(ValueError):
            energy.expect(known | dict.fromkeys(names, _STRESS), _STRESS)
            listed = " and ".join(f"'{name}'" for name in names)
            return f". Give {listed} a unit, such as {names[0]}: 2 kPa" if names else ""
    return ""


def _float_jet(energy: Expression, parameters: Mapping[str, Measured], *e: float) -> Jet:
    constants = {name: Coefficient.parameter(p.value, p.value) for name, p in parameters.items()}
    return evaluate(energy, constants, PrincipalStretches(*e), FLOATS)[0]


@lru_cache(maxsize=64)  # laws in one process; each is evaluated dozens of times in a run, more cost memory
def _moduli(energy: Expression, parameters: tuple[tuple[str, Measured], ...]) -> tuple[float, float]:
    """Return shear and bulk modulus (Pa) without fibres, by ``psi = mu dev(e):dev(e) + K/2 tr²(e)`` at small ``e``."""

    def psi(*e: float) -> float:
        return float(_float_jet(energy, dict(parameters), *e).remainder)

    def limit(modulus: Callable[[float], float]) -> float:
        fine, coarse = modulus(_SMALL), modulus(2 * _SMALL)
        extrapolated = (4 * fine - coarse) / 3
        return extrapolated if abs(extrapolated) > 1e-3 * abs(fine) else 0.0  # only terms of higher order

    return (
        limit(lambda e: psi(e, -e, 0.0) / (2 * e**2)),
        limit(lambda e: (psi(e, e, e) + psi(-e, -e, -e)) / (9 * e**2)),
    )


def _faults(energy: Jet) -> Iterator[str]:
    """Yield reasons why an energy is not stress-free at ``F = I``."""
    for strain, slope in energy.slopes.items():
        match strain.split("_"):
            case "E", *families if families:
                where, remedy = f"along {' and '.join(families)}", "square what is 0 at F = I, such as I4_f - 1"
            case _:
                where, remedy = "in all directions", "take I1_bar or I2_bar, or add a multiple of ln(J)"
        yield f"is not stress-free at F = I, where it leaves {slope.value:g} Pa {where}; {remedy}"
    if energy.order < 2:
        yield "is not stress-free at F = I, where it has a kink; square what max, min or abs give"
