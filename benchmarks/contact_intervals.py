"""Rest shapes that a given shape with contact leaves open: errors of closures, and intervals around the known truth.

Usage: python benchmarks/contact_intervals.py [--cells N] [--drawn N]

Two blocks of a silicone-like material are pressed together by a known forward solve; the inverse knows only the loaded
shape. Blocks are quarters, 60 mm high, with supported ends.
"""

import hpcinv.base.parallel.runtime

# isort: split
import argparse
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import hpcinv
from hpcinv.mesh.source import Floats
from hpcinv.output.result import Result

MESH = Path(__file__).parents[1] / "meshes" / "two_blocks.py"
HEIGHT, SIDE, TRAVEL = 0.06, 0.05, 0.004  # m
TOUCHING = 1e-9  # gap (m) up to which nodes of the loaded shape touch each other
FLAT = 1e-8  # gap (m) by which nodes of two touching surfaces differ
SCENES: Mapping[str, Mapping[str, float]] = {
    "held": {"gap": 0.5e-3, "crown": 4e-3},
    "flat": {"gap": FLAT},
    "crown": {"gap": FLAT, "crown": 5e-3, "margin": 0.01},
}
"""Rest gap on the axis, and at the far corner in addition (m); the meshes of *crown* do not match."""
CLOSURES = ("touching", "conforming")


def scene(name: str, cells: int) -> dict[str, Any]:
    """Return the forward job of a scene."""
    wide = cells + 2 if name == "crown" else cells
    shape = {"lx": SIDE, "ly": SIDE, "lower_height": HEIGHT, "upper_height": HEIGHT, "hexahedra": True}
    divisions = {"lower": wide, "upper": cells, "layers": cells}
    travel: list[Any] = [0, 0, f"{-TRAVEL} m"]
    return {
        "analysis": "forward",
        "mesh": {"file": str(MESH), "parameters": {**shape, **divisions, **SCENES[name]}},
        "material": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
        "discretisation": {"displacement": 1},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
            {"region": "z0", "fix": ["x", "y", "z"]},
            {"region": "z1", "displacement": travel},
        ],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}],
        "solver": {"tolerance": 1e-12},
        "certificate": "off",
    }


@dataclass(frozen=True)
class Loaded:
    """A known body and its loaded shape.

    Attributes:
        job: inverse, of the loaded shape, without a closure.
        rest, current: nodes (n, 3) m of both.
        truth: values of the quantities on the known body, and the force between the bodies.
    """

    job: dict[str, Any]
    rest: Floats
    current: Floats
    truth: Mapping[str, float]


def loaded(name: str, cells: int, directory: Path) -> Loaded:
    """Return a scene after its forward solve."""
    job = scene(name, cells)
    result = hpcinv.run(job, directory=directory, progress=False)
    (solution,) = result.solutions
    order = np.argsort(result.body.mesh.geometry.input_global_indices)
    rest, current = solution.mesh_nodes[order], solution.other_nodes[order]
    top = 2 * HEIGHT + SCENES[name].get("gap", 0.0)
    upper = np.flatnonzero(rest[:, 2] > HEIGHT + FLAT / 2)
    low = upper[np.argmin(np.linalg.norm(rest[upper] - [0, 0, HEIGHT], axis=1))]
    corner = upper[np.argmin(np.linalg.norm(rest[upper] - [SIDE, SIDE, HEIGHT], axis=1))]
    count = (cells + 1) ** 2

    def at_node(formula: str, node: int) -> dict[str, Any]:
        """Return a quantity at one node of the upper surface: the lower one may have another node there."""
        x, y, _ = current[node].tolist()
        return {
            "of": f"{count}*({formula})*exp(-((x - {x} m)**2 + (y - {y} m)**2)/(1 mm)**2)",
            "on": "bottom",
            "reduce": "mean",
        }

    back = {
        **job,
        "analysis": "inverse",
        "mesh": {"file": str(directory / "shape.msh")},
        "regions": {"all": "z > -1 m"},
        "quantities": [
            {"name": "height", **at_node(f"{top} m - Z", low)},
            {"name": "half_width", **at_node("X", corner)},
            {"name": "distance", "of": "norm(ux, uy, uz)", "on": "all", "reduce": "rms"},
        ],
    }
    moved = np.linalg.norm(current - rest, axis=1)
    truth = {
        "height": top - rest[low, 2],
        "half_width": float(rest[corner, 0]),
        "distance": float(np.sqrt((moved**2).mean())),
        "force": abs(solution.contacts[0].force[2]),
    }
    return Loaded(back, rest, current, truth)


