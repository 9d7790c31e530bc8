"""Material cards: energies of other programs, typed from their manuals, against the laws that the cards become."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml
from mpmath import mp

from hpcinv.__main__ import main
from hpcinv.cards import abaqus, ansys, febio
from hpcinv.cards.card import CardError, Counterpart, UnknownLaw, Values
from hpcinv.job.definitions import resolve
from hpcinv.materials import MaterialLaw, laws
from hpcinv.quantity.expressions import LET, Expression

MPMATH = {name: getattr(mp, name) for name in ("exp", "ln", "sqrt")} | {"max": max, "min": min}
FIBRES = {"fibre1": (0.6, 0.8, 0.0), "fibre2": (0.6, -0.8, 0.0)}
AXES = {"a": (0.6, 0.8, 0.0), "b": (-0.8, 0.6, 0.0), "c": (0.0, 0.0, 1.0)}
SQRT_3 = 3**0.5


class State:
    """Invariants of a deformation in mpmath, by their definitions."""

    def __init__(self, F: Any) -> None:
        self.C = F.T * F
        self.J = mp.det(F)
        self.I1 = sum(self.C[i, i] for i in range(3))
        self.I2 = (self.I1**2 - sum((self.C * self.C)[i, i] for i in range(3))) / 2
        self.I1_bar, self.I2_bar = self.I1 * self.J ** (-mp.mpf(2) / 3), self.I2 * self.J ** (-mp.mpf(4) / 3)
        self.stretches = [mp.sqrt(x) for x in mp.eigsy(self.C, eigvals_only=True)]

    def powers(self, alpha: float) -> Any:
        """Return the sum of powers of the isochoric stretches, less 3."""
        return sum((x * self.J ** (-mp.mpf(1) / 3)) ** alpha for x in self.stretches) - 3

    def I4(self, direction: Any, power: int = 1) -> Any:
        a = mp.matrix([float(x) for x in direction])
        return (a.T * self.C**power * a)[0]

    def strains(self) -> list[Any]:
        """Return Green's strains 11, 22, 33 and twice those 12, 13, 23 along `AXES`."""
        axes = [mp.matrix(axis) for axis in AXES.values()]
        green = [[(a.T * (self.C - mp.eye(3)) * b)[0] / 2 for b in axes] for a in axes]
        return [green[i][i] for i in range(3)] + [2 * green[i][j] for i, j in ((0, 1), (0, 2), (1, 2))]


def uniaxial(x: Any) -> Any:
    return mp.diag([x, mp.mpf("0.9"), mp.mpf("0.85")])


def shear(x: Any) -> Any:
    F = mp.eye(3)
    F[0, 1] = x
    return F


def volumetric(x: Any) -> Any:
    return mp.eye(3) * mp.cbrt(x)


PATHS = {"uniaxial": (uniaxial, (0.8, 1.3)), "shear": (shear, (0.4, 1.0)), "volumetric": (volumetric, (0.8, 1.2))}

# Abaqus and CalculiX: manual of CalculiX, *HYPERELASTIC, eqs. 483-488; Abaqus, "Strain energy potential".
D, NEO, RIVLIN, YEOH = 0.05, 0.4, (0.3, 0.2), (0.3, -0.02, 0.004)
SERIES = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)


def eight_chains(mu: float, limit: float) -> Callable[[State], Any]:
    return lambda s: mu * sum(c / limit ** (2 * i) * (s.I1_bar ** (i + 1) - 3 ** (i + 1)) for i, c in enumerate(SERIES))


def dispersed(s: State, mu: float, k1: float, k2: float, kappa: float, directions: Any) -> Any:
    """Ground substance and fibres of Gasser, Ogden & Holzapfel, with isochoric invariants."""
    strains = [kappa * (s.I1_bar - 3) + (1 - 3 * kappa) * (s.I4(a) * s.J ** (-mp.mpf(2) / 3) - 1) for a in directions]
    return mu / 2 * (s.I1_bar - 3) + sum(k1 / (2 * k2) * (mp.exp(k2 * max(e, 0) ** 2) - 1) for e in strains)


def material(kind: str, **parameters: float | str) -> str:
    body = "".join(f"<{key}>{value}</{key}>" for key, value in parameters.items())
    return f'<material id="1" type="{kind}">{body}</material>'


