"""Materials of FEBio (``<material>``, format 4.0); with the energies of its source (``FEBioMech``)."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.units import parse_unit
from hpcinv.base.reading.coordinate_frames import frame_of
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.feb_model import local_name, local_nodes, model_of
from hpcinv.formats.cards.card import (
    MOST_TERMS,
    Card,
    CardError,
    Counterpart,
    Direction,
    Stress,
    UnknownLaw,
    chosen,
    dispersed_fibres,
    polynomial,
)
from hpcinv.formats.cards.entry import Entry, entry_of
from hpcinv.formats.cards.febio_curves import LoadCurves
from hpcinv.formats.cards.febio_hyperelastic import fibres_in_a_plane, hyperelastic_energy
from hpcinv.formats.cards.febio_mixture import exponential_fibres, isochoric_sum_of, sum_of, toe_fibres
from hpcinv.formats.cards.febio_sums import VOLUMETRIC
from hpcinv.formats.cards.febio_writer import PROGRAM as PROGRAM
from hpcinv.formats.cards.febio_writer import write as write
from hpcinv.formats.cards.orthotropic import FAMILIES, lame, orthotropic, quadratic, stiffness_of
from hpcinv.formats.cards.series import exponential_integral, inverse_langevin

TERMS = 20
"""Terms of the series of the inverse Langevin function; more change no digit of 12 up to half the limiting stretch."""
_PRESSURE_MODELS = ("default", "NIKE3D", "Abaqus", "Abaqus (GOH)")
"""in the order of `VOLUMETRIC`"""
_WITHOUT_EFFECT = ("density",)
_FORMULA = "state an energy in a job, by 'law: formula'"


def root_of(text: str) -> ET.Element:
    """Return the root of a model file.

    Raises:
        CardError: it is not XML, or defines entities.
    """
    try:
        return model_of(text.encode())
    except Fault as fault:
        raise CardError(fault.text) from None


def read(text: str, name: str | None = None) -> Card:
    """Return a material of a model, or of a text with an element ``<material>``.

    Raises:
        CardError: it is damaged, or has no counterpart.
    """
    root = root_of(text)
    items = [root] if root.tag == "material" else list(root.iter("material"))
    named_items = {item.get("name") or item.get("id") or "": item for item in items}
    selected = chosen(named_items, name)
    is_model = root.tag == "febio_spec"
    law = entry_of(named_items[selected], LoadCurves(root).at_end if is_model else _no_curve)
    notes = tuple(
        f"<{key}> is not part of the law: state a density where an effect needs it"
        for key in _WITHOUT_EFFECT
        if key in law.values
    )
    if _has_curve(law):
        notes += ("parameters with load curves have their values at the end",)
    converted = counterpart(law)
    unit = _unit((root.findtext("Module/units") or "").strip())
    return Card(selected, law.type, replace(converted, notes=converted.notes + notes), unit)


def _has_curve(law: Entry) -> bool:
    return bool(law.factors) or any(map(_has_curve, law.parts))


def _no_curve(number: str) -> float:
    raise CardError(f"a parameter follows load curve {number}; write its value")


def _unit(system: str) -> str:
    """Return the unit of stress of a system such as ``mm-N-s``; empty if it is not stated."""
    if system == "SI":
        return "Pa"
    length, _, rest = system.partition("-")
    base, _, time = rest.partition("-")
    try:
        if parse_unit(base)[1] == parse_unit("N")[1]:
            return f"{base}/{length}^2"
        if parse_unit(base)[1] == parse_unit("kg")[1] and length and time:
            return f"{base}/{length}/{time}^2"
    except ValueError:
        pass
    return ""


def counterpart(law: Entry) -> Counterpart:
    """Return the law of a material.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    if law.type not in LAWS:
        remedy = "leave it out, and give its surface a support" if law.type == "rigid body" else _FORMULA
        raise UnknownLaw(f"law {law.type} has no counterpart; {remedy}")
    return LAWS[law.type](law)


def _volumetric(law: Entry, default: int = 0) -> str:
    """Return the volumetric energy of an uncoupled law.

    Args:
        default: number of its pressure model, if the card has none.
    """
    model = law.values.get("pressure_model", str(default))
    if model in _PRESSURE_MODELS:
        return VOLUMETRIC[_PRESSURE_MODELS.index(model)]
    if model in map(str, range(len(VOLUMETRIC))):
        return VOLUMETRIC[int(model)]
    raise UnknownLaw(f"law {law.type} with pressure_model {model} has no counterpart; {_FORMULA}")


