"""Cards of Abaqus and CalculiX: ``*HYPERELASTIC``, Holzapfel's ``*ANISOTROPIC HYPERELASTIC``, ``*ELASTIC``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from hpcinv.base.reading.abaqus_keywords import Keyword, keywords_of_text
from hpcinv.formats.cards.abaqus_elastic import elastic_law, is_isotropic
from hpcinv.formats.cards.card import (
    MOST_TERMS,
    Card,
    CardError,
    Counterpart,
    Stress,
    UnknownLaw,
    Values,
    bulk_from,
    chosen,
    dispersed_fibres,
    number,
    polynomial,
    shown,
    triangle,
)

PROGRAM = "Abaqus"
_PER_LINE = 8
NO_TERM = 1e20
"""``D`` of a term that is not there, in any unit of stress: CalculiX replaces a 0 by a number of its own"""
_LAWS = ("HYPERELASTIC", "ANISOTROPIC HYPERELASTIC")
_WITHOUT_EFFECT = {
    "DENSITY": "state a density where an effect needs it, such as gravity",
    "EXPANSION": "state it in an effect thermal-expansion",
    "CONDUCTIVITY": "not used",
    "SPECIFIC HEAT": "not used",
    "DAMPING": "not used",
    "DEPVAR": "not used",
    "USER OUTPUT VARIABLES": "not used",
}
_OTHER_BEHAVIOUR = (
    *("ELASTIC", "HYPERFOAM", "HYPOELASTIC", "POROUS ELASTIC", "LOW DENSITY FOAM", "FABRIC", "USER MATERIAL"),
    *("VISCOELASTIC", "NONLINEAR VISCOELASTIC", "HYSTERESIS", "MULLINS EFFECT", "VISCOUS", "CREEP", "SWELLING"),
    *(
        "PLASTIC",
        "DEFORMATION PLASTICITY",
        "RATE DEPENDENT",
        "NO COMPRESSION",
        "NO TENSION",
        "DAMAGE INITIATION",
        "DAMAGE EVOLUTION",
    ),
)
_TEST_DATA = (
    *("UNIAXIAL TEST DATA", "BIAXIAL TEST DATA", "PLANAR TEST DATA", "VOLUMETRIC TEST DATA", "SIMPLE SHEAR TEST DATA"),
)
_REMEDIES = {"ELASTIC": "; 'law: st-venant-kirchhoff' with young and poisson agrees with it at small strain"}


def read(text: str, name: str | None = None) -> Card:
    """Return a material of an input file, or of a card without ``*MATERIAL``.

    Raises:
        CardError: it is damaged, or has no counterpart.
    """
    materials: dict[str, list[Keyword]] = {}
    current: str | None = ""
    for keyword in keywords_of_text(text):
        if keyword.name == "MATERIAL":
            current = keyword.options.get("NAME", "")
            materials[current] = []
        elif keyword.name not in (*_LAWS, *_WITHOUT_EFFECT, *_OTHER_BEHAVIOUR, *_TEST_DATA):
            current = None
        elif current is not None:
            materials.setdefault(current, []).append(keyword)
    selected = chosen(materials, name)
    behaviour = materials[selected]
    keyword = _law_in(behaviour, f" in material {selected}" if selected else "")
    title, law = _CONVERTERS[keyword.name](keyword)
    notes = tuple(
        f"*{k.name} is not part of the law: {_WITHOUT_EFFECT[k.name]}" for k in behaviour if k.name in _WITHOUT_EFFECT
    )
    return Card(selected, title, replace(law, notes=law.notes + notes))


def _law_in(behaviour: Sequence[Keyword], where: str) -> Keyword:
    """Return the only law among the keywords of a material."""
    laws = [keyword for keyword in behaviour if keyword.name in _LAWS or _is_elastic_law(keyword)]
    for keyword in behaviour:
        if keyword.name in _OTHER_BEHAVIOUR and keyword not in laws:
            raise UnknownLaw(f"*{keyword.name} has no counterpart{_REMEDIES.get(keyword.name, '')}")
    if len(laws) != 1:
        count = f"{len(laws)} *HYPERELASTIC" if laws else "neither *HYPERELASTIC nor *ELASTIC"
        raise CardError(f"has {count}{where}")
    return laws[0]


def _isotropic(keyword: Keyword) -> tuple[str, Counterpart]:
    names = [name for name in keyword.options if name in _POTENTIALS] or ["POLYNOMIAL"]
    title = f"*HYPERELASTIC, {names[0]}"
    for name in keyword.options:
        if name in ("TEST DATA INPUT", "MARLOW"):
            raise UnknownLaw(f"*HYPERELASTIC, {name}: the card has tests, not parameters; fit them with 'hpcinv fit'")
        if name not in ("N", "MODULI", *_POTENTIALS):
            raise UnknownLaw(f"*HYPERELASTIC, {name} has no counterpart")
    if len(names) > 1:
        raise CardError(f"*HYPERELASTIC names several laws: {', '.join(names)}")
    order = keyword.options.get("N", "1")
    if not order.isdecimal() or not 1 <= int(order) <= MOST_TERMS:
        raise CardError(f"{title}: N must be from 1 to {MOST_TERMS}, not {order!r}")
    count, convert = _POTENTIALS[names[0]]
    constants = _constants(keyword, title, count(int(order)))
    terms = {"YEOH": 3, "REDUCED POLYNOMIAL": int(order), "POLYNOMIAL": int(order), "OGDEN": int(order)}
    volumetric = constants[-terms.get(names[0], 1) :]
    law = convert([0.0 if c >= NO_TERM else c for c in constants], int(order))
    return title, replace(law, notes=(*law.notes, *_notes(volumetric)))


def _notes(compliances: Sequence[float]) -> Iterator[str]:
    """Yield what CalculiX makes of compliances that are 0, which Abaqus takes as incompressible or as no term."""
    first, *others = compliances
    if first == 0:
        yield "D is 0 or left out: incompressible, as in Abaqus; CalculiX takes D = 0.1/mu, which is kappa = 20 mu"
    elif 0 in others:
        yield f"D{others.index(0) + 2} is 0 or left out: no such term, as in Abaqus; CalculiX takes a number of its own"


def _constants(keyword: Keyword, title: str, count: int) -> list[float]:
    """Return so many numbers; entries that are left out are 0. A temperature may follow them."""
    if not keyword.lines:
        raise CardError(f"{title}: has no line of numbers")
    if len(keyword.lines) > count // _PER_LINE + 1:
        raise UnknownLaw(f"{title}: parameters that depend on temperature have no counterpart; keep one line of data")
    numbers: list[float] = []
    for line in keyword.lines:
        entries = [number(entry, title) if entry else 0.0 for entry in line]
        if len(entries) > _PER_LINE:
            raise CardError(f"{title}: a line has {len(entries)} numbers; the most are {_PER_LINE}")
        numbers += [*entries, *[0.0] * _PER_LINE][:_PER_LINE]
    return [*numbers, *[0.0] * count][:count]


def _neo_hooke(c: list[float], order: int) -> Counterpart:
    return polynomial({(1, 0): c[0]}, c[1:])


def _mooney_rivlin(c: list[float], order: int) -> Counterpart:
    return polynomial({(1, 0): c[0], (0, 1): c[1]}, c[2:])


def _reduced(c: list[float], order: int) -> Counterpart:
    return polynomial({(i + 1, 0): c[i] for i in range(order)}, c[order:])


def _polynomial(c: list[float], order: int) -> Counterpart:
    powers = triangle(order)
    return polynomial(dict(zip(powers, c, strict=False)), c[len(powers) :])


def _ogden(c: list[float], order: int) -> Counterpart:
    mu, alpha, (first, *others) = c[: 2 * order : 2], c[1 : 2 * order : 2], c[2 * order :]
    if any(others):
        raise UnknownLaw("*HYPERELASTIC, OGDEN: D2 and higher have no counterpart")
    if not all(alpha):
        raise CardError("*HYPERELASTIC, OGDEN: alpha must not be 0")
    factors = [Stress(2 * m / a) for m, a in zip(mu, alpha, strict=True)]
    return Counterpart({"law": "ogden", "mu": factors, "alpha": alpha, "kappa": bulk_from(first)})


def _arruda_boyce(c: list[float], order: int) -> Counterpart:
    material = {"law": "arruda-boyce", "mu": Stress(c[0]), "lambda_m": c[1], "kappa": bulk_from(c[2])}
    return Counterpart(material if c[2] == 0 else {**material, "volumetric": "simo-taylor"})


def _without_counterpart(name: str) -> Callable[[list[float], int], Counterpart]:
    def refuse(c: list[float], order: int) -> Counterpart:
        raise UnknownLaw(f"*HYPERELASTIC, {name} has no counterpart")

    return refuse


_POTENTIALS: Mapping[str, tuple[Callable[[int], int], Callable[[list[float], int], Counterpart]]] = {
    "NEO HOOKE": (lambda n: 2, _neo_hooke),
    "MOONEY-RIVLIN": (lambda n: 3, _mooney_rivlin),
    "YEOH": (lambda n: 6, lambda c, n: _reduced(c, 3)),
    "REDUCED POLYNOMIAL": (lambda n: 2 * n, _reduced),
    "POLYNOMIAL": (lambda n: len(triangle(n)) + n, _polynomial),
    "OGDEN": (lambda n: 3 * n, _ogden),
    "ARRUDA-BOYCE": (lambda n: 3, _arruda_boyce),
    **{
        name: (lambda n: 1, _without_counterpart(name))
        for name in ("VAN DER WAALS", "HENCKY", "VALANIS-LANDEL", "USER")
    },
}
"""Number of constants by N, and the counterpart from the constants and N."""


def _anisotropic(keyword: Keyword) -> tuple[str, Counterpart]:
    title = "*ANISOTROPIC HYPERELASTIC, HOLZAPFEL"
    others = [name for name in keyword.options if name not in ("HOLZAPFEL", "LOCAL DIRECTIONS", "MODULI")]
    if others or "HOLZAPFEL" not in keyword.options:
        raise UnknownLaw(f"*ANISOTROPIC HYPERELASTIC, {', '.join(others) or 'without HOLZAPFEL'} has no counterpart")
    families = keyword.options.get("LOCAL DIRECTIONS", "0")
    if not families.isdecimal() or not 1 <= int(families) <= MOST_TERMS:
        raise CardError(f"{title}: LOCAL DIRECTIONS must be from 1 to {MOST_TERMS}, not {families!r}")
    c10, compliance, k1, k2, dispersion = _constants(keyword, title, 5)
    directions = {f"fibre{i + 1}": None for i in range(int(families))}
    return title, dispersed_fibres(2 * c10, k1, k2, dispersion, bulk_from(compliance), directions)


def _is_elastic_law(keyword: Keyword) -> bool:
    return keyword.name == "ELASTIC" and not is_isotropic(keyword)


_CONVERTERS: Mapping[str, Callable[[Keyword], tuple[str, Counterpart]]] = {
    "HYPERELASTIC": _isotropic,
    "ANISOTROPIC HYPERELASTIC": _anisotropic,
    "ELASTIC": elastic_law,
}


def write(values: Values, name: str) -> str:
    """Return the card of a law.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    head, constants = values.writer(_CARDS, _REASONS.get(values.kind, "it has no such energy"))(values)
    rows = [constants[i : i + _PER_LINE] for i in range(0, len(constants), _PER_LINE)]
    return "\n".join([f"*MATERIAL, NAME={name}", head, *(", ".join(map(shown, row)) for row in rows), ""])