# D1111, D1122, D2222, D1133, D2233, D3333, D1212, D1313, D2323; compliance of the engineering constants
STIFFNESS = (12.0, 3.0, 7.0, 2.0, 1.5, 6.0, 2.5, 1.8, 1.2)
COMPLIANCE = mp.matrix([[1 / 10, -0.3 / 10, -0.2 / 10], [-0.3 / 10, 1 / 5, -0.1 / 5], [-0.2 / 10, -0.1 / 5, 1 / 4]])


def quadratic(s: State, normal: Any, shear: Any) -> Any:
    """Energy of Green's strains."""
    strains = s.strains()
    return sum(normal[i, j] * strains[i] * strains[j] for i in range(3) for j in range(3)) / 2 + sum(
        modulus * strain**2 / 2 for modulus, strain in zip(shear, strains[3:], strict=True)
    )


def stiff(s: State) -> Any:
    d = STIFFNESS
    return quadratic(s, mp.matrix([[d[0], d[1], d[3]], [d[1], d[2], d[4]], [d[3], d[4], d[5]]]), d[6:])


def ligament(s: State, c3: float, c4: float, c5: float, limit: float) -> Any:
    """Energy of FEBio's fibres (``FEFiberExpLinearUC``), by the exponential integral."""
    stretch = mp.sqrt(s.I4(FIBRES["fibre1"])) * s.J ** (-mp.mpf(1) / 3)
    c3 = c3 or c5 / c4 * mp.exp(-c4 * (limit - 1))
    l = max(min(stretch, limit), 1)
    c6 = c3 * (mp.exp(c4 * (limit - 1)) - 1) - c5 * limit
    linear = c5 * (stretch - limit) + c6 * mp.ln(stretch / limit) if stretch > limit else 0
    return c3 * mp.exp(-c4) * (mp.ei(c4 * l) - mp.ei(c4)) - c3 * mp.ln(l) + linear


def toe(square: Any, young: Any, start: Any, beta: Any) -> Any:
    """Energy of FEBio's fibres with a toe region, by integrating their stress over the squared stretch."""
    ksi = young / 4 / (beta - 1) * start**-3 * (start**2 - 1) ** (2 - beta)
    b = ksi * (start**2 - 1) ** (beta - 1) + young / 2 / start
    low = lambda x: ksi * (x - 1) ** (beta - 1)  # noqa: E731
    high = lambda x: b - young / 2 / mp.sqrt(x)  # noqa: E731
    if square <= 1:
        return mp.mpf(0)
    end = min(square, start**2)
    return mp.quad(low, [1, end]) + (mp.quad(high, [start**2, square]) if square > end else 0)


ANGLE = mp.nstr(mp.degrees(mp.acos(mp.mpf("0.6"))), 17)
FIBRE = '<fiber type="vector"><vector>3,4,0</vector></fiber></material>'