def closed(body: Loaded, closure: str, **more: Any) -> Result:
    """Return the inverse result with a closure."""
    interfaces = [
        {**body.job["interfaces"][0], "closure": closure, "touches_within": TOUCHING, **more.pop("contact", {})}
    ]
    return hpcinv.run({**body.job, "interfaces": interfaces, **more}, progress=False)


def error(body: Loaded, result: Result) -> float:
    """Return the largest distance (m) of a node of the rest shape from the known body."""
    solution, order = result.solutions[0], np.argsort(result.body.mesh.geometry.input_global_indices)
    assert np.abs(solution.mesh_nodes[order] - body.current).max() < 1e-12
    return float(np.linalg.norm(solution.other_nodes[order] - body.rest, axis=1).max())


def closures(name: str, body: Loaded) -> Iterator[str]:
    """Yield a row for each closure."""
    moved = np.linalg.norm(body.current - body.rest, axis=1).max()
    yield f"{name:<8}{'(displacement)':<16}{1e3 * moved:10.3f}"
    for closure in CLOSURES:
        result = closed(body, closure, analysis="round_trip", first="inverse")
        contact, back = result.solutions[0].contacts[0], result.errors["round_trip"]["max"]
        force = float(np.linalg.norm(contact.force))
        yield f"{'':<8}{closure:<16}{1e3 * error(body, result):10.3f}{force:10.3f}{1e3 * back:12.1e}"


def intervals(name: str, body: Loaded) -> Iterator[str]:
    """Yield a row for each quantity, and one on the effort."""
    start = time.perf_counter()
    result = closed(body, "touching", uncertainty="contact", certificate={"level": "quick"})
    seconds = time.perf_counter() - start
    for line in result.certificate.lines:
        if line.interval is None:
            continue
        found = line.interval
        key = "force" if found["of"].startswith("force") else found["of"]
        if key not in body.truth:
            continue
        factor = 1.0 if found["unit"] == "N" else 1e3
        low, high, truth = (factor * value for value in (found["low"], found["high"], body.truth[key]))
        slack = 1e-5 * max(abs(truth), high - low)
        place = "inside" if low - slack <= truth <= high + slack else "OUTSIDE"
        settled = "" if line.verdict.value == "pass" else ", has not settled"
        yield f"{name:<8}{key:<12}{truth:10.4f}{low:11.4f}{high:11.4f}{found['solves']:8}  {place}{settled}"
        name = ""
    count = result.body.mesh.geometry.x.size
    yield f"{'':<8}{count} unknowns, {found['pressures']} pressures: {seconds:.0f} s"


def drawn(seed: int) -> dict[str, Any]:
    """Return the forward job of two blocks whose shape, mesh, moduli and loads are drawn."""
    random = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(round(random.uniform(low, high), 5))

    lower, upper = (between(0.03, 0.06) for _ in range(2))
    shape = {"lx": between(0.03, 0.06), "ly": between(0.03, 0.06), "lower_height": lower, "upper_height": upper}
    crown = {"crown": between(0, 5e-3), "gap": between(1e-5, 1e-3), "margin": between(0, 0.01)}
    divisions = {"lower": int(random.integers(1, 4)), "upper": int(random.integers(1, 4)), "layers": 1}
    soft = {name: f"{between(5, 40)} kPa" for name in ("lower", "upper")}
    poisson = between(0.1, 0.4)
    travel: list[Any] = [between(-1e-3, 1e-3), between(-1e-3, 1e-3), -crown["gap"] - between(1e-3, 4e-3)]
    return {
        "analysis": "forward",
        "mesh": {"file": str(MESH), "parameters": {**shape, **crown, **divisions, "hexahedra": seed % 2 == 0}},
        "material": {name: {"law": "neo-hookean", "young": young, "poisson": poisson} for name, young in soft.items()},
        "discretisation": {"displacement": 1},
        "regions": {"all": "z > -1 m"},
        "effects": [
            {
                "effect": "gravity",
                "acceleration": [between(-5, 5), between(-5, 5), between(-10, 0)],
                "density": between(500, 1500),
            }
        ],
        "supports": [
            {"region": "z0", "fix": ["x", "y", "z"]},
            {"region": "z1", "displacement": [f"{part} m" for part in travel]},
        ],
        "interfaces": [{"between": ["bottom", "top"], "kind": "contact"}],
        "quantities": [
            {"name": "face", "of": "Z", "on": "bottom", "reduce": "mean"},
            {"name": "width", "of": "X", "on": "bottom", "reduce": "rms"},
            {"name": "lowest", "of": "Z", "on": "bottom", "reduce": "min"},
            {"name": "distance", "of": "norm(ux, uy, uz)", "on": "all", "reduce": "rms"},
            {"name": "stress", "of": "von_mises", "on": "lower", "reduce": "mean", "over": "current"},
            {"name": "energy", "of": "energy", "on": "upper", "reduce": "integral", "over": "reference"},
        ],
        "solver": {"tolerance": 1e-12},
        "certificate": "off",
    }