def _neo_hooke_card(values: Values) -> tuple[str, Sequence[float]]:
    if values.kind == "neo-hookean" and not values.is_incompressible:
        raise values.refusal("its energy has I1 and ln(J), *HYPERELASTIC has I1_bar; take isochoric-neo-hookean")
    return "*HYPERELASTIC, NEO HOOKE", (values["mu"] / 2, values.compliance())


def _ogden_card(values: Values) -> tuple[str, Sequence[float]]:
    pairs = [x for m, a in zip(values["mu"], values["alpha"], strict=True) for x in (m * a / 2, a)]
    order = len(pairs) // 2
    return f"*HYPERELASTIC, OGDEN, N={order}", (*pairs, *_compliances(values, order))


def _compliances(values: Values, count: int) -> Sequence[float]:
    """Return ``D1`` and higher ones, whose terms are not there."""
    first = values.compliance()
    return first, *[NO_TERM if first else 0.0] * (count - 1)


def _fibre_card(values: Values) -> tuple[str, Sequence[float]]:
    if not values.is_incompressible:
        raise values.refusal("its fibres have invariants of C, Abaqus's of C_bar; both agree if it is incompressible")
    count = len(values.law.families)
    constants = (values["mu"] / 2, 0.0, values["k1"], values["k2"], values["dispersion"])
    return f"*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS={count}", constants


_CARDS: Mapping[str, Callable[[Values], tuple[str, Sequence[float]]]] = {
    "neo-hookean": _neo_hooke_card,
    "isochoric-neo-hookean": _neo_hooke_card,
    "mooney-rivlin": lambda v: ("*HYPERELASTIC, MOONEY-RIVLIN", (v["c1"], v["c2"], v.compliance())),
    "yeoh": lambda v: ("*HYPERELASTIC, YEOH", (v["c1"], v["c2"], v["c3"], *_compliances(v, 3))),
    "ogden": _ogden_card,
    "arruda-boyce": lambda v: ("*HYPERELASTIC, ARRUDA-BOYCE", (v["mu"], v["lambda_m"], v.compliance("simo-taylor"))),
    "holzapfel-gasser-ogden": _fibre_card,
}
_REASONS = {
    "st-venant-kirchhoff": "*ELASTIC is a law of rates, which agrees with it at small strain only",
    "formula": "a card has no formula",
}
