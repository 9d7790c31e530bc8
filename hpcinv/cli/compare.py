"""``hpcinv compare``: how far two bodies are from each other."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.untrusted import add_option
from hpcinv.base.quantity.units import readable
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import check_one_process, length_unit
from hpcinv.errors import OutputError

if TYPE_CHECKING:
    import pyvista

    from hpcinv.geometry.workshop.surface_comparison import Side

_ADVICE = "Is the directory there, and writable?"


def add_compare(commands: Any) -> None:
    parser = add_command(
        commands,
        "compare",
        "Measure distances between the surfaces of two bodies, their volumes and overlap.",
        examples=(
            "hpcinv compare results/pdms-beam straight.stl --unit mm\n"
            "hpcinv compare results/breast scan.stl --shape supine --unit mm --align --to distance.vtp\n"
            "hpcinv compare results/liver later.nii.gz --label 5 --align spine"
        ),
        page="how-to/compare.md",
    )
    parser.add_argument(
        "one", type=Path, help="a mesh, a closed surface (.stl, .ply, .obj, .vtp, .vtk), a segmented image, or a run"
    )
    parser.add_argument("other", type=Path, help="the body to compare with, in any of these forms")
    parser.add_argument("--unit", help="length unit of the files that are not runs (default: mm of images, else m)")
    parser.add_argument(
        "--label",
        type=_labels,
        default=[],
        metavar="N[,N]",
        help="numbers of the body's voxels in images (default: all but 0)",
    )
    parser.add_argument("--shape", default="undeformed", help="of runs: undeformed, deformed, or the name of a state")
    parser.add_argument(
        "--align",
        nargs="?",
        const="",
        metavar="REGION[,REGION]",
        help="move the first rigidly to the second before, by all of their surfaces or by regions of them",
    )
    parser.add_argument(
        "--to", type=Path, metavar="FILE", help="write the first surface with its distances in m (.vtp)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures, in SI units")
    add_option(parser)
    parser.set_defaults(command=_compare)


def _labels(text: str) -> list[int]:
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not a list of whole numbers such as 5 or 5,6") from None


def _describe(path: Path, side: Side) -> None:
    centre = ", ".join(f"{c:.6g}" for c in side.centre)
    axis = ", ".join(f"{c:.3g}" for c in side.axes[0])
    print(f"{path}: volume {readable(side.volume, 'm^3')}, centre ({centre}) m, long axis ({axis})")
    mean, rms, most, largest = (readable(d, "m") for d in (side.mean, side.rms, side.quantile_95, side.largest))
    print(f"  from the other's surface: mean {mean} (outside positive), rms {rms}, 95 % {most}, largest {largest}")


def _compare(options: argparse.Namespace) -> int:
    unit = None if options.unit is None else length_unit(options.unit)
    if options.to is not None and options.to.suffix != ".vtp":
        raise OutputError(f"{options.to}: a surface with distances ends in .vtp", "Name it *.vtp.")
    check_one_process("compare")
    from hpcinv.geometry.workshop.comparison import surface_in
    from hpcinv.geometry.workshop.surface_comparison import compare

    first, second = (surface_in(path, unit, options.shape, options.label) for path in (options.one, options.other))
    align = None
    if options.align is not None:
        names = options.align.split(",") if options.align else []
        if names and not first.regions:
            raise OutputError(f"{options.one}: has no regions to align by", "Give --align without regions.")
        align = first.part(names), second.part(names)
    comparison = compare(first.surface, second.surface, align)
    if align:
        moved, angle = readable(comparison.translation, "m"), math.degrees(comparison.rotation)
        print(f"{options.one} moved by {moved}, turned by {angle:.3g} degrees")
    _describe(options.one, comparison.first)
    _describe(options.other, comparison.second)
    print(f"overlap (Dice): {comparison.dice:.4f}")
    if options.json is not None:
        write_output(options.json, json.dumps(comparison.as_data(), indent=1).encode(), _ADVICE)
    if options.to is not None:
        write_output(options.to, _vtp(comparison.surface).encode(), _ADVICE)
    return 0


def _vtp(surface: pyvista.PolyData) -> str:
    """Return the content of a VTP file: VTK itself crashes if it cannot write all of it."""
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(surface)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return str(writer.GetOutputString())
