"""Material cards: energies of other programs, typed from their manuals, against the laws that the cards become."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from helpers.card_cases import AXES, State, energy, law_of, material, volumetric
from mpmath import mp

from hpcinv.formats.cards import abaqus, ansys, febio
from hpcinv.formats.cards.card import UnknownLaw

FIBRES = {"fibre1": (0.6, 0.8, 0.0), "fibre2": (0.6, -0.8, 0.0)}
SQRT_3 = 3**0.5


def uniaxial(x: Any) -> Any:
    return mp.diag([x, mp.mpf("0.9"), mp.mpf("0.85")])


def shear(x: Any) -> Any:
    F = mp.eye(3)
    F[0, 1] = x
    return F


PATHS = {"uniaxial": (uniaxial, (0.8, 1.3)), "shear": (shear, (0.4, 1.0)), "volumetric": (volumetric, (0.8, 1.2))}

# Abaqus and CalculiX: manual of CalculiX, *HYPERELASTIC, eqs. 483-488; Abaqus, "Strain energy potential".
D, NEO, RIVLIN, YEOH = 0.05, 0.4, (0.3, 0.2), (0.3, -0.02, 0.004)
SERIES = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)


def eight_chains(mu: float, limit: float) -> Callable[[State], Any]:
    return lambda s: mu * sum(c / limit ** (2 * i) * (s.I1_bar ** (i + 1) - 3 ** (i + 1)) for i, c in enumerate(SERIES))


def second_order(s: State) -> Any:
    """A polynomial of the second order."""
    first, second, growth = s.I1_bar - 3, s.I2_bar - 3, s.J - 1
    quadratic = 0.01 * first**2 + 0.02 * first * second + 0.03 * second**2
    return 0.3 * first + 0.2 * second + quadratic + growth**2 / D + growth**4 / 0.5


def dispersed(s: State, mu: float, k1: float, k2: float, kappa: float, directions: Any) -> Any:
    """Ground substance and fibres of Gasser, Ogden & Holzapfel, with isochoric invariants."""
    strains = [kappa * (s.I1_bar - 3) + (1 - 3 * kappa) * (s.I4(a) * s.J ** (-mp.mpf(2) / 3) - 1) for a in directions]
    return mu / 2 * (s.I1_bar - 3) + sum(k1 / (2 * k2) * (mp.exp(k2 * max(e, 0) ** 2) - 1) for e in strains)


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


def ligament(s: State, c3: float, c4: float, c5: float, limit: float, *, isochoric: bool = True) -> Any:
    """Energy of FEBio's fibres (``FEFiberExpLinearUC``), by the exponential integral."""
    stretch = mp.sqrt(s.I4(FIBRES["fibre1"])) * (s.J ** (-mp.mpf(1) / 3) if isochoric else 1)
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
        second_order,
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
    "ansys poly": (
        ansys,
        f"TB,HYPER,1,,2,POLY\nTBDATA,1,0.3,0.2,0.01,0.02,0.03,{D}\nTBDATA,7,0.5",
        second_order,
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
    "febio orthotropic elastic": (  # v31 / E3 = v13 / E1
        febio,
        """<material id="1" type="orthotropic elastic"><E1>10</E1><E2>5</E2><E3>4</E3><v12>0.3</v12><v23>0.1</v23>
        <v31>0.08</v31><G12>3</G12><G23>1</G23><G31>2</G31>
        <mat_axis type="vector"><a>0.6,0.8,0</a><d>-0.8,0.6,0</d></mat_axis></material>""",
        lambda s: quadratic(s, COMPLIANCE**-1, (3, 2, 1)),
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
    "febio Holmes-Mow": (
        febio,
        material("Holmes-Mow", E=1.2, v=0.25, beta=0.8),  # lam = mu = 0.48
        lambda s: (
            1.44
            / 3.2
            * (mp.exp(0.8 * (0.48 * (s.I1 - 3) + 0.48 * (s.I2 - 3) - mp.mpf("1.44") * mp.ln(s.J**2)) / 1.44) - 1)
        ),
    ),
    "febio Fung-ortho-compressible": (
        febio,
        """<material id="1" type="Fung-ortho-compressible"><E1>10</E1><E2>5</E2><E3>4</E3><v12>0.3</v12><v23>0.1</v23>
        <v31>0.08</v31><G12>3</G12><G23>1</G23><G31>2</G31><c>8</c><k>6</k>
        <mat_axis type="vector"><a>0.6,0.8,0</a><d>-0.8,0.6,0</d></mat_axis></material>""",
        lambda s: 8 / 2 * (mp.exp(2 * quadratic(s, COMPLIANCE**-1, (3, 2, 1)) / 8) - 1) + 6 / 2 * mp.ln(s.J) ** 2,
    ),
    "febio coupled trans-iso Mooney-Rivlin": (
        febio,
        material("coupled trans-iso Mooney-Rivlin", c1=0.3, c2=0.2, c3=0.5, c4=2, c5=3, lam_max=1.05, k=40).replace(
            "</material>", FIBRE
        ),
        lambda s: (
            0.3 * (s.I1 - 3)
            + 0.2 * (s.I2 - 3)
            - 2 * (0.3 + 2 * 0.2) * mp.ln(s.J)
            + ligament(s, 0.5, 2, 3, 1.05, isochoric=False)
            + 40 / 2 * mp.ln(s.J) ** 2
        ),
    ),
    "febio HGO unconstrained": (
        febio,
        material("HGO unconstrained", c=0.5, k1=0.6, k2=0.8, kappa=0.1, gamma=ANGLE, k=40),
        lambda s: (
            0.5 / 2 * (s.I1 - 3)
            - 0.5 * mp.ln(s.J)
            + 40 / 2 * ((s.J**2 - 1) / 2 - mp.ln(s.J))
            + sum(
                0.6 / 1.6 * (mp.exp(0.8 * max(0.1 * (s.I1 - 3) + 0.7 * (s.I4(a) - 1), 0) ** 2) - 1)
                for a in FIBRES.values()
            )
        ),
    ),
    "febio coupled Mooney-Rivlin": (
        febio,
        material("coupled Mooney-Rivlin", c1=0.3, c2=0.2, k=4),
        lambda s: 0.3 * (s.I1 - 3) + 0.2 * (s.I2 - 3) - 2 * (0.3 + 2 * 0.2) * mp.ln(s.J) + 4 / 2 * mp.ln(s.J) ** 2,
    ),
}


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


def test_each_law_of_febio_has_its_energy_in_a_test() -> None:
    shown = {name for name in febio.LAWS if any(f'type="{name}"' in text for _, text, _ in CASES.values())}
    elsewhere = {"incomp neo-Hookean", "Arruda-Boyce unconstrained"}  # below
    assert {*febio.LAWS} - shown - elsewhere == {name for name in febio.LAWS if "hyperelastic" in name}


def test_cards_of_an_incompressible_material_have_no_bulk_modulus() -> None:
    for text, key in (
        ("NEO HOOKE\n0.3, 0", "kappa"),
        ("MOONEY-RIVLIN\n0.3, 0.2", "d1"),
        ("ARRUDA-BOYCE\n1, 2", "kappa"),
    ):
        assert abaqus.read(f"*HYPERELASTIC, {text}").law.material[key] == "incompressible"
    text = "*ANISOTROPIC HYPERELASTIC, HOLZAPFEL, LOCAL DIRECTIONS=1\n0.3, 0, 0.6, 0.8, 0.1"
    assert law_of(abaqus.read(text).law).law == "holzapfel-gasser-ogden"  # type: ignore[attr-defined]


def test_chains_without_a_constraint_carry_no_stress_at_rest() -> None:
    """A term of ln J cancels the one that powers of I1 have."""
    card = febio.read(material("Arruda-Boyce unconstrained", ksi=0.4, N=8, n_term=5, kappa=20))
    law = law_of(card.law)
    with mp.workdps(40):
        for path in (lambda x: mp.diag([1 + x, 1, 1]), volumetric_around_rest):
            stress = mp.diff(lambda x, path=path: energy(law, State(path(x)), {}, card.law.definitions), 0)
            assert abs(stress) < 1e-14


def volumetric_around_rest(x: Any) -> Any:
    return (1 + x) * mp.eye(3)


def test_fibres_that_carry_compression_are_refused() -> None:
    text = CASES["febio solid mixture"][1].replace("<lam0>", "<tension_only>{}</tension_only><lam0>")
    assert febio.read(text.format(1)).law.material == febio.read(CASES["febio solid mixture"][1]).law.material
    with pytest.raises(UnknownLaw, match="fiber-pow-linear with compression has no counterpart"):
        febio.read(text.format(0))
