"""Elastic laws of FEBio as sections of a job; each from the stress in its source, ``FEBioMech`` at the same commit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from .feb_reader import Block, Entry, Floats, Model

POINTS = 8
"""Gauss points of the integral over the stretch of a fibre; more change no digit of 12 at 2 % to 80 % of stretch."""
TERMS = 20
"""Terms of the series of the inverse Langevin function; more change no digit of 12 up to half the limiting stretch."""
RELAXED = 30.0
"""Relaxation times under the same load after which a viscoelastic body is elastic: 1e-13 is left of the rest."""


class UnknownLaw(Exception):
    """A law that has no counterpart here; the message is its name."""


@dataclass(frozen=True)
class Law:
    """Sections of a job for a law.

    Attributes:
        fibres: constant directions, or the name of an array of the mesh, by family.
        definitions: the job's section ``let``.
        arrays: values (elements, components) by name.
    """

    material: Mapping[str, Any]
    fibres: Mapping[str, Floats | str] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)
    effects: tuple[Mapping[str, Any], ...] = ()
    arrays: Mapping[str, Floats] = field(default_factory=dict)


def law_of(model: Model, block: Block) -> Law:
    """Return the law of a block of elements.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    material = model.materials.get(block.material)
    if material is None or material.type not in LAWS:
        raise UnknownLaw(f"law {material.type}" if material else f"elements '{block.name}' without a material")
    return LAWS[material.type](material, model, block)


def _neo_hookean(law: Entry, model: Model, block: Block) -> Law:
    return Law({"law": "neo-hookean", "young": law.number("E"), "poisson": law.number("v")})


def _holmes_mow(law: Entry, model: Model, block: Block) -> Law:
    young, poisson = law.number("E"), law.number("v")
    lam, mu = poisson * young / ((1 + poisson) * (1 - 2 * poisson)), young / 2 / (1 + poisson)
    energy = "ha/(4*b)*(exp(b*((2*mu - lam)*(I1 - 3) + lam*(I2 - 3))/ha)/J**(2*b) - 1)"
    values = {"ha": f"{lam + 2 * mu:.17g} Pa", "mu": f"{mu:.17g} Pa", "lam": f"{lam:.17g} Pa", "b": law.number("beta")}
    return Law({"law": "formula", "energy": energy, "parameters": values})


def _orthotropic(law: Entry, model: Model, block: Block) -> Law:
    energy, values = f"unit/2*({_quadratic(*_moduli(law))})", {"unit": "1 Pa"}
    return Law({"law": "formula", "energy": energy, "parameters": values}, _axes(law, model, block))


def _fung_orthotropic(law: Entry, model: Model, block: Block) -> Law:
    c = law.number("c")
    lam, mu = _moduli(law)
    values = {"c": f"{c:.17g} Pa", "k": f"{law.number('k'):.17g} Pa"}
    energy = f"c/2*(exp({_quadratic(lam / c, mu / c)}) - 1) + k/2*ln(J)**2"
    return Law({"law": "formula", "energy": energy, "parameters": values}, _axes(law, model, block))


def _arruda_boyce(law: Entry, model: Model, block: Block) -> Law:
    """The energy of the inverse Langevin function in powers of I1, which no series of stresses is needed for."""
    chain = law.number("N")
    series = inverse_langevin(min(TERMS, int(law.number("n_term"))))
    at_rest = sum(c * chain ** -(k + 0.5) for k, c in enumerate(series))
    powers = " + ".join(f"{c / (2 * k + 2):.17g}*(I1/(3*n))**{k + 1}" for k, c in enumerate(series))
    # their W10 ln J: ksi N beta0/(3 sqrt N)
    energy = f"ksi*n*({powers}) - ksi*{at_rest * chain**0.5 / 3:.17g}*ln(J) + k*(J**2/2 - ln(J))"
    values = {"ksi": f"{law.number('ksi'):.17g} Pa", "n": chain, "k": f"{law.number('kappa'):.17g} Pa"}
    return Law({"law": "formula", "energy": energy, "parameters": values})