def _uncoupled(law: Entry, material: Mapping[str, Any]) -> Counterpart:
    """Return an uncoupled law with its bulk modulus and volumetric energy."""
    bulk = law.number("k")
    modulus = {"d1": Stress(bulk / 2)} if material["law"] == "mooney-rivlin" else {"kappa": Stress(bulk)}
    return Counterpart({**material, **modulus, "volumetric": _volumetric(law)})


def _neo_hookean(law: Entry) -> Counterpart:
    return Counterpart({"law": "neo-hookean", "young": Stress(law.number("E")), "poisson": law.number("v")})


def _isotropic_elastic(law: Entry) -> Counterpart:
    return Counterpart({"law": "st-venant-kirchhoff", "young": Stress(law.number("E")), "poisson": law.number("v")})


def _hencky(law: Entry) -> Counterpart:
    return Counterpart({"law": "hencky", "young": Stress(law.number("E")), "poisson": law.number("v")})


def _incompressible_neo_hookean(law: Entry) -> Counterpart:
    return _uncoupled(law, {"law": "isochoric-neo-hookean", "mu": Stress(law.number("G"))})


def _mooney_rivlin(law: Entry) -> Counterpart:
    return _uncoupled(
        law, {"law": "mooney-rivlin", "c1": Stress(law.number("c1")), "c2": Stress(law.number("c2", 0.0))}
    )


def _yeoh(law: Entry) -> Counterpart:
    # without its volumetric part, whose modulus is not a compliance here
    isochoric = polynomial({(i, 0): law.number(f"c{i}", 0.0) for i in range(1, MOST_TERMS + 1)}, [])
    return _uncoupled(law, {key: value for key, value in isochoric.material.items() if key != "kappa"})


def _ogden(law: Entry) -> Counterpart:
    terms = [(law.number(f"c{i}", 0.0), law.number(f"m{i}", 1.0)) for i in range(1, MOST_TERMS + 1)]
    used = [(c, m) for c, m in terms if c]
    if not all(m for _, m in used):
        raise CardError("law Ogden: an exponent is 0")
    material = {"law": "ogden", "mu": [Stress(c / m) for c, m in used], "alpha": [m for _, m in used]}
    return _uncoupled(law, material)


def _gent(law: Entry) -> Counterpart:
    return _uncoupled(law, {"law": "gent", "mu": Stress(law.number("G")), "jm": law.number("Jm")})


def _veronda_westmann(law: Entry) -> Counterpart:
    return _uncoupled(law, {"law": "veronda-westmann", "c1": Stress(law.number("c1")), "c2": law.number("c2")})


def _arruda_boyce(law: Entry) -> Counterpart:
    chain = law.number("N", 1.0)
    if chain <= 0:
        raise CardError("law Arruda-Boyce: N must be above 0")
    return _uncoupled(law, {"law": "arruda-boyce", "mu": Stress(law.number("mu")), "lambda_m": math.sqrt(chain)})


def _dispersed_fibres(law: Entry) -> Counterpart:
    angle = math.radians(law.number("gamma"))
    first, second, _ = _axes(law)
    directions = {
        f"fibre{i}": (math.cos(angle) * first + sign * math.sin(angle) * second).tolist()
        for i, sign in enumerate((1, -1), start=1)
    }
    constants = (law.number("c"), law.number("k1"), law.number("k2"), law.number("kappa"))
    converted = dispersed_fibres(*constants, Stress(law.number("k")), directions)
    return Counterpart(
        {**converted.material, "volumetric": _volumetric(law, default=3)}, converted.fibres, notes=converted.notes
    )


def _coupled_mooney_rivlin(law: Entry) -> Counterpart:
    energy = "c1*(I1 - 3) + c2*(I2 - 3) - 2*(c1 + 2*c2)*ln(J) + k/2*ln(J)**2"
    parameters = {name: Stress(law.number(name)) for name in ("c1", "c2", "k")}
    return Counterpart({"law": "formula", "energy": energy, "parameters": parameters})