CASES: dict[str, tuple[ModuleType, str, Callable[[State], Any]]] = {
    "abaqus neo hooke": (
        abaqus,
        f"*Hyperelastic, neo hooke\n{NEO}, {D}",
        lambda s: NEO * (s.I1_bar - 3) + (s.J - 1) ** 2 / D,
    ),
    "abaqus mooney-rivlin": (
        abaqus,
        f"*MATERIAL, NAME=a\n*DENSITY\n1e-9,\n*HYPERELASTIC, MOONEY-RIVLIN\n0.3, 2.D-1, {D}, 20.",
        lambda s: 0.3 * (s.I1_bar - 3) + 0.2 * (s.I2_bar - 3) + (s.J - 1) ** 2 / D,
    ),
    "abaqus yeoh": (
        abaqus,
        f"*HYPERELASTIC, YEOH\n0.3, -0.02, 0.004, {D}",
        lambda s: sum(c * (s.I1_bar - 3) ** i for i, c in enumerate(YEOH, 1)) + (s.J - 1) ** 2 / D,
    ),
    "abaqus polynomial": (
        abaqus,
        f"*HYPERELASTIC, POLYNOMIAL, N=2\n0.3, 0.2, 0.01, 0.02, 0.03, {D}, 0.5",
        lambda s: (
            0.3 * (s.I1_bar - 3)
            + 0.2 * (s.I2_bar - 3)
            + 0.01 * (s.I1_bar - 3) ** 2
            + 0.02 * (s.I1_bar - 3) * (s.I2_bar - 3)
            + 0.03 * (s.I2_bar - 3) ** 2
            + (s.J - 1) ** 2 / D
            + (s.J - 1) ** 4 / 0.5
        ),
    ),
    "abaqus ogden": (
        abaqus,
        f"*HYPERELASTIC, OGDEN, N=3\n0.4, 1.3, 0.02, 5, 0.1, -2, {D}, 0\n0",
        lambda s: (
            2 * 0.4 / 1.3**2 * s.powers(1.3)
            + 2 * 0.02 / 25 * s.powers(5)
            + 2 * 0.1 / 4 * s.powers(-2)
            + (s.J - 1) ** 2 / D
        ),
    ),
    "abaqus arruda-boyce": (
        abaqus,
        f"*HYPERELASTIC, ARRUDA-BOYCE\n0.5, 2.5, {D}",
        lambda s: eight_chains(0.5, 2.5)(s) + ((s.J**2 - 1) / 2 - mp.ln(s.J)) / D,
    ),
    "abaqus holzapfel": (
        abaqus,
        f"*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS=2\n0.3, {D}, 0.6, 0.8, 0.1",
        lambda s: dispersed(s, 0.6, 0.6, 0.8, 0.1, FIBRES.values()) + ((s.J**2 - 1) / 2 - mp.ln(s.J)) / D,
    ),
    "abaqus engineering constants": (
        abaqus,
        "*ELASTIC, TYPE=ENGINEERING CONSTANTS\n10, 5, 4, 0.3, 0.2, 0.1, 3, 2,\n1, 20",
        lambda s: quadratic(s, COMPLIANCE**-1, (3, 2, 1)),
    ),
    "abaqus orthotropic": (abaqus, "*ELASTIC, TYPE=ORTHO\n12, 3, 7, 2, 1.5, 6, 2.5, 1.8,\n1.2", stiff),
    "abaqus anisotropic": (
        abaqus,
        "*ELASTIC, TYPE=ANISO\n12, 3, 7, 2, 1.5, 6, 0, 0\n0, 2.5, 0, 0, 0, 0, 1.8, 0\n0, 0, 0, 0, 1.2",
        stiff,
    ),
    "ansys neo": (
        ansys,
        f"/UNITS,MPA\nTB,HYPER,1,,,NEO ! rubber\nTBDATA,1,0.5\nTBDATA,2,{D}",
        lambda s: 0.5 / 2 * (s.I1_bar - 3) + (s.J - 1) ** 2 / D,
    ),
    "ansys mooney": (
        ansys,
        f"C10=0.3\nTB,HYPER,1,1,3,MOONEY\nTBDATA,1,C10,0.2,0.05,{D}",
        lambda s: (
            0.3 * (s.I1_bar - 3) + 0.2 * (s.I2_bar - 3) + 0.05 * (s.I1_bar - 3) * (s.I2_bar - 3) + (s.J - 1) ** 2 / D
        ),
    ),
    "ansys ogden": (
        ansys,
        f"TB,HYPER,1,,2,OGDEN\nTBDATA,1,0.4,1.3,-0.1,-2,{D},0",
        lambda s: 0.4 / 1.3 * s.powers(1.3) + 0.1 / 2 * s.powers(-2) + (s.J - 1) ** 2 / D,
    ),
    "ansys boyce": (
        ansys,
        f"TB,HYPER,1,,,BOYCE\nTBDATA,1,0.5,2.5,{D}",
        lambda s: eight_chains(0.5, 2.5)(s) + ((s.J**2 - 1) / 2 - mp.ln(s.J)) / D,
    ),
    "ansys gent": (
        ansys,
        f"TB,HYPER,1,,,GENT\nTBDATA,1,0.5,30,{D}",
        lambda s: -0.5 * 30 / 2 * mp.ln(1 - (s.I1_bar - 3) / 30) + ((s.J**2 - 1) / 2 - mp.ln(s.J)) / D,
    ),
    "ansys blatz": (
        ansys,
        "TB,HYPER,1,,,BLATZ\nTBDATA,1,0.5",
        lambda s: 0.5 / 2 * (s.I2 / s.J**2 + 2 * s.J - 5),
    ),
    # FEBio: StrainEnergyDensity of each class in FEBioMech, and U(J) of FEUncoupledMaterial.h
    "febio neo-Hookean": (
        febio,
        material("neo-Hookean", E=1.2, v=0.3, density=1),
        lambda s: 1.2 / 2.6 * ((s.I1 - 3) / 2 - mp.ln(s.J)) + 0.3 * 1.2 / (1.3 * 0.4) * mp.ln(s.J) ** 2 / 2,
    ),
    "febio isotropic elastic": (
        febio,
        material("isotropic elastic", E=1.2, v=0.3),
        lambda s: (
            0.3 * 1.2 / (1.3 * 0.4) * ((s.I1 - 3) / 2) ** 2 / 2 + 1.2 / 2.6 * (s.I1**2 - 2 * s.I2 - 2 * s.I1 + 3) / 4
        ),
    ),
    "febio isotropic Hencky": (
        febio,
        material("isotropic Hencky", E=1.2, v=0.3),
        lambda s: 1.2 / 2.6 * mp.diff(s.powers, 0, 2) + (0.3 / 0.4 + 1 / 3) * 1.2 / 1.3 * mp.ln(s.J) ** 2 / 2,
    ),
    "febio Mooney-Rivlin": (
        febio,
        material("Mooney-Rivlin", c1=0.3, c2=0.2, k=40),
        lambda s: 0.3 * (s.I1_bar - 3) + 0.2 * (s.I2_bar - 3) + 40 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio Ogden": (
        febio,
        material("Ogden", c1=0.4, m1=1.3, c2=0.1, m2=-2, k=40, pressure_model="Abaqus"),
        lambda s: 0.4 / 1.3**2 * s.powers(1.3) + 0.1 / 4 * s.powers(-2) + 40 / 2 * (s.J - 1) ** 2,
    ),
    "febio Yeoh": (
        febio,
        material("Yeoh", c1=0.3, c2=-0.02, c3=0.004, k=40, pressure_model=1),
        lambda s: sum(c * (s.I1_bar - 3) ** i for i, c in enumerate(YEOH, 1)) + 40 / 4 * (s.J**2 - 2 * mp.ln(s.J) - 1),
    ),
    "febio Gent": (
        febio,
        material("Gent", G=0.5, Jm=30, k=40),
        lambda s: -0.5 * 30 / 2 * mp.ln(1 - (s.I1_bar - 3) / 30) + 40 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio Veronda-Westmann": (
        febio,
        material("Veronda-Westmann", c1=0.3, c2=1.5, k=40),
        lambda s: 0.3 * (mp.exp(1.5 * (s.I1_bar - 3)) - 1) - 0.3 * 1.5 / 2 * (s.I2_bar - 3) + 40 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio Arruda-Boyce": (
        febio,
        material("Arruda-Boyce", mu=0.5, N=6, k=40),
        lambda s: eight_chains(0.5, 6**0.5)(s) + 40 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio Holzapfel-Gasser-Ogden": (
        febio,
        material("Holzapfel-Gasser-Ogden", c=0.5, k1=0.6, k2=0.8, kappa=0.1, gamma=30, k=40),
        lambda s: (
            dispersed(s, 0.5, 0.6, 0.8, 0.1, [(SQRT_3 / 2, 0.5, 0), (SQRT_3 / 2, -0.5, 0)])
            + 40 / 2 * ((s.J**2 - 1) / 2 - mp.ln(s.J))
        ),
    ),
    "febio trans iso Mooney-Rivlin": (
        febio,
        material("trans iso Mooney-Rivlin", c1=0.3, c2=0.2, c3=0.5, c4=2, c5=3, lam_max=1.05, k=40).replace(
            "</material>", FIBRE
        ),
        lambda s: 0.3 * (s.I1_bar - 3) + 0.2 * (s.I2_bar - 3) + ligament(s, 0.5, 2, 3, 1.05) + 40 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio trans iso Veronda-Westmann": (
        febio,
        material("trans iso Veronda-Westmann", c1=0.3, c2=1.5, c4=2, c5=3, lam_max=1.5, k=40).replace(
            "</material>", FIBRE
        ),
        lambda s: (
            0.3 * (mp.exp(1.5 * (s.I1_bar - 3)) - 1)
            - 0.3 * 1.5 / 2 * (s.I2_bar - 3)
            + ligament(s, 0, 2, 3, 1.5)
            + 40 / 2 * mp.ln(s.J) ** 2
        ),
    ),
    "febio solid mixture": (  # FEFiberExpPow, FEFiberPowLinear
        febio,
        f"""<material id="1" type="solid mixture"><solid type="neo-Hookean"><E>2.6</E><v>0.3</v></solid>
        <solid type="isotropic elastic"><E>1.3</E><v>0.3</v></solid>
        <solid type="fiber-exp-pow"><ksi>0.4</ksi><alpha>2</alpha><beta>3</beta><mu>0</mu>
        <fiber type="angles"><theta>{ANGLE}</theta><phi>90</phi></fiber></solid>
        <solid type="fiber-pow-linear"><E>5</E><lam0>1.02</lam0><beta>2.5</beta>
        <mat_axis type="vector"><a>0,1,0</a><d>0,0,1</d></mat_axis>
        <fiber type="vector">1,0,0</fiber></solid></material>""",
        lambda s: (
            1.0 / 2 * (s.I1 - 3)
            - 1.0 * mp.ln(s.J)
            + mp.mpf("1.5") / 2 * mp.ln(s.J) ** 2
            + quadratic(s, mp.matrix([[1.75, 0.75, 0.75], [0.75, 1.75, 0.75], [0.75, 0.75, 1.75]]), [0.5] * 3)
            + mp.mpf("0.4") / 6 * (mp.exp(2 * max(s.I4(FIBRES["fibre1"]) - 1, 0) ** 3) - 1)
            + toe(s.I4((0.0, 1.0, 0.0)), 5, mp.mpf("1.02"), mp.mpf("2.5"))
        ),
    ),
    "febio uncoupled solid mixture": (
        febio,
        f"""<material id="1" type="uncoupled solid mixture"><k>40</k><pressure_model>2</pressure_model>
        <solid type="Mooney-Rivlin"><c1>0.3</c1><c2>0.2</c2><k>7</k></solid>
        <solid type="Yeoh"><c1>0.3</c1><c2>-0.02</c2><c3>0.004</c3></solid>
        <solid type="Veronda-Westmann"><c1>0.3</c1><c2>1.5</c2><k>0</k></solid>
        <solid type="trans iso Mooney-Rivlin"><c1>0.1</c1><c2>0</c2><c3>0.5</c3><c4>2</c4><c5>3</c5>
        <lam_max>1.05</lam_max><fiber type="angles"><theta>{ANGLE}</theta><phi>90</phi></fiber></solid>
        <solid type="fiber-exp-pow-uncoupled"><ksi>0.4</ksi><alpha>2</alpha><beta>3</beta>
        <fiber type="vector">0,1,0</fiber></solid></material>""",
        lambda s: (
            0.3 * (s.I1_bar - 3)
            + 0.2 * (s.I2_bar - 3)
            + sum(c * (s.I1_bar - 3) ** i for i, c in enumerate(YEOH, 1))
            + 0.3 * (mp.exp(1.5 * (s.I1_bar - 3)) - 1)
            - 0.3 * 1.5 / 2 * (s.I2_bar - 3)
            + 0.1 * (s.I1_bar - 3)
            + ligament(s, 0.5, 2, 3, 1.05)
            + mp.mpf("0.4") / 6 * (mp.exp(2 * max(s.I4((0.0, 1.0, 0.0)) * s.J ** (-mp.mpf(2) / 3) - 1, 0) ** 3) - 1)
            + 40 / 2 * (s.J - 1) ** 2
        ),
    ),
    "febio coupled Mooney-Rivlin": (
        febio,
        material("coupled Mooney-Rivlin", c1=0.3, c2=0.2, k=4),
        lambda s: 0.3 * (s.I1 - 3) + 0.2 * (s.I2 - 3) - 2 * (0.3 + 2 * 0.2) * mp.ln(s.J) + 4 / 2 * mp.ln(s.J) ** 2,
    ),
}