def _trans_iso(law: Entry, model: Model, block: Block) -> Law:
    values = {name: f"{law.number(name):.17g} Pa" for name in ("c1", "c2", "c3", "c5", "k")}
    parameters = {**values, "c4": law.number("c4"), "limit": law.number("lam_max")}
    energy = (
        "c1*(I1 - 3) + c2*(I2 - 3) - 2*(c1 + 2*c2)*ln(J) + k/2*ln(J)**2 + c3*integral + c5*max(stretch - limit, 0)"
        " + (c3*(exp(c4*(limit - 1)) - 1) - c5*limit)*ln(max(stretch, limit)/limit)"
    )
    definitions = {
        "stretch": "sqrt(I4_f)",
        "s": f"min(max(stretch - 1, 0), {law.number('lam_max') - 1:.17g})",
        "integral": exponential_integral("s", "c4"),
    }
    fibre = law.part("fiber")
    if fibre is None:
        raise UnknownLaw(f"law {law.type} without fibres")
    arrays = {"f": _directions(fibre, model, block)}
    return Law({"law": "formula", "energy": energy, "parameters": parameters}, {"f": "f"}, definitions, arrays=arrays)


def _prestrained(law: Entry, model: Model, block: Block) -> Law:
    elastic, prestrain = law.part("elastic"), law.part("prestrain")
    if elastic is None or prestrain is None or elastic.type not in LAWS:
        raise UnknownLaw(f"law {law.type} of {elastic.type if elastic else 'nothing'}")
    inner = LAWS[elastic.type](elastic, model, block)
    directions = inner.arrays["f"]
    if prestrain.type == "in-situ stretch":
        stretch = _mapped(prestrain, "stretch", model, len(block.nodes))[:, :, None]
        across = 1 / np.sqrt(stretch) if prestrain.values.get("isochoric", "1") == "1" else np.ones_like(stretch)
        along = directions[:, :, None] * directions[:, None, :]
        gradient = stretch * along + across * (np.eye(3) - along)
    elif prestrain.type == "prestrain gradient":
        scale = prestrain.number("ramp", 1.0)
        gradient = np.eye(3) + scale * (_mapped(prestrain, "F0", model, len(block.nodes)).reshape(-1, 3, 3) - np.eye(3))
    else:
        raise UnknownLaw(f"prestrain {prestrain.type}")
    # their tensor leads from the relaxed piece to the body, ours back; their fibres lie in the relaxed piece
    carried = np.einsum("eij,ej->ei", gradient, directions)
    arrays = {"F0": np.linalg.inv(gradient).reshape(-1, 9), "f": carried}
    effects = ({"effect": "prestrain", "given_on": "reference", "tensor": {"data": "F0"}},)
    return Law(inner.material, inner.fibres, inner.definitions, effects, arrays)


def _viscoelastic(law: Entry, model: Model, block: Block) -> Law:
    """The elastic law that is left at the end."""
    elastic, long_term = law.part("elastic"), law.number("g0", 1.0)
    times = [law.number(f"t{i}", 1.0) for i in range(1, 7) if law.number(f"g{i}", 0.0)]
    if elastic is None or elastic.type not in LAWS or long_term != 1 or model.rest < RELAXED * max(times, default=0):
        raise UnknownLaw(f"law {law.type} before it is at rest")
    return LAWS[elastic.type](elastic, model, block)


def _mapped(entry: Entry, name: str, model: Model, count: int) -> Floats:
    """Values (elements, components) of a parameter that a map or one number gives."""
    if name in entry.maps:
        return model.element_data[entry.maps[name]][1]
    return np.full((count, 1), entry.number(name))


LAWS: Mapping[str, Callable[[Entry, Model, Block], Law]] = {
    "neo-Hookean": _neo_hookean,
    "Holmes-Mow": _holmes_mow,
    "orthotropic elastic": _orthotropic,
    "Fung-ortho-compressible": _fung_orthotropic,
    "Arruda-Boyce unconstrained": _arruda_boyce,
    "coupled trans-iso Mooney-Rivlin": _trans_iso,
    "prestrain elastic": _prestrained,
    "viscoelastic": _viscoelastic,
}


def _moduli(law: Entry) -> tuple[Floats, Floats]:
    """Lamé's parameters (3, 3) and (3,) of an orthotropic law by its engineering constants."""
    e1, e2, e3 = (law.number(f"E{i}") for i in (1, 2, 3))
    g12, g23, g31 = (law.number(name) for name in ("G12", "G23", "G31"))
    v12, v23, v31 = (law.number(name) for name in ("v12", "v23", "v31"))
    mu = np.array([g12 + g31 - g23, g12 - g31 + g23, -g12 + g31 + g23])
    compliance = [[1 / e1, -v12 / e1, -v31 / e3], [-v12 / e1, 1 / e2, -v23 / e2], [-v31 / e3, -v23 / e2, 1 / e3]]
    return np.linalg.inv(compliance) - 2 * np.diag(mu), mu