def _holmes_mow(law: Entry) -> Counterpart:
    young, poisson = law.number("E"), law.number("v")
    lam, mu = poisson * young / ((1 + poisson) * (1 - 2 * poisson)), young / 2 / (1 + poisson)
    energy = "ha/(4*b)*(exp(b*((2*mu - lam)*(I1 - 3) + lam*(I2 - 3))/ha)/J**(2*b) - 1)"
    values = {"ha": Stress(lam + 2 * mu), "mu": Stress(mu), "lam": Stress(lam), "b": law.number("beta")}
    return Counterpart({"law": "formula", "energy": energy, "parameters": values})


def _orthotropic(law: Entry) -> Counterpart:
    return orthotropic(*_moduli(law), _families(law))


def _fung_orthotropic(law: Entry) -> Counterpart:
    c = law.number("c")
    lam, mu = lame(*_moduli(law))
    values = {"c": Stress(c), "k": Stress(law.number("k"))}
    energy = f"c/2*(exp({quadratic(lam / c, mu / c)}) - 1) + k/2*ln(J)**2"
    return Counterpart({"law": "formula", "energy": energy, "parameters": values}, _families(law))


def _arruda_boyce_unconstrained(law: Entry) -> Counterpart:
    """The energy of the inverse Langevin function in powers of I1; it needs no series of stresses."""
    chain = law.number("N")
    series = inverse_langevin(min(TERMS, int(law.number("n_term"))))
    at_rest = sum(c * chain ** -(k + 0.5) for k, c in enumerate(series))
    powers = " + ".join(f"{c / (2 * k + 2):.17g}*(I1/(3*n))**{k + 1}" for k, c in enumerate(series))
    # their W10 ln J: ksi N beta0/(3 sqrt N)
    energy = f"ksi*n*({powers}) - ksi*{at_rest * chain**0.5 / 3:.17g}*ln(J) + k*(J**2/2 - ln(J))"
    values = {"ksi": Stress(law.number("ksi")), "n": chain, "k": Stress(law.number("kappa"))}
    return Counterpart({"law": "formula", "energy": energy, "parameters": values})


def _coupled_trans_iso(law: Entry) -> Counterpart:
    parameters, energy, definitions = _fibre(law, "sqrt(I4_f)")
    parameters |= {name: Stress(law.number(name)) for name in ("c1", "c2", "k")}
    energy = f"c1*(I1 - 3) + c2*(I2 - 3) - 2*(c1 + 2*c2)*ln(J) + k/2*ln(J)**2 + {energy}"
    return Counterpart({"law": "formula", "energy": energy, "parameters": parameters}, _family(law), definitions)


def _trans_iso_mooney_rivlin(law: Entry) -> Counterpart:
    return _uncoupled_trans_iso(law, "c1*(I1_bar - 3) + c2*(I2_bar - 3)", Stress(law.number("c2", 0.0)))


def _trans_iso_veronda_westmann(law: Entry) -> Counterpart:
    return _uncoupled_trans_iso(law, "c1*(exp(c2*(I1_bar - 3)) - 1) - c1*c2*(I2_bar - 3)/2", law.number("c2"))


def _uncoupled_trans_iso(law: Entry, matrix: str, c2: Stress | float) -> Counterpart:
    parameters, energy, definitions = _fibre(law, "sqrt(I4_f)*J**(-1/3)")
    parameters |= {"c1": Stress(law.number("c1")), "c2": c2}
    material = {"law": "formula", "energy": f"{matrix} + {energy}", "parameters": parameters}
    bulk = {"kappa": Stress(law.number("k")), "volumetric": _volumetric(law)}
    return Counterpart(material | bulk, _family(law), definitions)


def _hyperelastic(law: Entry) -> Counterpart:
    energy, parameters = hyperelastic_energy(law)
    material: dict[str, Any] = {"law": "formula", "energy": energy, "parameters": parameters}
    if law.type.startswith("uncoupled"):
        material |= {"kappa": Stress(law.number("k")), "volumetric": _volumetric(law)}
    return Counterpart(material, _family(law) if "trans-iso" in law.type else {})


def _unconstrained_fibres(law: Entry) -> Counterpart:
    energy, parameters = fibres_in_a_plane(law)
    directions = _plane_fibres(law) if law.number("gamma") else {"f": _axes(law)[0].tolist()}
    return Counterpart({"law": "formula", "energy": energy, "parameters": parameters}, directions)


