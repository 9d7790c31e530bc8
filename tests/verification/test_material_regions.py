"""Laws and parameters that differ from place to place: layers, graded bars, against closed forms and 1D quadrature.

Confined columns keep their width, so that F = diag(1, 1, λ), and the axial stress P(λ) is constant.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log2
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.command_line import CUBE, hpcinv_here, write_job
from helpers.mesh_cases import spec
from helpers.verification import BOX, Solved, box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import MeshError
from hpcinv.mesh import build_body, read_source
from hpcinv.mesh.distributed.partition import partitioned
from hpcinv.mesh.distributed.partitioned import write_partitioned
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations

C1, C2, D1 = 4e3, 1e3, 15e3
MU, LAM = 10e3, 40e3
MOONEY_RIVLIN = {"law": "mooney-rivlin", "c1": C1, "c2": C2, "d1": D1}
NEO_HOOKEAN = {"law": "neo-hookean", "mu": MU, "lam": LAM}
CONFINED = [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}]
LINEAR = {"displacement": 1, "formulation": "displacement"}
LOWER = {"lower": "z < 0.26 m"}  # a quarter of the box
HEIGHT = 0.25
END = 9e3  # Pa


def pull(traction: float = END) -> dict[str, Any]:
    return {"effect": "traction", "region": "z1", "traction": [0, 0, traction], "area_in": "reference"}


def neo_hookean(stretch: Any, mu: Any = MU, lam: Any = LAM) -> Any:
    """P(λ)."""
    return mu * (stretch - 1 / stretch) + lam * np.log(stretch) / stretch


def mooney_rivlin(stretch: Any) -> Any:
    """P(λ)."""
    split = C1 * stretch ** (-5 / 3) + C2 * stretch ** (-7 / 3)
    return 4 / 3 * (stretch**2 - 1) * split + 2 * D1 * (stretch - 1)


def sideways(stretch: float) -> tuple[float, float]:
    """Lateral Cauchy stress of the Mooney–Rivlin and of the neo-Hookean material."""
    split = C1 * stretch ** (-2 / 3) + C2 * stretch ** (-4 / 3)
    return 2 / 3 * (1 - stretch**2) * split / stretch + 2 * D1 * (stretch - 1), LAM * np.log(stretch) / stretch


def root(f: Callable[[Any], Any], low: Any, high: Any) -> Any:
    """Zeros of increasing functions, by bisection."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    for _ in range(80):
        middle = (low + high) / 2
        below = f(middle) < 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return low


def integral(f: Callable[[np.ndarray], np.ndarray], end: float) -> float:
    """∫ f from 0 to ``end``, exact to rounding error for what is as smooth as here."""
    points, weights = np.polynomial.legendre.leggauss(40)
    return float(weights @ f(end * (1 + points) / 2)) * end / 2


def largest(comm: MPI.Intracomm, error: Any) -> float:
    return float(comm.allreduce(float(np.abs(error).max(initial=0.0)), op=MPI.MAX))


def displacement_error(result: Result, exact: Callable[[np.ndarray], np.ndarray]) -> float:
    """Largest error (m) at the degrees of freedom."""
    u, body = result.solutions[0].displacement, result.body
    points = u.function_space.tabulate_dof_coordinates() * body.length_scale
    return largest(body.mesh.comm, u.x.array.reshape(-1, 3) - exact(points))


def stress_error(result: Result, lower: np.ndarray, upper: np.ndarray) -> float:
    """Largest error (Pa) of the Cauchy stress in cells of the two layers."""
    stress = result.solutions[0].cauchy_stress
    dofs = stress.function_space.dofmap.list[:, 0]
    is_lower = np.zeros(len(dofs), dtype=bool)
    is_lower[result.body.cells("lower")] = True
    stress_values = stress.x.array.reshape(-1, 3, 3)[dofs]
    owned = result.body.mesh.topology.index_map(3).size_local
    assert result.body.mesh.comm.allreduce(int(is_lower[:owned].sum())) > 0
    return largest(result.body.mesh.comm, (stress_values - np.where(is_lower[:, None, None], lower, upper))[:owned])


