"""Laws as materials of FEBio (``<material>``, format 4.0)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from xml.sax.saxutils import quoteattr

from hpcinv.formats.cards.card import MOST_TERMS, Values, shown
from hpcinv.formats.cards.febio_sums import SUMS, Fibres, volume_lines
from hpcinv.physics.materials.moduli import young_and_poisson

PROGRAM = "FEBio"


def write(values: Values, name: str, fibres: Fibres | None = None) -> str:
    """Return the material of a law.

    Args:
        fibres: type and text of ``<fiber>`` by family; by default the map with the name of the family.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    if values.kind not in SUMS:
        values.writer(CARDS, "FEBio has no such energy")
    if values.is_incompressible:
        raise values.refusal(
            "FEBio has no exactly incompressible law; give a bulk modulus of 1000 shear moduli or more"
        )
    if values.kind in SUMS:
        directions = dict.fromkeys(values.law.families) | dict(fibres or {})
        given = {family: entry or ("map", family) for family, entry in directions.items()}
        title, lines = SUMS[values.kind](values, given)
    else:
        title, parameters = CARDS[values.kind](values)
        lines = [f"<{key}>{shown(value)}</{key}>" for key, value in parameters.items()] + _volume(values)
    body = "".join(f"  {line}\n" for line in lines)
    return f'<material id="1" name={quoteattr(name)} type={quoteattr(title)}>\n{body}</material>\n'


def _volume(values: Values) -> list[str]:
    """Return the lines of the volumetric energy of an uncoupled law."""
    volumetric = getattr(values.law, "volumetric", None)
    if values.kind == "hencky":
        if volumetric != "logarithmic":
            raise values.refusal("its volumetric energy is logarithmic; state 'volumetric: logarithmic'")
        return []
    return [] if volumetric is None else volume_lines(values)


type _Parameters = tuple[str, dict[str, float]]


def _elastic(title: str) -> Callable[[Values], _Parameters]:
    def write_moduli(values: Values) -> _Parameters:
        mu, lam = values["mu"], values["lam"]
        return title, {"E": mu * (3 * lam + 2 * mu) / (lam + mu), "v": lam / (2 * (lam + mu))}

    return write_moduli


def _hencky_card(values: Values) -> _Parameters:
    young, poisson = young_and_poisson(values["mu"], values.bulk)
    return "isotropic Hencky", {"E": young, "v": poisson}


def _ogden_card(values: Values) -> _Parameters:
    pairs = list(zip(values["mu"], values["alpha"], strict=True))
    if len(pairs) > MOST_TERMS:
        raise values.refusal(f"it has at most {MOST_TERMS} terms")
    return "Ogden", {key: x for i, (m, a) in enumerate(pairs, 1) for key, x in ((f"c{i}", m * a), (f"m{i}", a))}


CARDS: Mapping[str, Callable[[Values], _Parameters]] = {
    "neo-hookean": _elastic("neo-Hookean"),
    "st-venant-kirchhoff": _elastic("isotropic elastic"),
    "isochoric-neo-hookean": lambda v: ("incomp neo-Hookean", {"G": v["mu"]}),
    "mooney-rivlin": lambda v: ("Mooney-Rivlin", {"c1": v["c1"], "c2": v["c2"]}),
    "yeoh": lambda v: ("Yeoh", {name: v[name] for name in ("c1", "c2", "c3")}),
    "hencky": _hencky_card,
    "ogden": _ogden_card,
    "gent": lambda v: ("Gent", {"G": v["mu"], "Jm": v["jm"]}),
    "veronda-westmann": lambda v: ("Veronda-Westmann", {"c1": v["c1"], "c2": v["c2"]}),
    "arruda-boyce": lambda v: ("Arruda-Boyce", {"mu": v["mu"], "N": v["lambda_m"] ** 2}),
}
