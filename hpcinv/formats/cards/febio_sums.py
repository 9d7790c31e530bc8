"""Laws of FEBio with fibres, and laws by a formula: solid mixtures, whose stresses add up, and hyperelastic materials.

Source: FEBio's ``FEBioMech``: ``FEElasticMixture``, ``FEFiberExpPow``, ``FEHolzapfelUnconstrained``,
``FEGenericHyperelastic``, ``FEGenericTransIsoHyperelastic``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from typing import Any

import numpy as np

from hpcinv.base.quantity.expressions import Expression
from hpcinv.formats.cards.card import Values, shown
from hpcinv.formats.cards.febio_expression import COUPLED, UNCOUPLED, febio_expression
from hpcinv.physics.materials.isochoric import DILATATIONS

VOLUMETRIC = ("logarithmic", "simo-taylor", "quadratic", "simo-taylor")
"""Volumetric energies, in the order of FEBio's pressure models"""
type Fibres = Mapping[str, tuple[str, str]]
"""type and text of ``<fiber>`` by family"""
type _Composed = tuple[str, list[str]]
_TOTAL = {"I1", "I2", "J"}
"""invariants that uncoupled materials lack"""


def volume_lines(values: Values) -> list[str]:
    """Return the lines of the volumetric energy of an uncoupled law.

    Raises:
        UnknownLaw: FEBio has no such energy.
    """
    volumetric = values.law.volumetric  # type: ignore[attr-defined]
    if volumetric not in VOLUMETRIC:
        raise values.refusal(f"it has no volumetric energy '{volumetric}'")
    model = VOLUMETRIC.index(volumetric)
    return [f"<k>{shown(values.bulk)}</k>", f"<pressure_model>{model}</pressure_model>"]


def _solid(title: str, parameters: Mapping[str, float], *lines: str) -> str:
    numbers = "".join(f"<{key}>{shown(value)}</{key}>" for key, value in parameters.items())
    return f'<solid type="{title}">{numbers}{"".join(lines)}</solid>'


def _fibre(entry: tuple[str, str]) -> str:
    kind, text = entry
    return f'<fiber type="{kind}">{escape(text)}</fiber>'


def _neo_hookean(values: Values) -> str:
    return _solid("incomp neo-Hookean", {"G": values["mu"]}, *volume_lines(values))


def _exponential(k1: float, k2: float, entry: tuple[str, str]) -> str:
    """Return fibres with ``k1/(2 k2) (exp(k2 <I4 - 1>²) - 1)``."""
    return _solid("fiber-exp-pow", {"ksi": k1, "alpha": k2, "beta": 2.0}, _fibre(entry))


def _dispersed(values: Values, entry: tuple[str, str]) -> str:
    """Return one family of dispersed fibres: both families of FEBio's law, which coincide, each of half the stiffness.

    Without ``c`` and ``k`` there is no matrix.
    """
    kind, text = entry
    if kind != "vector":
        raise values.refusal("directions of dispersed fibres vary, and its axes of such fibres are of a material")
    along = np.array([float(part) for part in text.split(",")])
    across = np.eye(3)[np.abs(along).argmin()]
    second = ",".join(map(repr, across.tolist()))
    axes = f'<mat_axis type="vector"><a>{text}</a><d>{second}</d></mat_axis>'
    numbers = {"c": 0.0, "k1": values["k1"] / 2, "k2": values["k2"], "kappa": values["dispersion"], "gamma": 0.0}
    return _solid("HGO unconstrained", numbers | {"k": 0.0}, axes)


def _holzapfel_gasser_ogden(values: Values, fibres: Fibres) -> _Composed:
    def family(entry: tuple[str, str]) -> str:
        return _dispersed(values, entry) if values["dispersion"] else _exponential(values["k1"], values["k2"], entry)

    names: tuple[str, ...] = values.law.fibres  # type: ignore[attr-defined]
    return "solid mixture", [_neo_hookean(values), *(family(fibres[name]) for name in names)]


def _holzapfel_ogden(values: Values, fibres: Fibres) -> _Composed:
    if values["a_fs"]:
        raise values.refusal("it has no energy of the shear between fibres and sheets; a_fs must be 0")
    a, b = shown(values["a"]), shown(values["b"])
    law: Any = values.law
    lines = [_solid("uncoupled hyperelastic", {}, f"<W>{a}/(2*{b})*(exp({b}*(I1-3))-1)</W>", *volume_lines(values))]
    for stiffness, exponent, name in (("a_f", "b_f", law.fibre), ("a_s", "b_s", law.sheet)):
        if values[stiffness]:
            lines.append(_exponential(values[stiffness], values[exponent], fibres[name]))
    return "solid mixture", lines


def _transversely_isotropic(values: Values, fibres: Fibres) -> _Composed:
    energy = f"<W>{shown(values['k'])}/2*(I4-1)^2</W>"
    family = _fibre(fibres[values.law.fibre])  # type: ignore[attr-defined]
    return "solid mixture", [_neo_hookean(values), _solid("trans-iso hyperelastic", {}, energy, family)]


def _by_formula(values: Values, fibres: Fibres) -> _Composed:
    """Return a hyperelastic material; uncoupled if all its invariants are of ``C_bar``."""
    law: Any = values.law
    if len(fibres) > 1:
        raise values.refusal("its hyperelastic materials have one family of fibres")
    energy, has_volume = _energy(values), getattr(law, "kappa", None) is not None
    numbers = {name: values[name] for name in energy.names if name in law.quantities()}
    if values.kind == "formula":  # parameters are numbers in SI, and the energy is in the unit of the card
        numbers = {name: float(law.parameters[name].value) for name in numbers}
    is_isochoric = getattr(law, "strain", "") == "isochoric"
    is_uncoupled = is_isochoric or (has_volume and not energy.names & _TOTAL and not fibres)
    if is_uncoupled:
        title, lines = "uncoupled hyperelastic", volume_lines(values)
    else:
        title, lines = "hyperelastic", []
        if has_volume:
            volume = DILATATIONS[law.volumetric][0]
            energy = Expression(f"{energy.source} + {volume}", energy.definitions)
            numbers |= {"kappa": float(law.kappa) if values.kind == "formula" else values["kappa"]}
    try:
        written = febio_expression(energy, numbers, UNCOUPLED if is_uncoupled else COUPLED)
    except ValueError as error:
        raise values.refusal(str(error)) from None
    if values.kind == "formula" and values.size != 1:
        written = f"({written})/{shown(values.size)}"
    own = [_fibre(entry) for entry in fibres.values()]
    return title.replace("hyperelastic", "trans-iso hyperelastic") if fibres else title, [
        f"<W>{written}</W>",
        *lines,
        *own,
    ]


def _energy(values: Values) -> Expression:
    """Return the energy of a law without its volumetric part; of C_bar, as a formula of C, if it is isochoric."""
    law: Any = values.law
    if values.kind == "formula":
        return law.energy  # type: ignore[no-any-return]
    return Expression(law.formula if getattr(law, "strain", "") == "isochoric" else law.own_formula)


SUMS: Mapping[str, Callable[[Values, Fibres], _Composed]] = {
    "holzapfel-gasser-ogden": _holzapfel_gasser_ogden,
    "holzapfel-ogden": _holzapfel_ogden,
    "transversely-isotropic": _transversely_isotropic,
    "fung-demiray": _by_formula,
    "guccione": _by_formula,
    "formula": _by_formula,
}