@pytest.mark.everyday("block of a partitioned mesh")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(
    "rest", ["elsewhere", pytest.param("block", marks=pytest.mark.release), "block of a partitioned mesh"]
)
def test_two_confined_layers_stretch_each_by_its_own_law(
    rest: str, comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    """Exact in linear elements, both ways: P is the same in both layers.

    The upper one is what the lower one leaves of the body, whether that is called the rest or by its physical group.
    """
    stretches = [float(root(lambda s, P=P: P(s) - END, 0.5, 3.0)) for P in (mooney_rivlin, neo_hookean)]
    assert stretches[1] > 1.1
    mesh = box((1, 1, 4))
    if "partitioned" in rest:
        file = run_directory / "box.bp"
        whole = spec(meshes / "box.py", parameters=mesh["parameters"])
        on_root(
            comm,
            lambda: write_partitioned(file, MPI.COMM_SELF, partitioned(read_source(whole, meshes / "box.py"), 3)[0]),
        )
        mesh = {"file": str(file)}
    sides = [sideways(s)[i] for i, s in enumerate(stretches)]
    tensors = [np.diag([side, side, END]) for side in sides]
    for analysis in ("forward", "inverse"):
        # Displacement per length of the mesh: of the undeformed, or of the deformed layers.
        slopes = [s - 1 if analysis == "forward" else 1 - 1 / s for s in stretches]

        def exact(x: np.ndarray, slopes: list[float] = slopes) -> np.ndarray:
            z = x[:, 2]
            up = slopes[0] * np.minimum(z, HEIGHT) + slopes[1] * np.maximum(z - HEIGHT, 0.0)
            return np.stack([0 * z, 0 * z, up], axis=1)

        result = package.run(
            job(
                analysis=analysis,
                mesh=mesh,
                regions=LOWER,
                material={"lower": MOONEY_RIVLIN, rest.split()[0]: NEO_HOOKEAN},
                effects=[pull()],
                supports=CONFINED,
                discretisation=LINEAR,
            ),
            comm,
        )
        shape = displacement_error(result, exact)
        stress = stress_error(result, *tensors) / END
        print(f"{analysis}, {comm.size} ranks: displacement to {shape:.1e} m, stress to {stress:.1e} of the traction")
        assert shape < 1e-12
        assert stress < 1e-11  # of the solver's tolerance, 1e-12


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_sheared_layers_of_two_laws_one_of_them_incompressible(comm: MPI.Intracomm) -> None:
    """Layers of isochoric neo-Hookean (μ, shear γ₁) and Mooney–Rivlin (γ₂): the continuous pressure must serve both.

    With μ = 2 (c₁ + c₂)²/(c₁ + 2 c₂) and γ₁ = γ₂ (c₁ + 2 c₂)/(c₁ + c₂) shear and normal stress on the interface are the
    same without any pressure, so that the exact solution is one of the finite elements.
    """
    c1, c2, g2 = 2e3, 1e3, 0.3
    g1, mu = g2 * (c1 + 2 * c2) / (c1 + c2), 2 * (c1 + c2) ** 2 / (c1 + 2 * c2)
    B = np.array([[1 + g1**2, 0, g1], [0, 1, 0], [g1, 0, 1]])
    lower = mu * (B - np.trace(B) / 3 * np.eye(3))
    normal = np.diag([(4 * c1 + 2 * c2) / 3, 2 * (c2 - c1) / 3, -(2 * c1 + 4 * c2) / 3]) * g2**2
    upper = normal + 2 * (c1 + c2) * g2 * np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(lower[2], upper[2], rtol=1e-14)

    constants = {"g1": g1, "g2": g2, "h": "250 mm"}
    moved = {"displacement": ["g1*min(z, h) + g2*max(z - h, 0)", 0, 0], "constants": constants}
    result = package.run(
        job(
            analysis="inverse",
            mesh=box((2, 2, 8), hexahedra=True),
            regions=LOWER,
            material={
                "lower": {"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"},
                "elsewhere": {"law": "mooney-rivlin", "c1": c1, "c2": c2, "d1": "15 kPa"},
            },
            supports=[{"region": "boundary", **moved}],
        ),
        comm,
    )

    def exact(x: np.ndarray) -> np.ndarray:
        z = x[:, 2]
        along = g1 * np.minimum(z, HEIGHT) + g2 * np.maximum(z - HEIGHT, 0.0)
        return np.stack([along, 0 * z, 0 * z], axis=1)

    pressure = result.solutions[0].pressure
    assert pressure is not None
    errors = {
        "displacement": displacement_error(result, exact),
        "stress": stress_error(result, lower, upper) / mu,
        "pressure": largest(comm, pressure.x.array) / mu,
    }
    print(f"{comm.size} ranks: ", ", ".join(f"{name} {error:.1e}" for name, error in errors.items()))
    assert max(errors.values()) < 1e-12


def graded(analysis: str, comm: MPI.Intracomm, cells: int, length: float, mu: str, lam: str) -> float:
    """Axial displacement of the end of a bar."""
    solved = Solved(
        job(
            analysis=analysis,
            mesh=box((1, 1, cells), lx=0.25, ly=0.25, lz=length, hexahedra=True),
            material={"law": "neo-hookean", "mu": mu, "lam": lam},
            effects=[pull()],
            supports=CONFINED,
            discretisation={"formulation": "displacement"},
        ),
        comm,
    )
    u = solved.model.unknowns.displacement().x.array * solved.body.length_scale
    return float(comm.allreduce(float(u.max(initial=0.0)), op=MPI.MAX))


def stretch_at(position: np.ndarray) -> Any:
    """λ for the moduli of ``GRADED`` at this position."""
    mu, lam = MU * (1 + 2 * position**2), LAM * np.exp(-position)
    return root(lambda s: neo_hookean(s, mu, lam) - END, 0.5, 3.0)


GRADED = {"mu": "10 kPa*(1 + 2*({0}/(1 m))^2)", "lam": "40 kPa*exp(-{0}/(1 m))"}


@pytest.mark.release
@pytest.mark.parametrize("position", ["Z", "z"])
def test_a_graded_bar_stretches_as_its_quadrature_says(position: str, comm: MPI.Intracomm) -> None:
    """Moduli on the undeformed bar give dz/dZ = λ(Z), on the deformed one dZ/dz = 1/λ(z); both ways, order four.

    Each is a quadrature one way; the other way has the length that it gives for the given one.
    """
    if position == "Z":
        undeformed, deformed = 1.0, integral(stretch_at, 1.0)
    else:
        undeformed, deformed = integral(lambda z: 1 / stretch_at(z), 1.0), 1.0
    moduli = {name: formula.format(position) for name, formula in GRADED.items()}
    for analysis, length in (("forward", undeformed), ("inverse", deformed)):
        errors = [abs(graded(analysis, comm, n, length, **moduli) - (deformed - undeformed)) for n in (8, 16)]
        order = log2(errors[0] / errors[1])
        print(f"moduli of {position}, {analysis}: errors {errors[0]:.1e}, {errors[1]:.1e} m, order {order:.2f}")
        assert errors[1] < 1e-7
        assert order > 3.8


def write_with_arrays(path: Path, meshes: Path) -> None:
    """A box as VTU, with the moduli of its layers in cells and a linear one at nodes, in kPa."""
    mesh = read_source(spec(meshes / "box.py", parameters={"nx": 2, "ny": 1, "nz": 4}), meshes / "box.py")
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: mesh.cells}, np.array(mesh.points))
    heights = mesh.points[mesh.cells, 2].mean(axis=1)
    grid.cell_data["layers"] = np.where(heights < HEIGHT, MU, 3 * MU) / 1e3
    grid.point_data["ramp"] = MU * (1 + mesh.points[:, 2]) / 1e3
    grid.save(path)


