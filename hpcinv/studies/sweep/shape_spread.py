"""Spread of a shape over the cases of a sweep: standard deviation and dominating parameter at each node."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.errors import JobError
from hpcinv.mesh.io.vtu import read_vtu
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import DataArray, Floats, MeshSource
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.sweep.chaos import GOOD, Indices, Surrogate, sobol_indices
from hpcinv.studies.sweep.indices import ConvergedSample, accuracy, advice, regression_of, table_of

_STILL = 1e-9  # standard deviation, relative to the largest one, below which a node counts as fixed
_COMPONENTS = 1e-20  # share of the variance of the principal components that are left out
NONE = -1
"""number of the dominating parameter where it is not decided, or nothing varies"""


@dataclass(frozen=True)
class ShapeSpread:
    """Variation of a shape.

    Attributes:
        source: the mesh, in m, of one case.
        mean: positions of the nodes, (n, 3) in m.
        sd: √(sum of the variances of the three coordinates), (n,) in m.
        sd_of_coordinates: (n, 3) in m.
        q2: at each node, 1 where nothing varies; of the surrogate whose degree suits the whole shape.
        first: Sobol index of first order of each parameter at each node, (n, parameters); NaN where nothing varies.
            Indices refer to the sum of the variances of the three coordinates.
        total: total Sobol index of each parameter at each node, (n, parameters).
        dominating: number of the parameter with the largest total index, -1 where nothing varies or the surrogate is
            not good enough.
        whole: indices of the sum of the variances of all nodes; ``None`` if nothing varies.
    """

    source: MeshSource
    mean: Floats
    sd: Floats
    sd_of_coordinates: Floats
    q2: Floats
    first: Floats
    total: Floats
    dominating: Floats
    whole: Indices | None

    def write(self, path: Path, keys: Sequence[str]) -> None:
        """Write the fields on the mean shape as VTU; raises ``OutputError`` if that fails."""
        fields = {
            "sd": self.sd,
            "sd of coordinates": self.sd_of_coordinates,
            "Q2": self.q2,
            "dominating parameter": self.dominating,
        }
        for i, key in enumerate(keys):
            fields |= {f"first-order index of {key}": self.first[:, i], f"total index of {key}": self.total[:, i]}
        data = {name: DataArray(name, "nodes", v if v.ndim == 2 else v[:, None]) for name, v in fields.items()}
        save(path, dataclasses.replace(self.source, data=data), self.mean)


def shape_spread(sample: ConvergedSample, ledger: Ledger, confidence: float) -> ShapeSpread:
    """Return the variation of the shape that the cases of a sample have found.

    It takes 24 bytes for each node and case, several times.

    Raises:
        JobError: cases have kept no shape, or their meshes differ.
    """
    source, positions = _positions(sample, ledger)
    regression = regression_of(sample)
    values = positions.reshape(len(positions), -1)
    centred = values - values.mean(axis=0)
    surrogate = regression.fit(centred)
    mean = (values.mean(axis=0) + surrogate.mean).reshape(-1, 3)
    whole = None
    size = np.ptp(mean, axis=0).max()
    if np.sqrt(np.mean(centred**2)) > np.finfo(float).eps * size:
        # Sums over all coordinates are the same in principal components, which are few.
        variances, left = np.linalg.eigh(centred @ centred.T)
        kept = variances > _COMPONENTS * variances[-1]
        scores = left[:, kept] * np.sqrt(variances[kept])
        whole = sobol_indices(regression, regression.fit_as(scores, surrogate), scores, confidence)
    return _fields(source, mean, surrogate, centred, whole)


def describe_shape(spread: ShapeSpread, keys: Sequence[str], confidence: float) -> Iterator[str]:
    """Yield lines on the variation of a shape."""
    if spread.whole is None:
        yield "shape: the same in all cases"
        return
    node = int(np.argmax(spread.sd))
    coordinates = ", ".join(f"{x:.4g}" for x in spread.mean[node])
    yield f"shape: {accuracy(spread.whole)}"
    yield f"  largest standard deviation of a node {spread.sd[node]:.4g} m, at ({coordinates}) m in the mean shape"
    if not spread.whole.decided:
        yield f"  {advice(spread.whole, len(keys))}"
        return
    yield from table_of(spread.whole, keys, confidence)
    shares = [(spread.dominating == i).mean() for i in range(len(keys))]
    yield "  dominating parameter, by its number in the file: " + ", ".join(
        f"{i} {key} at {100 * share:.0f} % of the nodes"
        for i, (key, share) in enumerate(zip(keys, shares, strict=True))
    )


def _fields(
    source: MeshSource, mean: Floats, surrogate: Surrogate, centred: Floats, whole: Indices | None
) -> ShapeSpread:
    first, total, variance = surrogate.variances
    first, total = (part.reshape(len(part), -1, 3).sum(axis=2).T for part in (first, total))
    coordinate_variance = variance.reshape(-1, 3)
    variance = coordinate_variance.sum(axis=1)
    varies = np.sqrt(variance) > _STILL * np.sqrt(variance.max(initial=0.0))
    errors, squares = (np.sum(v**2, axis=0).reshape(-1, 3).sum(axis=1) for v in (surrogate.errors, centred))
    moves = varies & (whole is not None)
    with np.errstate(all="ignore"):
        q2 = np.where(moves, 1 - errors / squares, 1.0)
        first, total = (np.where(moves[:, None], part / variance[:, None], np.nan) for part in (first, total))
    dominating = np.where(moves & (q2 >= GOOD), np.argmax(np.nan_to_num(total), axis=1), NONE)
    return ShapeSpread(
        source, mean, np.sqrt(variance), np.sqrt(coordinate_variance), q2, first, total, dominating.astype(float), whole
    )


def _positions(sample: ConvergedSample, ledger: Ledger) -> tuple[MeshSource, Floats]:
    """Return the mesh of the first case in m, and the positions of the nodes in each case, (cases, n, 3)."""
    plan = sample.plan
    rest = plan.job(sample.cases[0]).rest
    name = f"shape-{rest}.vtu" if rest else "shape.vtu"
    files_by_case = {case.number: kept_file(ledger.directory(case.key), name) for case in sample.cases}
    if missing := [number for number, path in files_by_case.items() if path is None]:
        raise JobError(
            f"{plan.path}: {len(missing)} of {len(files_by_case)} cases have kept no {name} (first: case"
            f" {missing[0]}); run it with 'set: {{output: {{mesh: [vtu]}}}}' and another 'store'"
        )
    import pyvista  # takes a second to import

    files: Mapping[int, Path] = {number: path for number, path in files_by_case.items() if path is not None}
    first = next(iter(files))
    source = read_vtu(files[first])
    cells = pyvista.read(admitted(files[first])).cells
    positions = np.empty((len(files), *source.points.shape))
    for row, (number, path) in enumerate(files.items()):
        grid = pyvista.read(admitted(path))
        if len(grid.points) != len(source.points) or not np.array_equal(grid.cells, cells):
            raise JobError(
                f"{plan.path}: cases {number} and {first} have different meshes, so that nodes have no standard"
                " deviation; take parameters of the mesh out of the sample"
            )
        positions[row] = grid.points
    unit = source.unit or 1.0
    return source.convert_to_metres(unit), positions * unit


def kept_file(directory: Path, name: str) -> Path | None:
    """Return a file of the latest run of a case that has kept it."""

    def place(run: Path) -> tuple[int, ...]:
        return tuple(int(part) for part in run.name.split("-")[1:])

    runs = sorted(directory.glob("run-*-*"), key=place, reverse=True)
    return next((file for run in runs if (file := run / name).exists()), None)