def _quadratic(lam: Floats, mu: Floats) -> str:
    """Twice the energy of an orthotropic law of the strains along three families a, b, c at right angles.

    Its isotropic part is written in I1 and I2, from which a formula's law takes its moduli.
    """
    shear, stretch = float(mu.mean()), float(lam.mean())
    terms = [f"{2 * shear:.17g}*(I1**2 - 2*I2 - 2*I1 + 3)/4", f"{stretch:.17g}*((I1 - 3)/2)**2"]
    terms += [f"{2 * (m - shear):.17g}*(I5_{f} - 2*I4_{f} + 1)/4" for m, f in zip(mu, "abc", strict=True)]
    strain = [f"(I4_{name} - 1)/2" for name in "abc"]
    terms += [f"{lam[i, j] - stretch:.17g}*{strain[i]}*{strain[j]}" for i in range(3) for j in range(3)]
    return " + ".join(terms)


def _axes(law: Entry, model: Model, block: Block) -> dict[str, Floats | str]:
    """Directions of the material axes; by default the axes of the coordinates."""
    axes = law.part("mat_axis")
    if block.name in model.mat_axes or (axes is not None and axes.type != "vector"):
        raise UnknownLaw(f"law {law.type} with axes that are not constant")
    first, second = (np.eye(3)[0], np.eye(3)[1]) if axes is None else (axes.vector("a"), axes.vector("d"))
    third = np.cross(first, second)
    frame = (first, np.cross(third, first), third)
    return {name: axis / np.linalg.norm(axis) for name, axis in zip("abc", frame, strict=True)}


def _directions(fibre: Entry, model: Model, block: Block) -> Floats:
    """Unit directions (elements, 3) of fibres."""
    if fibre.type == "vector":
        directions = np.tile(fibre.vector("vector"), (len(block.nodes), 1))
    elif fibre.type == "local":
        start, end = (int(number) - 1 for number in fibre.values["local"].split(","))
        order = np.argsort(model.numbers)
        rows = order[np.searchsorted(model.numbers, block.nodes[:, [start, end]], sorter=order)]
        directions = model.points[rows[:, 1]] - model.points[rows[:, 0]]
    else:
        raise UnknownLaw(f"fibres {fibre.type}")
    units: Floats = directions / np.linalg.norm(directions, axis=1)[:, None]
    return units


def exponential_integral(strain: str, factor: str) -> str:
    """Return a formula of the integral of (exp(factor (l - 1)) - 1)/l over the stretch l from 1 to 1 + strain."""
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    terms = (
        f"{w / 2:.17g}*(exp({(x + 1) / 2:.17g}*{factor}*{strain}) - 1)/(1 + {(x + 1) / 2:.17g}*{strain})"
        for x, w in zip(nodes, weights, strict=True)
    )
    return f"{strain}*({' + '.join(terms)})"


def inverse_langevin(terms: int) -> list[float]:
    """Return the coefficients of x, x³, x⁵, … of the inverse of coth b - 1/b, by exact reversion of its series."""
    # L(b) b sinh b = b cosh b - sinh b, in powers of b²
    factorial = [1]
    for i in range(1, 2 * terms + 4):
        factorial.append(factorial[-1] * i)
    top = [Fraction(1, factorial[2 * k + 2]) - Fraction(1, factorial[2 * k + 3]) for k in range(terms)]
    bottom = [Fraction(1, factorial[2 * k + 1]) for k in range(terms)]
    langevin: list[Fraction] = []
    for k in range(terms):
        langevin.append(top[k] - sum((langevin[i] * bottom[k - i] for i in range(k)), Fraction(0)))
    inverse = [1 / langevin[0]]
    for k in range(1, terms):
        # coefficient of x^(2k+1) in L(inverse(x)) without the next term of the inverse, which must cancel it
        power, square = [*inverse, Fraction(0)], _product(inverse, inverse, k + 1)
        rest = Fraction(0)
        for i in range(k + 1):
            rest += langevin[i] * power[k]
            power = _product(power, [Fraction(0), *square], k + 1)
        inverse.append(-rest / langevin[0])
    return [float(c) for c in inverse]


def _product(a: list[Fraction], b: list[Fraction], count: int) -> list[Fraction]:
    """First coefficients of the product of two series."""
    a, b = ([*series, *[Fraction(0)] * count] for series in (a, b))
    return [sum((a[i] * b[k - i] for i in range(k + 1)), Fraction(0)) for k in range(count)]