def _plane_fibres(law: Entry) -> dict[str, Direction]:
    """Return two families at the angles gamma and -gamma to the first axis of the material."""
    angle = math.radians(law.number("gamma"))
    first, second, _ = _axes(law)
    pairs = (("f", 1), ("g", -1))
    return {name: (math.cos(angle) * first + sign * math.sin(angle) * second).tolist() for name, sign in pairs}


def _fibre(law: Entry, stretch: str) -> tuple[dict[str, Any], str, dict[str, str]]:
    """Return parameters, energy and definitions of fibres whose stress is exponential and then linear."""
    if law.part("active_contraction") is not None:
        raise UnknownLaw(f"law {law.type} with active_contraction has no counterpart; state an active stress in a job")
    limit, c4, c5 = law.number("lam_max", 1.0), law.number("c4", 0.0), law.number("c5", 0.0)
    c3 = law.number("c3", 0.0)
    if not c3 and c4:  # as FEBio does, for a stress without a jump
        c3 = c5 / c4 * math.exp(-c4 * (limit - 1))
    parameters = {"c3": Stress(c3), "c5": Stress(c5), "c4": c4, "limit": limit}
    energy = (
        "c3*integral + c5*max(stretch - limit, 0)"
        " + (c3*(exp(c4*(limit - 1)) - 1) - c5*limit)*ln(max(stretch, limit)/limit)"
    )
    definitions = {
        "stretch": stretch,
        "s": f"min(max(stretch - 1, 0), {limit - 1:.17g})",
        "integral": exponential_integral("s", "c4"),
    }
    return parameters, energy, definitions


def _family(law: Entry) -> dict[str, Direction]:
    fibre = law.part("fiber")
    if fibre is None and "fiber" in law.maps:
        return {"f": law.maps["fiber"]}
    if fibre is None:
        raise UnknownLaw(f"law {law.type} without <fiber> has no counterpart; give the direction of its fibres")
    direction = _direction(fibre)
    if law.part("mat_axis") is None:
        return {"f": direction}
    if direction is None or isinstance(direction, str):
        raise UnknownLaw(f"law {law.type} with <mat_axis> and fibres that vary has no counterpart; state 'fibres'")
    return {"f": (np.array(direction) @ np.array(_axes(law))).tolist()}


def _mixture(law: Entry) -> Counterpart:
    return sum_of(_solids(law, [part for part in law.parts if part.tag == "solid"], {**LAWS, **_FIBRE_LAWS}))


def _uncoupled_mixture(law: Entry) -> Counterpart:
    """The isochoric energies of the solids, and the volumetric energy of the mixture, which has the modulus."""
    # FEBio 4 does not use the moduli of the solids, which may be missing or 0.
    parts = [replace(part, values={**part.values, "k": "1"}) for part in law.parts if part.tag == "solid"]
    if "k" not in law.values:
        raise UnknownLaw(f"law {law.type} without k has no counterpart; give the bulk modulus of the mixture")
    converted = isochoric_sum_of(_solids(law, parts, _UNCOUPLED))
    volume = {"kappa": Stress(law.number("k")), "volumetric": _volumetric(law)}
    return replace(converted, material={**converted.material, **volume})


def _solids(law: Entry, parts: Sequence[Entry], known: Collection[str]) -> list[tuple[str, Counterpart]]:
    """Return type and law of the solids of a mixture."""
    if unknown := [part.type for part in parts if part.type not in known]:
        raise UnknownLaw(f"law {law.type} with {', '.join(unknown)} has no counterpart; {_FORMULA}")
    if not parts:
        raise CardError(f"law {law.type} has no <solid>")
    laws = [(part.type, _fibre_law(part) if part.type in _FIBRE_LAWS else counterpart(part)) for part in parts]
    if law.part("mat_axis") is not None and any(converted.fibres for _, converted in laws):
        raise UnknownLaw(f"law {law.type} with <mat_axis> has no counterpart; state the axes in its solids")
    return laws


def _fibre_law(law: Entry) -> Counterpart:
    """Return a law of fibres alone, which only a mixture may have."""
    energy, parameters = _FIBRE_LAWS[law.type](law)
    return Counterpart({"law": "formula", "energy": energy, "parameters": parameters}, _family(law))


_FIBRE_LAWS: Mapping[str, Callable[[Entry], tuple[str, dict[str, Any]]]] = {
    "fiber-exp-pow": exponential_fibres,
    "fiber-exp-pow-uncoupled": exponential_fibres,
    "fiber-pow-linear": toe_fibres,
}