def law_of(converted: Counterpart, unit: str = "MPa") -> MaterialLaw:
    section = converted.section(unit)
    context = {LET: resolve({name: Expression(text) for name, text in converted.definitions.items()})}
    return laws()[section["law"]].model_validate(section, context=context)


def energy(law: MaterialLaw, s: State, directions: Any, definitions: Mapping[str, str]) -> Any:
    """The energy of a law (MPa), by its formula."""
    values: dict[str, Any] = {name: getattr(s, name) for name in ("J", "I1", "I2", "I1_bar", "I2_bar")}
    scale = s.J ** (-mp.mpf(1) / 3)
    values |= {f"lambda{i}_bar": x * scale for i, x in enumerate(s.stretches, 1)}
    values |= {f"I{3 + k}_{family}": s.I4(a, k) for family, a in directions.items() for k in (1, 2)}
    for name, (value, _) in law.quantities().items():
        entries = {f"{name}{i}": v for i, v in enumerate(value, 1)} if isinstance(value, tuple) else {name: value}
        values |= {n: mp.mpf(v) for n, v in entries.items() if v is not None}
    for name, text in definitions.items():
        values[name] = Expression(text).apply(values, MPMATH)
    return Expression(law.energy_formula).apply(values, MPMATH) / 10**6


@pytest.mark.parametrize("name", CASES)
def test_the_law_of_a_card_has_the_energy_of_its_program(name: str) -> None:
    program, text, theirs = CASES[name]
    card = program.read(text)
    law = law_of(card.law)
    known = FIBRES | AXES
    directions = {family: known[family] if axis is None else axis for family, axis in card.law.fibres.items()}
    with mp.workdps(40):
        for kind, (path, places) in PATHS.items():
            for place in places:
                ours = mp.diff(
                    lambda x, path=path: energy(law, State(path(x)), directions, card.law.definitions), place
                )
                expected = mp.diff(lambda x, path=path: theirs(State(path(x))), place)
                assert float(ours) == pytest.approx(float(expected), rel=1e-12), f"{kind} {place}"


