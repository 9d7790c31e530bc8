"""Rest length of a bar that creeps, by one elastic solve with the law of its age.

The body is quasi-linear viscoelastic: the isochoric stress of an incompressible neo-Hookean law relaxes in two
branches, ``Q' + Q/τ = g S'``. Its homogeneous creep is an ordinary differential equation (Simo, Holzapfel). A law is
fitted to the isochronous curve, stretch against load at the age of the body, and a cube of known shape is then
released by one inverse solve.

Usage: python benchmarks/creep.py [DIRECTORY]
"""

import hpcinv.base.parallel.runtime

# isort: split
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import hpcinv
from hpcinv.base.quantity.arrays import Floats
from hpcinv.job.job import parse

ROOT = Path(__file__).parents[1]
MU, TIMES, AGE = 80e3, np.array([1.0, 10.0]), 12.0
"""instantaneous shear modulus in Pa, relaxation times and age in h"""
LOADS = np.linspace(2e3, 60e3, 15)
"""nominal stresses (Pa) of the creep tests"""
POWERS = {"uniaxial": (1.0, -0.5, -0.5), "equibiaxial": (1.0, 1.0, -2.0)}
"""principal stretches by the measured one"""
CASES = (
    ("uniaxial", "uniaxial", 10e3, AGE, np.inf),
    ("uniaxial", "uniaxial", 40e3, AGE, np.inf),
    ("equibiaxial", "equibiaxial", 10e3, AGE, np.inf),
    ("loaded since 6 h", "uniaxial", 40e3, AGE / 2, np.inf),
    ("unloaded 6 h ago", "uniaxial", 40e3, AGE, AGE / 2),
)
"""label, mode, nominal stress (Pa), time since the load (h), and when it was removed (h)"""


def crept(share: float, load: float, age: float, mode: str = "uniaxial", removed: float = np.inf) -> float:
    """Return the stretch at an age (h) under a constant nominal stress (Pa), which may be removed earlier."""
    shares, powers = np.full((2, 1), share / 2), np.array(POWERS[mode])

    def stress(stretch: float) -> Floats:
        c = stretch ** (2 * powers)
        return np.asarray(MU * (1 - c.sum() / 3 / c))

    def stretch_of(t: float, memory: Floats) -> float:
        force = load if t < removed else 0.0

        def excess(stretch: float) -> float:
            c, s = stretch ** (2 * powers), stress(stretch) + memory.reshape(2, 3).sum(axis=0)
            return float(c[0] * s[0] - c[2] * s[2] - force * stretch)

        return float(brentq(excess, 0.2, 20.0, xtol=1e-14))

    def rate(t: float, memory: Floats) -> Floats:
        relaxed = memory.reshape(2, 3) + shares * stress(stretch_of(t, memory))
        return np.asarray(-(relaxed / TIMES[:, None]).ravel())

    memory, begin = np.zeros(6), 0.0
    for end in sorted({min(removed, age), age}):
        memory = solve_ivp(rate, (begin, end), memory, rtol=1e-9, atol=1e-6 * MU, max_step=age / 20).y[:, -1]
        begin = end
    return stretch_of(age, memory)


def rest_length(material: dict[str, Any], true_stress: float, mode: str) -> float:
    """Return the undeformed length of a unit cube that carries a true stress (Pa), by one inverse solve."""
    loaded = ["x1"] if mode == "uniaxial" else ["x1", "y1"]
    pull = {"x1": [true_stress, 0, 0], "y1": [0, true_stress, 0]}
    job = {
        "analysis": "inverse",
        "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"nx": 1, "ny": 1, "nz": 1}},
        "material": material,
        "effects": [
            {"effect": "traction", "region": region, "traction": pull[region], "area_in": "current"}
            for region in loaded
        ],
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        "quantities": [{"name": "corner", "of": "X", "at": [1, 1, 1]}],
        "certificate": "off",
    }
    return float(hpcinv.run(parse(job, ROOT), progress=False).quantities["corner"])


def fitted(share: float, directory: Path) -> dict[str, Any]:
    """Fit a law to the isochronous curve by the command of the page; return the section ``material``."""
    curve, material = directory / "isochronous.csv", directory / "material.yaml"
    rows = [f"{crept(share, load, AGE)}, {load}" for load in LOADS]
    curve.write_text("\n".join(["# mode: uniaxial", "stretch, nominal stress [Pa]", *rows]) + "\n")
    words = ["fit", str(curve), "--law", "ogden:1", "--material", str(material)]
    subprocess.run([sys.executable, "-m", "hpcinv", *words], check=True, capture_output=True)
    section: dict[str, Any] = yaml.safe_load(material.read_text())["material"]
    return section


def main() -> None:
    with tempfile.TemporaryDirectory() as kept:
        directory = Path(sys.argv[1] if len(sys.argv) > 1 else kept)
        print("error of the rest length by the change of length, %; age 12 h, relaxation times 1 and 10 h")
        print(f"{'relaxing':>8} {'body':>24} {'load':>9} {'stretch':>8} {'instant':>9} {'long-term':>9} {'age':>9}")
        for share in (0.2, 0.5, 0.9):
            law = fitted(share, directory)
            moduli = {"law": "isochoric-neo-hookean", "kappa": "incompressible"}
            laws = [moduli | {"mu": MU}, moduli | {"mu": MU * (1 - share)}, law]
            for label, mode, load, age, removed in CASES:
                stretch = crept(share, load, age, mode, removed)
                left = 0.0 if removed < age else load * stretch
                lengths = [rest_length(material, left, mode) for material in laws] if left else [1.0] * 3
                errors = [100 * abs(length - 1 / stretch) / (1 - 1 / stretch) for length in lengths]
                shown = " ".join(f"{error:9.2f}" for error in errors)
                print(f"{share:8} {label:>24} {load / 1e3:5.0f} kPa {stretch:8.4f} {shown}", flush=True)


if __name__ == "__main__":
    main()
