"""Meshes and conditions for the tests of ``hpcinv.mesh``, made without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hpcinv.base.quantity.expressions import Expression
from hpcinv.job.job import MeshSpec

TETRAHEDRON = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def spec(file: Path | str, **settings: object) -> MeshSpec:
    """The mesh part of a job."""
    return MeshSpec.model_validate({"file": str(file), **settings})


def conditions(**texts: str) -> Mapping[str, Expression]:
    """Geometric regions."""
    return {name: Expression(text) for name, text in texts.items()}


def write_msh22(
    path: Path,
    nodes: Sequence[Sequence[float]],
    elements: Sequence[tuple[int, int, int, Sequence[int]]],
    names: Sequence[tuple[int, int, str]] = (),
) -> Path:
    """Write MSH 2.2 text: elements are (gmsh type, physical tag, entity, nodes from 1), names (dim, tag, name)."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if names:
        lines += ["$PhysicalNames", str(len(names)), *(f'{d} {t} "{n}"' for d, t, n in names), "$EndPhysicalNames"]
    lines += ["$Nodes", str(len(nodes))]
    lines += [f"{i} {' '.join(f'{c:.17g}' for c in node)}" for i, node in enumerate(nodes, 1)]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for i, (kind, physical, entity, numbers) in enumerate(elements, 1):
        lines.append(f"{i} {kind} 2 {physical} {entity} {' '.join(map(str, numbers))}")
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    return path