def test_cards_of_an_incompressible_material_have_no_bulk_modulus() -> None:
    for text, key in (
        ("NEO HOOKE\n0.3, 0", "kappa"),
        ("MOONEY-RIVLIN\n0.3, 0.2", "d1"),
        ("ARRUDA-BOYCE\n1, 2", "kappa"),
    ):
        assert abaqus.read(f"*HYPERELASTIC, {text}").law.material[key] == "incompressible"
    text = "*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS=1\n0.3, 0, 0.6, 0.8, 0.1"
    assert law_of(abaqus.read(text).law).law == "holzapfel-gasser-ogden"  # type: ignore[attr-defined]


def changed(law: type[MaterialLaw], volumetric: str | None) -> MaterialLaw:
    values = {**law.example, "volumetric": volumetric} if volumetric else dict(law.example)
    return law.model_validate(values)


WRITTEN = [
    *((abaqus, name, None) for name in ("isochoric-neo-hookean", "mooney-rivlin", "yeoh", "ogden")),
    (abaqus, "arruda-boyce", "simo-taylor"),
    *((ansys, name, None) for name in ("isochoric-neo-hookean", "mooney-rivlin", "yeoh", "ogden")),
    *((ansys, name, "simo-taylor") for name in ("arruda-boyce", "gent")),
    *((febio, name, None) for name in ("neo-hookean", "st-venant-kirchhoff", "isochoric-neo-hookean", "ogden", "yeoh")),
    *((febio, name, "logarithmic") for name in ("mooney-rivlin", "gent", "veronda-westmann", "arruda-boyce")),
]