def bent(comm: MPI.Intracomm, mesh: Path, material: Any) -> np.ndarray:
    """Displacements (m) of a heavy cantilever, as the mesh orders them."""
    solved = Solved(
        job(
            analysis="inverse",
            mesh={"file": str(mesh)},
            regions=LOWER | {"foot": "z < 1 mm"},
            material=material,
            effects=[{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": "0.5 g/cm^3"}],
            supports=[{"region": "foot", "fix": ["x", "y", "z"]}],
            discretisation=LINEAR,
        ),
        comm,
    )
    u: np.ndarray = solved.model.unknowns.displacement().x.array
    return u * solved.body.length_scale


@pytest.mark.parallel([2, 1])
def test_equal_materials_written_differently_give_the_same_shape(
    comm: MPI.Intracomm, run_directory: Path, meshes: Path
) -> None:
    file = run_directory / "box.vtu"
    on_root(comm, lambda: write_with_arrays(file, meshes))

    def mu(value: Any) -> dict[str, Any]:
        return NEO_HOOKEAN | {"mu": value}

    same: dict[str, tuple[Any, ...]] = {
        "one value": (NEO_HOOKEAN, mu({"lower": MU, "elsewhere": MU})),
        "two values": (
            {"lower": NEO_HOOKEAN, "elsewhere": mu(3 * MU)},
            mu({"data": "layers", "unit": "kPa"}),
        ),
        "linear": (mu("10 kPa*(1 + z/(1 m))"), mu({"data": "ramp", "unit": "kPa"})),
    }
    shapes = {name: [bent(comm, file, material) for material in ways] for name, ways in same.items()}
    size = largest(comm, shapes["one value"][0])
    assert size > 0.05
    for name, (first, *others) in shapes.items():
        gap = max(largest(comm, other - first) for other in others) / size
        print(f"{name}, {comm.size} ranks: {gap:.1e}")
        assert gap < 1e-11
        if name != "one value":
            assert largest(comm, first - shapes["one value"][0]) > 0.1 * size


GRAVITY = {"effect": "gravity", "acceleration": [0, 0, -9.81]}
REFUSED: list[tuple[dict[str, Any], str]] = [
    (
        {"material": {"lower": NEO_HOOKEAN, "upper": MOONEY_RIVLIN}},
        "material: 6 cells are in none of its regions (lower, upper)",
    ),
    (
        {"material": {"lower": NEO_HOOKEAN, "most": MOONEY_RIVLIN}},
        "material: some cells are in 'most' and in 'lower', which are both regions of the job",
    ),
    (
        {"material": {"all": NEO_HOOKEAN, "block": MOONEY_RIVLIN}},
        "material: the regions of the job leave no cell of the group 'block'",
    ),
    (
        {"effects": [GRAVITY | {"density": {"most": 1, "lower": 2, "block": 3}}]},
        "effects[0].density: some cells are in 'lower' and in 'most', which are both regions of the job",
    ),
    (
        {"material": {"lower": NEO_HOOKEAN, "loewr": MOONEY_RIVLIN}},
        "material: {path}: no region 'loewr'. Did you mean 'lower'?",
    ),
    (
        {"material": {"x0": NEO_HOOKEAN, "elsewhere": MOONEY_RIVLIN}},
        "material: {path}: region 'x0' has facets but no cells",
    ),
    (
        {"material": NEO_HOOKEAN | {"mu": {"lower": 1, "upper": 2}}},
        "material.mu: 6 cells are in none of its regions (lower, upper)",
    ),
    (
        {"material": {"lower": NEO_HOOKEAN, "elsewhere": NEO_HOOKEAN | {"mu": "10 kPa*(0.5 - Z/(1 m))"}}},
        "material.elsewhere: the shear modulus must be positive, but is -",
    ),
    (
        {"material": {"law": "isochoric-neo-hookean", "mu": "1 kPa*Z/(1 m)", "kappa": "1 kPa*(0.5 - Z/(1 m))"}},
        "material.kappa must be above 0, but is -",
    ),
    ({"material": NEO_HOOKEAN | {"mu": "1 kPa*log(Z/(1 m) - 0.5)"}}, "material.mu must be finite, but is nan"),
    ({"material": NEO_HOOKEAN | {"lam": {"data": "stiffness"}}}, "no data array 'stiffness'"),
    ({"effects": [pull() | {"region": "top"}]}, "effects[0].region: {path}: no region 'top'"),
    ({"effects": [pull() | {"region": "block"}]}, "effects[0].region: {path}: region 'block' has cells but no facets"),
    (
        {"effects": [pull() | {"traction": [0, 0, "1 Pa/(Z - Z)*(1 m)"]}]},
        "effects[0].traction must be finite, but is inf",
    ),
]


@pytest.mark.parallel(2)
def test_regions_that_the_mesh_lacks_are_refused_before_the_solve(comm: MPI.Intracomm) -> None:
    regions = {"lower": "z < 0.26 m", "upper": "z > 0.49 m", "most": "z < 0.76 m", "all": "z < 2 m"}
    for changes, text in REFUSED:
        data = {"material": NEO_HOOKEAN, "supports": CONFINED, "discretisation": LINEAR, "regions": regions}
        given = job(mesh=box((1, 1, 4)), **data | changes)
        body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
        with pytest.raises(MeshError) as caught:
            Equations(given, body, Timings())
        assert text.format(path=given.resolve(BOX)) in caught.value.message, caught.value.message
        assert caught.value.advice
        assert len(set(comm.allgather(str(caught.value)))) == 1


@pytest.mark.parametrize(
    ("material", "text"),
    [
        ({"law": "neo-hookean", "mu": "1 kPa*(0.5 - X/(1 m))", "lam": "4 kPa"}, "the shear modulus must be positive"),
        ({"x0": {"law": "neo-hookean", "mu": 1, "lam": 4}}, "region 'x0' has facets but no cells"),
    ],
)
@pytest.mark.parallel(2)
def test_invalid_materials_of_regions_end_two_ranks_with_exit_code_2(
    material: Any, text: str, run_directory: Path
) -> None:
    stated = {"formulation": "displacement"}
    file = write_job(run_directory / "job.yaml", CUBE, material=material, discretisation=stated)
    done = hpcinv_here("run", file, cwd=run_directory)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count(text) == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert "load" not in done.stdout
    assert not (run_directory / "results").exists()