LAWS: Mapping[str, Callable[[Entry], Counterpart]] = {
    "neo-Hookean": _neo_hookean,
    "isotropic elastic": _isotropic_elastic,
    "isotropic Hencky": _hencky,
    "incomp neo-Hookean": _incompressible_neo_hookean,
    "Mooney-Rivlin": _mooney_rivlin,
    "Yeoh": _yeoh,
    "Ogden": _ogden,
    "Gent": _gent,
    "Veronda-Westmann": _veronda_westmann,
    "Arruda-Boyce": _arruda_boyce,
    "Holzapfel-Gasser-Ogden": _dispersed_fibres,
    "HGO unconstrained": _unconstrained_fibres,
    **dict.fromkeys(("hyperelastic", "uncoupled hyperelastic"), _hyperelastic),
    **dict.fromkeys(("trans-iso hyperelastic", "uncoupled trans-iso hyperelastic"), _hyperelastic),
    "coupled Mooney-Rivlin": _coupled_mooney_rivlin,
    "Holmes-Mow": _holmes_mow,
    "orthotropic elastic": _orthotropic,
    "Fung-ortho-compressible": _fung_orthotropic,
    "Arruda-Boyce unconstrained": _arruda_boyce_unconstrained,
    "coupled trans-iso Mooney-Rivlin": _coupled_trans_iso,
    "trans iso Mooney-Rivlin": _trans_iso_mooney_rivlin,
    "trans iso Veronda-Westmann": _trans_iso_veronda_westmann,
    "solid mixture": _mixture,
    "uncoupled solid mixture": _uncoupled_mixture,
}
_UNCOUPLED = (
    "incomp neo-Hookean",
    "Mooney-Rivlin",
    "Yeoh",
    "Gent",
    "Veronda-Westmann",
    "Arruda-Boyce",
    "trans iso Mooney-Rivlin",
    "trans iso Veronda-Westmann",
    "fiber-exp-pow-uncoupled",
)
"""solids that an uncoupled mixture may have"""


def _moduli(law: Entry) -> tuple[Floats, tuple[float, float, float]]:
    """Return the stiffness (3, 3) of normal strains and the shear moduli of an orthotropic law."""
    e1, e2, e3 = (law.number(f"E{i}") for i in (1, 2, 3))
    v12, v23, v31 = (law.number(name) for name in ("v12", "v23", "v31"))
    v13 = v31 * e1 / e3 if e3 else 0.0  # the compliance is symmetric
    g12, g23, g31 = (law.number(name) for name in ("G12", "G23", "G31"))
    return stiffness_of((e1, e2, e3), v12, v13, v23), (g12, g23, g31)


def _axes(law: Entry) -> tuple[Floats, Floats, Floats]:
    """Return the material axes; by default the axes of the coordinates."""
    axes = law.part("mat_axis")
    if axes is not None and axes.type != "vector":
        raise UnknownLaw(f"law {law.type} with axes that are not constant has no counterpart; state 'fibres' in a job")
    first, second = (np.eye(3)[0], np.eye(3)[1]) if axes is None else (axes.vector("a"), axes.vector("d"))
    frame = frame_of(first, second)
    if frame is None:
        raise CardError(f"law {law.type}: the axes a and d are parallel")
    return frame[0], frame[1], frame[2]


def _families(law: Entry) -> dict[str, Sequence[float]]:
    return {name: axis.tolist() for name, axis in zip(FAMILIES, _axes(law), strict=True)}


def _direction(fibre: Entry) -> Direction:
    """Return the unit direction of fibres, or the name of its array; ``None`` if it varies in another way."""
    if fibre.type == "local":
        text = fibre.values.get("local") or fibre.values.get("", "0,0")
        try:
            return local_name(local_nodes(text))
        except ValueError:
            raise CardError(f"fibres from local node to node {text!r}: name two different nodes") from None
    if fibre.type == "angles":
        theta, phi = (math.radians(fibre.number(name, at)) for name, at in (("theta", 0.0), ("phi", 90.0)))
        return [math.cos(theta) * math.sin(phi), math.sin(theta) * math.sin(phi), math.cos(phi)]
    if fibre.type != "vector":
        return None
    direction = fibre.vector("vector" if "vector" in fibre.values else "")
    if not direction.any():
        raise CardError("fibres of direction 0")
    unit: list[float] = (direction / np.linalg.norm(direction)).tolist()
    return unit