@pytest.mark.parametrize(("program", "name", "volumetric"), WRITTEN)
def test_a_written_card_gives_the_law_back(program: ModuleType, name: str, volumetric: str | None) -> None:
    law = changed(laws()[name], volumetric)
    text = program.write(Values(law, program.PROGRAM, 1e3), "tissue & wall")
    back = law_of(program.read(text).law, "kPa")
    assert type(back) is type(law)
    assert getattr(back, "volumetric", None) == getattr(law, "volumetric", None)
    for key, (value, _) in law.quantities().items():
        assert np.ravel(back.quantities()[key][0]) == pytest.approx(np.ravel(value), rel=1e-13), key


@pytest.mark.parametrize(
    ("program", "text", "message"),
    [
        (abaqus, "*HYPERELASTIC, VAN DER WAALS\n1,2,3", "VAN DER WAALS has no counterpart"),
        (abaqus, "*HYPERFOAM\n1,2,3", r"\*HYPERFOAM has no counterpart"),
        (abaqus, "*ELASTIC\n210000, 0.3", "st-venant-kirchhoff"),
        (abaqus, "*ELASTIC, TYPE=LAMINA\n1,1,0,1,1,1", "TYPE=LAMINA has no counterpart"),
        (abaqus, "*ELASTIC, TYPE=ORTHO\n1,2,3", "has 3 constants, not 9"),
        (abaqus, "*ELASTIC, TYPE=ORTHO\n1,2,1,2,2,1,1,1\n1", "is unstable"),
        (abaqus, f"*ELASTIC, TYPE=ANISO{4 * chr(10)}{', '.join(21 * ['1'])}", "coupled shears"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,0\n*VISCOELASTIC\n0.1,0.1,1", r"\*VISCOELASTIC has no counterpart"),
        (abaqus, "*HYPERELASTIC, YEOH, TEST DATA INPUT", "hpcinv fit"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,0,20\n2,0,40", "temperature"),
        (abaqus, "*HYPERELASTIC, NEO HOOKE\n1,x", "'x' is not a number"),
        (abaqus, "*HYPERELASTIC, OGDEN, N=9\n1,2", "N must be from 1 to 6"),
        (abaqus, "*HYPERELASTIC, YEOH\n0.3,0,0,0,1", "D1 is 0"),
        (abaqus, "*HYPERELASTIC, OGDEN, N=2\n1,2,3,4,0.1,0.2", "D2 and higher"),
        (abaqus, "*MATERIAL, NAME=a\n*HYPERELASTIC, NEO HOOKE\n1,0\n*MATERIAL, NAME=b", "several materials: a, b"),
        (abaqus, "*NODE\n1, 0, 0, 0", "has no material"),
        (abaqus, "*ANISOTROPIC HYPERELASTIC, FUNG-ORTHOTROPIC\n1", "FUNG-ORTHOTROPIC has no counterpart"),
        (ansys, "TB,HYPER,1,,2,FOAM\nTBDATA,1,1,2", "FOAM has no counterpart"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1,1\nTB,PRONY,1\nTBDATA,1,1", "TB,PRONY has no counterpart"),
        (ansys, "TB,HYPER,1,,4,MOONEY\nTBDATA,1,1", "2, 3, 5 or 9 parameters, not 4"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1,2*X", "is not a number"),
        (ansys, "TB,HYPER,1,,,NEO\nTBDATA,1e9,1", "from 1 to 100"),
        (febio, material("Shenoy", mu=1), "law Shenoy"),
        (
            febio,
            '<material id="1" type="solid mixture"><solid type="elastic damage"><E>1</E></solid></material>',
            "solid mixture with elastic damage has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="solid mixture"><solid type="Gent"><G>1</G><Jm>9</Jm><k>9</k></solid></material>',
            "solid mixture of Gent has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="uncoupled solid mixture"><k>9</k><solid type="neo-Hookean"/></material>',
            "uncoupled solid mixture with neo-Hookean has no counterpart",
        ),
        (
            febio,
            '<material id="1" type="uncoupled solid mixture"><solid type="Gent"><G>1</G><Jm>9</Jm></solid></material>',
            "uncoupled solid mixture without k has no counterpart",
        ),
        (febio, material("Mooney-Rivlin", c1=1, c2=0), "k is not a number"),
        (febio, material("Gent", G=1, Jm=0, k="nan"), "k is not a number"),
        (febio, '<material id="1" type="Gent"><G lc="2">1</G></material>', "load curve 2"),
        (febio, "<material", "is not XML"),
        (febio, '<!DOCTYPE a [<!ENTITY b "c">]><material/>', "entities"),
    ],
)
def test_card_options_without_a_counterpart_are_refused_by_name(program: ModuleType, text: str, message: str) -> None:
    with pytest.raises(CardError, match=message):
        program.read(text)


@pytest.mark.parametrize(
    ("program", "data", "message"),
    [
        (abaqus, {"law": "neo-hookean", "young": 1, "poisson": 0.3}, "take isochoric-neo-hookean"),
        (abaqus, {"law": "gent", "mu": 1, "jm": 30, "kappa": 9}, "'gent' has no counterpart in Abaqus"),
        (abaqus, {"law": "yeoh", "c1": 1, "c2": 0, "c3": 0, "kappa": 9, "volumetric": "liu"}, "'quadratic', not 'liu'"),
        (abaqus, laws()["holzapfel-gasser-ogden"].example, "invariants of C"),
        (ansys, laws()["guccione"].example, "'guccione' has no counterpart in Ansys"),
        (febio, {"law": "gent", "mu": 1, "jm": 30, "kappa": "incompressible"}, "no exactly incompressible law"),
        (febio, {"law": "gent", "mu": 1, "jm": 30, "kappa": 9, "volumetric": "liu"}, "no volumetric energy 'liu'"),
        (
            febio,
            {"law": "formula", "energy": "m/2*(I1_bar - 3)", "parameters": {"m": "1 Pa"}, "kappa": 9},
            "no formula",
        ),
        (ansys, {"law": "gent", "mu": "1 kPa*(1 + X/(1 m))", "jm": 30, "kappa": 9}, "vary over the body"),
    ],
)
def test_laws_without_a_card_are_refused_by_name(program: ModuleType, data: dict[str, Any], message: str) -> None:
    law = laws()[data["law"]].model_validate(data)
    with pytest.raises(UnknownLaw, match=message):
        program.write(Values(law, program.PROGRAM, 1.0), "tissue")


def test_the_command_prints_sections_of_a_job_and_writes_cards(tmp_path: Path, capsys: Any) -> None:
    card = "*HYPERELASTIC, MOONEY-RIVLIN\\n0.1, 0.15, 0.001"
    assert main(["laws", "--from", "abaqus", card]) == 2
    assert "--stress-unit MPa" in capsys.readouterr().err
    assert main(["laws", "--from", "abaqus", card, "--stress-unit", "mm"]) == 2
    assert "not a stress" in capsys.readouterr().err
    job = tmp_path / "wall.yaml"
    assert main(["laws", "--from", "abaqus", card, "--stress-unit", "MPa", "--output", str(job)]) == 0
    section = yaml.safe_load(job.read_text())["material"]
    assert section == {"law": "mooney-rivlin", "c1": "0.1 MPa", "c2": "0.15 MPa", "d1": "1000 MPa"}
    assert main(["laws", "--to", "ansys", str(job)]) == 2
    assert "--stress-unit" in capsys.readouterr().err
    assert main(["laws", "--to", "ansys", str(job), "--stress-unit", "kPa"]) == 0
    assert capsys.readouterr().out == "! wall\nTB,HYPER,1,,2,MOONEY\nTBDATA,1,100,150,1e-06\n"
    assert main(["laws", "--from", "abaqus", str(tmp_path / "none.inp"), "--stress-unit", "MPa"]) == 2
    assert "none.inp: cannot be read" in capsys.readouterr().err
    assert main(["laws", "--from", "abaqus", "*HYPERELASTIC, NEO HOOKE\n-1, 0", "--stress-unit", "MPa"]) == 2
    assert "*HYPERELASTIC, NEO HOOKE: mu: must be above 0" in capsys.readouterr().err


def test_files_that_state_their_units_need_no_option(tmp_path: Path, capsys: Any) -> None:
    model = tmp_path / "model.feb"
    first, second = material("neo-Hookean", E=2, v=0.3), material("neo-Hookean", E=3, v=0.3)
    materials = first.replace('id="1"', 'id="1" name="fat"') + second.replace('id="1"', 'id="2" name="gland"')
    model.write_text(
        '<?xml version="1.0"?><febio_spec version="4.0"><Module type="solid"><units>mm-N-s</units></Module>'
        f"<Material>{materials}</Material></febio_spec>"
    )
    assert main(["laws", "--from", "febio", str(model)]) == 2
    assert "several materials: fat, gland; choose one with --name" in capsys.readouterr().err
    assert main(["laws", "--from", "febio", str(model), "--name", "gland"]) == 0
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed == {"material": {"law": "neo-hookean", "young": "3 N/mm^2", "poisson": 0.3}}
    assert main(["laws", "--from", "febio", str(model), "--name", "fat", "--stress-unit", "kPa"]) == 2
    assert "states N/mm^2 as its unit of stress" in capsys.readouterr().err
    assert main(["laws", "--from", "ansys", "/UNITS,SI\\nTB,HYPER,1,,,NEO\\nTBDATA,1,5e5,1e-9"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["material"]["mu"] == "500000 Pa"