def drawn_bodies(count: int, directory: Path) -> Iterator[str]:
    """Yield a row for each body that was drawn: where the truth lies in its intervals, and how many ends settled."""
    yield f"{'body':<6}{'unknowns':>9}{'pressures':>11}{'force, N':>10}  {'widths, %':<34}truth"
    inside = settled = total = 0
    for seed in range(count):
        job, place = drawn(seed), directory / str(seed)
        there = hpcinv.run(job, directory=place, progress=False)
        contact = there.solutions[0].contacts[0]
        truth = {**there.quantities, "force on bottom": abs(contact.force[2])}
        back = {**job, "analysis": "inverse", "mesh": {"file": str(place / "shape.msh")}}
        back |= {"uncertainty": "contact", "certificate": {"level": "quick"}}
        back["interfaces"] = [{**job["interfaces"][0], "closure": "touching", "touches_within": TOUCHING}]
        lines = hpcinv.run(back, progress=False).certificate.lines
        known = ((line.interval or {"of": ""}, line) for line in lines)
        found = [(data, line) for data, line in known if data["of"] in truth]
        outside = [data["of"] for data, _ in found if not _is_inside(data, truth)]
        open_ends = [data["of"] for data, line in found if line.verdict.value != "pass"]
        widths = [100 * line.value / max(abs(truth[data["of"]]), line.value) for data, line in found if line.value]
        inside += not outside and bool(found)
        settled, total = settled + len(found) - len(open_ends), total + len(found)
        verdict = "inside" if found and not outside else f"OUTSIDE of {', '.join(outside)}"
        verdict += f"; not settled: {', '.join(open_ends)}" if open_ends else ""
        numbers = " ".join(f"{width:.2g}" for width in widths)
        size, pressures = there.body.mesh.geometry.x.size, found[0][0]["pressures"] if found else 0
        yield f"{seed:<6}{size:>9}{pressures:>11}{truth['force on bottom']:>10.4f}  {numbers:<34}{verdict}"
    yield f"truth inside in {inside} of {count}; {settled} of {total} intervals have settled"


def _is_inside(found: Mapping[str, Any], truth: Mapping[str, float]) -> bool:
    low, high = (sign * np.inf if end is None else end for sign, end in ((-1, found["low"]), (1, found["high"])))
    value = truth[found["of"]]
    slack = 1e-5 * max(abs(value), high - low if np.isfinite(high - low) else 0.0)
    return bool(low - slack <= value <= high + slack)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=3, help="along each edge of a block; 0 for none of these")
    parser.add_argument("--drawn", type=int, default=0, help="number of other bodies that are drawn")
    given = parser.parse_args()
    cells = given.cells
    with tempfile.TemporaryDirectory() as directory:
        if cells:
            _print_scenes(cells, Path(directory))
        for row in drawn_bodies(given.drawn, Path(directory)) if given.drawn else ():
            print(row, flush=True)


def _print_scenes(cells: int, directory: Path) -> None:
    bodies = {name: loaded(name, cells, directory / name) for name in SCENES}
    print(f"{'scene':<8}{'closure':<16}{'error, mm':>10}{'force, N':>10}{'reload, mm':>12}")
    for name, body in bodies.items():
        print(*closures(name, body), sep="\n", flush=True)
    print(f"\n{'scene':<8}{'mm, N':<12}{'truth':>10}{'low':>11}{'high':>11}{'solves':>8}")
    for name, body in bodies.items():
        print(*intervals(name, body), sep="\n", flush=True)


if __name__ == "__main__":
    main()
