"""The table of the page on verification, from what the tests print.

``python3 -m uv run python docs/verification_table.py`` runs the tests that the table names, one file after the other
(a quarter of an hour), and keeps what they print in ``docs/verification/printed``, with machine and date; names of
tests as arguments do the same for these only. ``docs/generate.py`` writes the page from that.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from measurements import heading

ROOT = Path(__file__).parents[1]
PRINTED = Path(__file__).parent / "verification" / "printed"
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Figure:
    """A figure of the table: the largest number, by size, in each group of a pattern over all that a test prints."""

    shown: str
    pattern: str
    choice: Callable[[Iterable[float]], float] = max

    def of(self, printed: str) -> str:
        """Return the figure; raises ``ValueError`` if nothing that was printed matches."""
        matches = [match.groups() for match in re.finditer(self.pattern, printed, re.MULTILINE)]
        if not matches:
            raise ValueError(f"no line that was printed matches {self.pattern!r}")
        groups = [
            [abs(float(n)) for one in group for n in _NUMBER.findall(one)] for group in zip(*matches, strict=True)
        ]
        return re.sub(r"e-0(?=\d)", "e-", self.shown.format(*map(self.choice, groups)))


@dataclass(frozen=True)
class VerificationRow:
    """A row: what is compared, the test, and the figures that it prints; without any, bounds are in the test."""

    text: str
    test: str
    figures: Sequence[Figure] = ()


_ORDERS = r"orders of the larger \[.*?, ([\d.]+)\]"
CASES = (
    VerificationRow(
        "every law: stress against mpmath evaluating the formula that `hpcinv laws` shows, moderate deformations;"
        " strains from 1e-1 to 1e-12: largest relative error",
        "unit/test_laws.py",
        [Figure("{:.1e}", r"moderate deformations: (\S+)"), Figure("{:.1e}", r"small strain: (\S+)")],
    ),
    VerificationRow(
        "every law on a mesh at strains of 1e-10: displacement against linear elasticity (laws without fibres)",
        "verification/test_law_solves.py",
        [Figure("{:.1e}", r"against linear elasticity (\S+)")],
    ),
    VerificationRow(
        "every law: homogeneous patch X = F⁻¹x, also nearly incompressible; round trips, tetrahedra and hexahedra, on 1"
        " and 2 ranks",
        "verification/test_law_solves.py",
        [
            Figure("{:.1e}", r"^\.*[\w-]+: (\d\.\de-\d+)$"),
            Figure("{:.1e}", r"^\.*[\w-]+: (\d\.\de-\d+), pressure"),
            Figure("round trips {:.1e}", r"first: gap (\d\.\de-\d+)"),
        ],
    ),
    VerificationRow(
        "every effect: Taylor test of the tangent",
        "verification/test_effects.py",
        [Figure("smallest rate {:.3f}", r"rates \[(.*?)\]", min), Figure("largest {:.3f}", r"rates \[(.*?)\]")],
    ),
    VerificationRow(
        "thick incompressible sphere under pressure, inverse, Q2–Q1, finest mesh: undeformed radii, closed form"
        " 0.9254360, 1.4686181: relative errors",
        "verification/test_thick_sphere.py",
        [Figure("{:.1e}, {:.1e}, order {:.1f}", r"hexahedra: errors .*\[(\S+), (\S+)\]\], " + _ORDERS)],
    ),
    VerificationRow(
        "sphere of two incompressible layers, and of one material that grows differently, inverse and forward, 2 and 4"
        " divisions: smallest error of the larger radius (m), least order; effectivity of the estimate",
        "verification/test_layers.py",
        [
            Figure("{:.1e}, order {:.1f}", r"errors and effectivities .*\[(\S+), \S+\]\], order (\S+)", min),
            Figure("{:.2f}", r"effectivity (\S+)", min),
            Figure("to {:.2f}", r"effectivity (\S+)"),
        ],
    ),
    VerificationRow(
        "thick cylinder, plane strain, 16 divisions, undeformed radii 0.8286610, 1.3916461; inverse; forward",
        "verification/test_thick_cylinder.py",
        [
            Figure("{:.1e}, {:.1e}, order {:.1f}", rf"{way}, hexahedra: errors .*\[(\S+), (\S+)\]\], " + _ORDERS)
            for way in ("inverse", "forward")
        ],
    ),
    VerificationRow(
        "tube with two families of fibres, angle given on the reference and on the current body, against quadrature:"
        " inner radius",
        "verification/test_fibres.py",
        [Figure("{:.1e}, order {:.1f}", r"on the \w+ body: \S+, (\S+), order (\S+)")],
    ),
    VerificationRow(
        "rotating bar at large strain, forward; inverse; 32 cells",
        "verification/test_rotating_bar.py",
        [
            Figure("{:.1e}, order {:.1f}", rf"{way}, density per .*errors \[\S+ \S+ (\S+)\], orders \[(.*?)\]")
            for way in ("forward", "inverse")
        ],
    ),
    VerificationRow(
        "fluid around a curved body: force and torque against Archimedes",
        "verification/test_hydrostatic.py",
        [Figure("{:.1e}", r"errors of force and torque \[(.*?)\]")],
    ),
    VerificationRow(
        "layers with different laws, one incompressible: displacement, stress; bar graded by a formula of X and of x",
        "verification/test_material_regions.py",
        [
            Figure("{:.1e} m, {:.1e}", r"displacement to (\S+) m, stress to (\S+) of the traction"),
            Figure("{:.1e} m, order {:.1f}", r"moduli of .*errors \S+, (\S+) m, order (\S+)"),
        ],
    ),
    VerificationRow(
        "thermal expansion, growth, active stress: homogeneous states",
        "verification/test_strains.py",
    ),
    VerificationRow("tractions and springs: homogeneous states", "verification/test_surface_loads.py"),
    VerificationRow(
        "artery with an opening angle of 160°, incompressible, without and with pressure, both directions, 1 to 3"
        " ranks, Q2–Q1, 3 divisions: radii, relative; hoop stress at the surfaces in units of mu; against quadrature",
        "verification/test_prestrain.py",
        [
            Figure("{:.1e}, {:.1e}", r"radii and stress \[\[(\S+, \S+), (\S+, \S+)\]"),
        ],
    ),
    VerificationRow(
        "simple shear, k from 1e-6 to 1, both laws and directions, displacement and mixed form, P1 to P3, tetrahedra"
        " and hexahedra, straight and curved, 1 to 3 ranks: largest relative errors of stress, energy, displacement",
        "verification/test_simple_shear.py",
        [Figure("{:.1e}, {:.1e}, {:.1e}", r"stress (\d\S+), energy (\S+), displacement (\S+e-\d\d)")],
    ),
    VerificationRow(
        "generalised shear: order of convergence of the pointwise stress, P2–P1, on hexahedra; on regular tetrahedra,"
        " stress and its deviator",
        "verification/test_generalised_shear.py",
        [
            Figure("{:.2f}", r"hexahedra: .*orders \[\S+ (\S+)\]"),
            Figure("{:.2f}, {:.1f}", r"tetrahedra: .*orders \[\S+ (\S+)\], \[\S+ (\S+)\]"),
        ],
    ),
    VerificationRow(
        "single tetrahedron there and back, both laws and density conventions: largest ‖u' + u‖",
        "verification/test_single_tetrahedron.py",
        [Figure("{:.1e} m", r"error (\S+) m")],
    ),
    VerificationRow(
        "states: prone, at rest, and prone again, directly and by way of others, with moduli and densities given on the"
        " given body, curved cells, 1 to 3 ranks: distance from the given mesh of 1 m",
        "verification/test_states.py",
        [Figure("{:.1e} m", r"moved by \S+ m, gaps \[(\S+), \S+\] m")],
    ),
    VerificationRow(
        "confined column: undeformed length, closed form 1.0802799 m (current density), 1.0846655 m (reference"
        " density)",
        "verification/test_column.py",
        [Figure("{:.8f}", rf"^\.*density per {where} volume: (\S+) m") for where in ("current", "reference")],
    ),
    VerificationRow(
        "states: column that hangs and stands on the moon, sphere under two pressures, hot and cold, other supports:"
        " closed forms",
        "verification/test_states.py",
    ),
    VerificationRow(
        "fixed-point methods against the direct one, tolerance 1e-10: tetrahedron; curved"
        " incompressible block on 2 ranks",
        "verification/test_methods.py",
        [Figure("{:.1e} m", r"(\d\S+) m from direct$"), Figure("{:.1e} m", r"(\d\S+) m from direct, pressure")],
    ),
    VerificationRow(
        "integrals and means of stress, energy and volume over cells and facets: homogeneous states of"
        " one and two laws",
        "verification/test_stress_quantities.py",
    ),
    VerificationRow(
        "incompressible bent block there and back, both laws, tetrahedra and hexahedra: closure error, relative",
        "verification/test_incompressible.py",
        [Figure("{:.1e}", r"closes to (\d\.\de-\d+)")],
    ),
    VerificationRow(
        "clamped column at 0.97, 1.05, 8.7 and 9.5 times Euler's load, displacement and mixed form: unstable directions"
        " (exact: 0, 2, 2, 4)",
        "verification/test_certificate.py",
        [Figure("{:.0f}", rf"{share} of Euler's load: (\d) negative") for share in ("0.97", "1.05", "8.7", "9.5")],
    ),
    VerificationRow(
        "silicone beam forward and back, 3 mm cells, on 1, 2 and 3 ranks: closure error",
        "verification/test_pdms_beam.py",
        [Figure("{:.1e} m", r"round trip closes to (\S+) m")],
    ),
    VerificationRow(
        "silicone beam: tip displacement with cells of 4, 3, 2.2 mm; large-deflection beam theory",
        "verification/test_pdms_beam.py",
        [Figure("{:.3f} mm", rf"tip displacement \[{'[^,]*, ' * i}'(\S+) mm'") for i in range(3)]
        + [Figure("{:.2f} mm", r"beam theory (\S+) mm")],
    ),
    VerificationRow(
        "cylinder on a block (NAFEMS CGS-1: Hertz' 3585 MPa over a half width of 6.21 mm), other cylinders on blocks:"
        " pressure and width within the rim of one cell",
        "verification/test_hertz.py",
    ),
    VerificationRow(
        "cantilever beam that lies down on a rigid plane (Signorini): force on the plane within 2 %, and flat where"
        " beam theory says",
        "verification/test_signorini_beam.py",
    ),
    VerificationRow(
        "CalculiX, equal meshes: rubber there and back to 7 digits; two blocks in contact, surface to surface: force to"
        " the overlap that its penalty leaves",
        "verification/test_beside_calculix.py",
    ),
)


def page() -> Iterator[str]:
    """Yield the lines of the page, from what was printed."""
    yield "# Verification"
    yield ""
    yield "Closed forms and independent evaluations next to results of hpcinv, on 1 to 3 ranks. The figures are the"
    yield "largest ones of those that each test prints; tests hold them below bounds, which are a few times larger."
    yield ""
    yield "| case | found | test |"
    yield "|---|---|---|"
    for case in CASES:
        name = Path(case.test).stem.replace("_", "-")
        found = "; ".join(figure.of(_printed(case.test)) for figure in case.figures) or "within the bounds of the test"
        shown = f"[`{Path(case.test).name}`](#{name})" if case.figures else f"`{Path(case.test).name}`"
        yield f"| {case.text} | {found} | {shown} |"
    yield ""
    counts = json.loads((ROOT / "hpcinv" / "studies" / "dossier" / "published.json").read_text())
    yield f"{counts['inside']} of {counts['values']} [values that others published](published.md)"
    yield f"in {counts['sources']} sources lie inside both error bars."
    yield ""
    yield "![Difference over the error bar of each published value](../pictures/published.png)"
    yield ""
    yield "Figures of the paper that are not met have [a page of their own](paper.md)."
    yield "[A grid](robustness.md) shows which methods find the unloaded shape."
    yield ""
    yield "## What the tests print"
    yield ""
    yield "Kept by `python3 -m uv run python docs/verification_table.py`; lines that several ranks or cases print alike"
    yield "stand here once."
    for test in dict.fromkeys(case.test for case in CASES if case.figures):
        yield ""
        yield f"### {Path(test).stem.replace('_', '-')}"
        yield ""
        yield "```text"
        yield _printed(test).rstrip()
        yield "```"


def _printed(test: str) -> str:
    return (PRINTED / f"{Path(test).stem}.txt").read_text()


def record(test: str) -> None:
    """Run a test, and keep the lines that figures of the table are made of; raises ``SystemExit`` if it fails."""
    words = ["-m", "pytest", "-n", "0", "-m", "", "-s", f"tests/{test}"]  # also what is left for a release
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{test} fails:\n{done.stdout[-3000:]}")
    keep(test, done.stdout)


def keep(test: str, output: str) -> None:
    """Write the lines of the output of a test that figures are made of, each of them once."""
    figures = [figure for case in CASES if case.test == test for figure in case.figures]
    lines = [re.sub(r"^(tests/\S+\.py )?\.*", "", line) for line in output.splitlines()]  # without pytest's marks
    kept = [line for line in dict.fromkeys(lines) if any(re.search(figure.pattern, line) for figure in figures)]
    # Ranks print at the same time: some lines are glued to others, and some are the rest of such ones.
    kept = [line for line in kept if not line.startswith(" ")]
    kept = [line for line in kept if not any(other != line and other in line for other in kept)]
    passed = re.findall(r"\d+ passed", output)[-1]
    PRINTED.mkdir(exist_ok=True)
    head = heading(f"pytest -n 0 -m '' -s tests/{test}", passed)
    (PRINTED / f"{Path(test).stem}.txt").write_text(head + "\n".join(kept) + "\n")


def main() -> None:
    names = sys.argv[1:] or [Path(case.test).name for case in CASES if case.figures]
    for test in dict.fromkeys(case.test for case in CASES if case.figures and Path(case.test).name in names):
        record(test)
        print(test, flush=True)


if __name__ == "__main__":
    main()
