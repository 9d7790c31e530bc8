"""``hpcinv export --to`` files of programs that have neither a mesh format of ours nor surfaces."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import OutputError

if TYPE_CHECKING:
    from hpcinv.mesh.source import MeshSource


def program_of(path: Path) -> Callable[[argparse.Namespace, float], int] | None:
    """Return what writes a file of this name, of the options and the unit (m); ``None`` if it is of another kind."""
    suffix = suffix_of(path.stem) if suffix_of(path) == ".gz" else suffix_of(path)
    return _PROGRAMS.get(suffix)


def _export_opencarp(options: argparse.Namespace, unit: float) -> int:
    """Write the cells as the three files of openCARP, in µm."""
    from hpcinv.geometry.workshop.opencarp import write_opencarp
    from hpcinv.geometry.workshop.run_shapes import read_shape
    from hpcinv.geometry.workshop.solid import region_cells, volume_of

    refuse_options_of_surfaces(options)
    source = read_shape(options.run, options.shape)
    cells = None if options.region is None else region_cells(source, options.region)
    done = write_opencarp(options.to, source, cells, options.scale)
    body = volume_of(source, cells) * options.scale**3
    print(
        f"{options.to}, .elem, .lon: {done.cells:,} tetrahedra in µm, volume {readable(done.volume, 'm^3')}; "
        f"of the body {readable(body, 'm^3')}, ratio {done.volume / body:.6f}"
    )
    print(f"regions: {', '.join(f'{number} is {name}' for number, name in done.regions.items()) or 'none (0)'}")
    print(f"directions: {', '.join(done.directions) or 'none in the shape, (1, 0, 0) instead'}")
    warn_of_nodes(options, source)
    return 0


def _export_usd(options: argparse.Namespace, unit: float) -> int:
    """Write the loaded body with its rest shape for OpenUSD."""
    from hpcinv.geometry.workshop.run_shapes import DEFORMED, UNDEFORMED, read_shape
    from hpcinv.geometry.workshop.usd import write_usd
    from hpcinv.output.run_directory import RunDirectory

    refuse_options_of_surfaces(options)
    if options.region is not None:
        raise OutputError(f"--region: {options.to} has the whole body, with its regions")
    rest = read_shape(options.run, UNDEFORMED)
    loaded = read_shape(options.run, DEFORMED if options.shape == UNDEFORMED else options.shape)
    done = write_usd(options.to, RunDirectory(options.run).job(None), loaded, rest, options.scale, unit)
    curved = f", up to {readable(done.distance, 'm')} from curved edges" if done.distance > 1e-9 else ""
    print(f"{options.to}: {done.cells:,} tetrahedra in {options.unit}, loaded and at rest{curved}")
    print(f"regions: {', '.join(done.regions.values()) or 'none'}")
    warn_of_nodes(options, rest)
    return 0


def _export_paraview(options: argparse.Namespace, unit: float) -> int:
    """Write a script that draws both bodies in ParaView."""
    from hpcinv.geometry.workshop.paraview_state import VIEWS, write_paraview_state

    refuse_options_of_surfaces(options)
    write_paraview_state(options.to, options.run)
    names = " and ".join(array for _, array, _, _ in VIEWS)
    print(f"{options.to}: both bodies of {options.run} by {names}, for ParaView from 5.10 on (File, Load State)")
    return 0


def _export_labels(options: argparse.Namespace, unit: float) -> int:
    """Write the label map of a shape on the grid of the job's image."""
    from hpcinv.geometry.imaging.image_files import read_voxels
    from hpcinv.geometry.imaging.label_image import numbered
    from hpcinv.geometry.imaging.shape_labels import WRITTEN, shape_labels, write_labels
    from hpcinv.geometry.workshop.run_shapes import read_shape
    from hpcinv.geometry.workshop.solid import volume_of
    from hpcinv.output.run_directory import RunDirectory

    refuse_options_of_surfaces(options)
    if not options.to.name.lower().endswith(WRITTEN):
        raise OutputError(f"{options.to}: label maps are written with the endings {', '.join(WRITTEN)}")
    source = read_shape(options.run, options.shape)
    job = RunDirectory(options.run).job(None)
    if not job.mesh.is_image:
        text = f"{options.run}: its job has no image (mesh.image), whose grid a label map could have"
        raise OutputError(text, "Export .stl, which 3D Slicer makes a segmentation of.")
    if options.scale != 1.0 or options.region is not None:
        raise OutputError(f"--scale, --region: {options.to} has the whole body in its size")
    path = job.resolve(job.mesh.file)
    image = read_voxels(path)
    numbers = {name: members[0] for name, members in numbered(path, job.mesh.labels, image.names).items()}
    done = shape_labels(source, image, numbers, job.mesh.metres, job.mesh.orientation)
    write_labels(options.to, done.grid)
    size = " x ".join(map(str, done.grid.numbers.shape))
    larger = f", larger than {path.name} by {done.added.sum(axis=0).tolist()}" if done.added.any() else ""
    print(f"{options.to}: {size} voxels in the frame of {path.name}{larger}")
    for name, number in numbers.items():
        print(f"{name}: {number}, {readable(done.volumes[name], 'm^3')}")
    body, total = volume_of(source, None), sum(done.volumes.values())
    print(f"volume {readable(total, 'm^3')}; of the body {readable(body, 'm^3')}, ratio {total / body:.4f}")
    warn_of_nodes(options, source)
    return 0


def refuse_options_of_surfaces(options: argparse.Namespace) -> None:
    for name in ("tolerance", "mould"):
        if getattr(options, name) is not None:
            raise OutputError(f"--{name}: is for surfaces, and {options.to} is a mesh", "Export a surface as well.")


def warn_of_nodes(options: argparse.Namespace, source: MeshSource) -> None:
    """Print what a run has not checked, and how far its file is from the body that it computed."""
    from hpcinv.geometry.workshop.run_shapes import left_out, unchecked

    if text := unchecked(options.run):
        print(f"warning: {options.to}: {text}", file=sys.stderr)
    if distance := left_out(options.run, source):
        text = (
            f"{source.path.name} has fewer nodes than the computed body, and is up to {readable(distance, 'm')} from it"
        )
        print(f"warning: {options.to}: {text}; run with 'mesh: {{geometry_degree: 2}}'", file=sys.stderr)


_PROGRAMS: dict[str, Callable[[argparse.Namespace, float], int]] = {
    **dict.fromkeys((".nrrd", ".nii", ".mha"), _export_labels),
    ".pts": _export_opencarp,
    ".py": _export_paraview,
    ".usda": _export_usd,
}
"""by suffix"""
