"""Materials of FEBio with fibres or expressions: their energies, by the definitions in its source, are the laws'."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import pytest
from helpers.card_cases import State, energy, law_of
from mpmath import mp

from hpcinv.__main__ import main
from hpcinv.formats.cards import febio
from hpcinv.formats.cards.card import UnknownLaw, Values
from hpcinv.physics.materials import laws

FIRST, SECOND = (0.6, 0.8, 0.0), (0.0, 0.6, -0.8)
DEFORMED = mp.matrix([[1.2, 0.1, 0.0], [0.2, 1.1, -0.1], [0.0, 0.3, 0.9]])
HGO = {"law": "holzapfel-gasser-ogden", "mu": 3e3, "k1": 2e3, "k2": 0.8, "kappa": 2e4}
OGDEN = {key: value for key, value in laws()["holzapfel-ogden"].example.items() if key != "a_fs"} | {"a_fs": 0}
FUNG = {"law": "formula", "parameters": {"m": "2 kPa", "b": 0.7}, "kappa": "30 kPa"}
FORMULA = {"law": "formula", "parameters": {"m": "2 kPa", "k": "9 kPa"}}
CASES: list[tuple[dict[str, Any], tuple[str, ...]]] = [
    (HGO | {"dispersion": 0.0}, ("fibres1", "fibres2")),
    (HGO | {"dispersion": 0.1, "volumetric": "logarithmic"}, ("fibres1", "fibres2")),
    (OGDEN | {"volumetric": "simo-taylor"}, ("fibre", "sheet")),
    (dict(laws()["transversely-isotropic"].example), ("fibre",)),
    (laws()["guccione"].example | {"volumetric": "liu"}, ("fibre",)),
    (laws()["guccione"].example | {"strain": "isochoric"}, ("fibre",)),
    (dict(laws()["fung-demiray"].example), ()),
    (FUNG | {"energy": "m/(2*b)*(exp(b*(I1_bar - 3)) - 1) + m*(I2_bar - 3)**2/7"}, ()),
    (FORMULA | {"energy": "m/2*(I1 - 3) - m*ln(J) + k/2*(J - 1)**2"}, ()),
    (FORMULA | {"energy": "m/2*(I1_bar - 3) + k*(sqrt(I4_f) - 1)**2", "kappa": "30 kPa"}, ("f",)),
]


def of_febio(part: ET.Element, s: State) -> Any:
    """The energy of a material or a solid of FEBio (kPa)."""

    def number(name: str) -> Any:
        return mp.mpf(part.findtext(name, "nan"))

    def invariant(power: int, tag: str = "fiber") -> Any:
        return s.I4([float(x) for x in part.findtext(tag, "").split(",")], power)

    scale, kind = s.J ** (-mp.mpf(2) / 3), part.get("type", "")
    match kind:
        case "solid mixture":
            return sum(of_febio(solid, s) for solid in part.findall("solid"))
        case "incomp neo-Hookean":
            own = number("G") / 2 * (s.I1_bar - 3)
        case "fiber-exp-pow":
            strain = max(invariant(1) - 1, 0)
            alpha, beta = number("alpha"), number("beta")
            own = number("ksi") / (alpha * beta) * (mp.exp(alpha * strain**beta) - 1)
        case "HGO unconstrained":
            assert all(part.findtext(name) == "0" for name in ("c", "k", "gamma"))
            d = number("kappa")
            strain = max(d * (s.I1 - 3) + (1 - 3 * d) * (invariant(1, "mat_axis/a") - 1), 0)
            own = 2 * number("k1") / (2 * number("k2")) * (mp.exp(number("k2") * strain**2) - 1)
        case _:
            assert kind.endswith("hyperelastic")
            names: dict[str, Any] = {"J": s.J, "exp": mp.exp, "ln": mp.ln, "sqrt": mp.sqrt}
            is_uncoupled = kind.startswith("uncoupled")
            names |= {"I1": s.I1_bar, "I2": s.I2_bar} if is_uncoupled else {"I1": s.I1, "I2": s.I2}
            if "trans-iso" in kind:
                factors = (scale, scale**2) if is_uncoupled else (1, 1)
                names |= {"I4": invariant(1) * factors[0], "I5": invariant(2) * factors[1]}
            assert len(part.findtext("W", "")) < 512
            own = eval(part.findtext("W", "").replace("^", "**"), {}, names)
    if part.find("k") is None or kind == "HGO unconstrained":
        return own
    J = s.J
    volumes = (mp.ln(J) ** 2 / 2, (J**2 - 1 - 2 * mp.ln(J)) / 4, (J - 1) ** 2 / 2)
    return own + number("k") * volumes[int(part.findtext("pressure_model", ""))]


@pytest.mark.parametrize(("data", "names"), CASES)
def test_a_card_has_the_energy_of_the_law(data: dict[str, Any], names: tuple[str, ...]) -> None:
    law, state = laws()[data["law"]].model_validate(data), State(DEFORMED)
    families = dict(zip(law.families, (FIRST, SECOND), strict=False))
    vectors = {name: ("vector", ",".join(map(str, vector))) for name, vector in families.items()}
    text = febio.write(Values(law, febio.PROGRAM, 1e3), "wall", vectors)
    absent = {"I8_fibre_sheet": "0"}  # a_fs is 0
    wanted = energy(law, state, dict(zip(names, (FIRST, SECOND), strict=False)), absent) * 1000
    assert abs(wanted) > 0.1
    assert of_febio(ET.fromstring(text), state) == pytest.approx(wanted, rel=1e-12)
    converted = febio.read(text).law
    back = law_of(converted, "kPa")
    assert energy(back, state, converted.fibres, converted.definitions) * 1000 == pytest.approx(wanted, rel=1e-9)
    assert back.is_split == law.is_split or data["law"] in ("guccione", "formula")


def test_directions_that_a_card_does_not_know_are_maps_by_the_names_of_the_families(tmp_path: Any, capsys: Any) -> None:
    law = laws()["holzapfel-gasser-ogden"].model_validate(HGO | {"dispersion": 0})
    text = febio.write(Values(law, febio.PROGRAM, 1e3), "wall")
    assert text.count('<fiber type="map">fibre') == 2
    assert set(febio.read(text).law.fibres.values()) == {"fibre1", "fibre2"}
    path = tmp_path / "wall.yaml"
    path.write_text("material: {law: transversely-isotropic, mu: 5 kPa, k: 20 kPa, kappa: 30 kPa}\n")
    assert main(["laws", "--to", "febio", str(path), "--stress-unit", "kPa"]) == 0
    assert "<W>20/2*(I4-1)^2</W>" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (OGDEN | {"a_fs": 100}, "a_fs must be 0"),
        (HGO | {"dispersion": 0.1}, "directions of dispersed fibres vary"),
        (dict(laws()["usyk-mcculloch"].example), "has no such energy"),
        (FORMULA | {"energy": "m/2*(I1 - 3) - m*ln(J) + k*max(J - 1, 0)**2 + k*(J - 1)**2"}, "'max', which FEBio"),
        (
            FORMULA | {"energy": "m/2*(I1 - 3) - m*ln(J) + k*(J - 1)**2" + " + 0*k*(J - 1)**2" * 40},
            "and FEBio reads 500",
        ),
        (FORMULA | {"energy": "m*(I1 - 3) - 2*m*ln(J) + k*(I4_f - 1)**2 + k*(I4_s - 1)**2"}, "one family of fibres"),
    ],
)
def test_what_febio_lacks_is_refused_by_name(data: dict[str, Any], message: str) -> None:
    law = laws()[data["law"]].model_validate(data)
    with pytest.raises(UnknownLaw, match=message):
        febio.write(Values(law, febio.PROGRAM, 1e3), "wall")
