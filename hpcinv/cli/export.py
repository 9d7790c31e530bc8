"""``hpcinv export``: the shape of a run as a closed surface with a mould of it, as a mesh, or as a whole deck."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.names import check_directory_of
from hpcinv.base.files.untrusted import add_option
from hpcinv.base.mesh_formats import MESHES
from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.cli.export_programs import program_of, refuse_options_of_surfaces, warn_of_nodes
from hpcinv.cli.help import add_command
from hpcinv.cli.mesh_input import check_one_process, force_unit, length, length_unit
from hpcinv.errors import OutputError

if TYPE_CHECKING:
    from hpcinv.geometry.workshop.mould import Split
    from hpcinv.geometry.workshop.solid import Solid
    from hpcinv.mesh.source import MeshSource

INP_PROGRAMS = ("calculix", "abaqus")


def add_export(commands: Any) -> None:
    export = add_command(
        commands,
        "export",
        "Write the shape of a finished run as STL, PLY, 3MF, faceted STEP, mesh or deck, with a mould of it.",
        examples=(
            "hpcinv export results/pdms-beam --to beam.stl\n"
            "hpcinv export results/pdms-beam --to beam.3mf --scale 1.02 --tolerance '0.02 mm'\n"
            "hpcinv export results/pdms-beam --to beam.ply --mould mould.stl --wall '8 mm' --split z\n"
            "hpcinv export results/pdms-beam --to beam.inp\n"
            "hpcinv export results/liver --to rest.seg.nrrd\n"
            "hpcinv export results/pdms-beam --deck beam.inp --for abaqus --unit mm"
        ),
        page="how-to/export.md",
    )
    export.add_argument("run", type=Path, help="directory of the run")
    what = export.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--to",
        type=Path,
        metavar="FILE",
        help="surface (.stl, .ply, .3mf, .step), mesh of solid cells (.vtu, .inp, .pts, …), OpenUSD (.usda), "
        "state of ParaView with both bodies (.py), or label map of a job on an image (.nrrd, .nii.gz)",
    )
    what.add_argument(
        "--deck",
        type=Path,
        metavar="FILE",
        help="whole deck of CalculiX and Abaqus (.inp), FEBio (.feb) or Ansys (.cdb, .dat): rest shape, laws, "
        "supports, loads; and NAME-expected.csv",
    )
    export.add_argument(
        "--for",
        dest="program",
        choices=INP_PROGRAMS,
        help=".inp: the program that reads the deck (default: calculix); abaqus has hybrid elements",
    )
    export.add_argument(
        "--copy-of",
        type=Path,
        metavar="DECK",
        help=".inp, .feb, .cdb: copy this deck of the job, with the nodes of the shape",
    )
    export.add_argument(
        "--shape",
        default="undeformed",
        help="undeformed (default), deformed, or the name of a state of the job; with --deck, the state that is loaded,"
        " in .inp also several as steps: worn,pulled",
    )
    export.add_argument("--region", help="only the cells of this region (physical group)")
    export.add_argument("--unit", default="mm", help="of the coordinates in the files (default: mm)")
    export.add_argument("--force-unit", default="N", help="of the forces in a deck, such as mN (default: N)")
    export.add_argument(
        "--scale", type=float, default=1.0, help="factor of all lengths about the origin, such as 1.02 for shrinkage"
    )
    export.add_argument(
        "--tolerance",
        help="largest distance of the triangles from curved cells (default: so small that the volume is right to 1e-5)",
    )
    export.add_argument(
        "--refit",
        metavar="DISTANCE",
        help=".step of a job with mesh.cad: refit the faces of that file up to this distance, such as '0.05 mm'",
    )
    export.add_argument(
        "--mould",
        type=Path,
        metavar="FILE",
        help="also write a mould: a block with the shape cut out of it (.stl, .ply, .3mf, .step)",
    )
    export.add_argument("--wall", default="10 mm", help="thickness of the mould around the shape (default: 10 mm)")
    export.add_argument(
        "--split", metavar="AXIS[=POSITION]", help="split the mould, such as z (in the middle) or 'z=12 mm'"
    )
    add_option(export)
    export.set_defaults(command=_export)


def _export(options: argparse.Namespace) -> int:
    unit = length_unit(options.unit)
    wall = length("--wall", options.wall) / unit
    tolerance = 0.0 if options.tolerance is None else length("--tolerance", options.tolerance)
    if not (options.scale > 0 and math.isfinite(options.scale)):
        raise OutputError(f"--scale {options.scale:g}: must be above 0")
    refit = _refit_distance(options)
    plane = _plane(options, unit)
    check_one_process("export")
    if options.deck is not None:
        return _export_deck(options, unit)
    if options.copy_of is not None:
        return _export_copy(options)
    if suffix_of(options.to) in MESHES:
        return _export_cells(options, unit)
    if (other := program_of(options.to)) is not None:
        return other(options, unit)
    return _export_solid(options, unit, wall, tolerance, refit, plane)


def _export_solid(
    options: argparse.Namespace,
    unit: float,
    wall: float,
    tolerance: float,
    refit: float | None,
    plane: tuple[int, float | None] | None,
) -> int:
    """Write a closed surface or a solid, and its mould."""
    from hpcinv.geometry.workshop.formats import check, write
    from hpcinv.geometry.workshop.mould import Mould, Split, mould
    from hpcinv.geometry.workshop.run_shapes import read_shape
    from hpcinv.geometry.workshop.solid import region_cells, solid_of, volume_of

    split = None if plane is None else Split(*plane)
    halves = _halves(options.mould, split)
    if twice := [path for path in halves if path.resolve() == options.to.resolve()]:
        raise OutputError(f"--mould {twice[0]}: is the file of the part (--to)", "Name another file.")
    for path in (options.to, *halves):
        check(path, options.unit)
    source = read_shape(options.run, options.shape)
    cells = None if options.region is None else region_cells(source, options.region)
    body = volume_of(source, cells) * options.scale**3
    factor = options.scale / unit
    part = solid_of(source, cells, tolerance / options.scale or None).scaled(factor)
    moulds = mould(part, wall, split) if halves else Mould([], [])
    cores = _cores(options, len(moulds.cores))
    ratio = part.volume * unit**3 / body
    if refit is None or not _write_refitted(options, source, refit, body):
        _describe(options.to, part, unit, f"; of the body {readable(body, 'm^3')}, ratio {ratio:.6f}")
        write(options.to, part, options.unit)
    for path, solid in zip([*halves, *cores], [*moulds.blocks, *moulds.cores], strict=True):
        _describe(path, solid, unit)
        write(path, solid, options.unit)
    _warn(options, part, split)
    _warn_of_pieces(dict(zip(halves, moulds.blocks, strict=True)), cores)
    warn_of_nodes(options, source)
    return 0


def _export_deck(options: argparse.Namespace, unit: float) -> int:
    """Write what another program needs to load the rest shape."""
    from hpcinv.studies.second_opinion.calculix_deck import expected_path
    from hpcinv.studies.second_opinion.decks import DECKS
    from hpcinv.studies.second_opinion.loaded_body import loaded_body
    from hpcinv.studies.second_opinion.units import Units

    suffix = suffix_of(options.deck)
    if suffix not in DECKS:
        raise OutputError(
            f"--deck {options.deck}: is not a deck of CalculiX, Abaqus, FEBio or Ansys",
            f"Let its name end with {', '.join(DECKS)}.",
        )
    if options.program and suffix != ".inp":
        raise OutputError(f"--for {options.program}: is for decks whose name ends with .inp")
    form = DECKS[suffix]
    state, *more = ("" if options.shape == "undeformed" else options.shape).split(",")
    if more and suffix != ".inp":
        raise OutputError(f"--shape {options.shape}: only decks of CalculiX and Abaqus (.inp) have several states")
    body = loaded_body(options.run, form.loads, form.abilities, state)
    body.steps += [loaded_body(options.run, form.loads, form.abilities, name) for name in more]
    units = Units(unit, force_unit(options.force_unit))
    deck = form.write(options.deck, body, units, **({"program": options.program} if options.program else {}))
    print(f"{options.deck}: {len(deck.nodes):,} nodes, {deck.element}, in {options.force_unit} and {options.unit}")
    print(f"{expected_path(options.deck)}: where the program should find them")
    for note in body.notes:
        print(f"note: {note}")
    return 0


def _export_copy(options: argparse.Namespace) -> int:
    """Write the deck from which the mesh was read, with the nodes of the shape."""
    from hpcinv.base.files.atomic import write_output
    from hpcinv.base.reading.door import admitted
    from hpcinv.errors import MeshError
    from hpcinv.formats.cards.moved_cdb import moved_archive
    from hpcinv.formats.cards.moved_feb import moved_model
    from hpcinv.formats.cards.moved_inp import moved_deck
    from hpcinv.geometry.workshop.run_shapes import read_shape
    from hpcinv.output.run_directory import RunDirectory

    movers = {".inp": moved_deck, ".feb": moved_model, ".cdb": moved_archive}
    suffix = suffix_of(options.copy_of)
    if options.to is None or suffix not in movers or suffix_of(options.to) != suffix:
        text = f"needs two decks with one of the endings {', '.join(movers)}: --to NEW.inp --copy-of OLD.inp"
        raise OutputError(f"--copy-of: {text}")
    source = read_shape(options.run, options.shape)
    unit = RunDirectory(options.run).job(None).mesh.metres
    rows = zip(source.node_tags.tolist(), (source.points * options.scale / unit).tolist(), strict=True)
    try:
        text = admitted(options.copy_of).read_bytes().decode("utf-8", "surrogateescape")
        moved = movers[suffix](text, dict(rows))
    except OSError as error:
        raise OutputError(f"{options.copy_of}: cannot be read: {error.strerror}") from None
    except MeshError as error:
        raise OutputError(f"{options.copy_of}: {error.message}", error.advice) from None
    write_output(options.to, moved.encode("utf-8", "surrogateescape"))
    print(f"{options.to}: {options.copy_of} with {len(source.points):,} nodes of the {options.shape} shape")
    warn_of_nodes(options, source)
    return 0


def _export_cells(options: argparse.Namespace, unit: float) -> int:
    """Write the cells as a mesh."""
    from hpcinv.geometry.workshop.cell_mesh import write_cells
    from hpcinv.geometry.workshop.run_shapes import read_shape
    from hpcinv.geometry.workshop.solid import region_cells, volume_of

    refuse_options_of_surfaces(options)
    check_directory_of(options.to)
    source = read_shape(options.run, options.shape)
    cells = None if options.region is None else region_cells(source, options.region)
    mesh = write_cells(options.to, source, cells, options.scale, unit)
    volume, body = volume_of(mesh, None), volume_of(source, cells) * options.scale**3
    print(
        f"{options.to}: {len(mesh.cells):,} cells ({mesh.kind}, {mesh.nodes_per_cell} nodes) in {options.unit}, volume"
        f" {readable(volume, 'm^3')}; of the body {readable(body, 'm^3')}, ratio {volume / body:.6f}"
    )
    print(f"regions: {', '.join(dict.fromkeys(group.name for group in mesh.groups)) or 'none'}")
    warn_of_nodes(options, source)
    return 0


def _refit_distance(options: argparse.Namespace) -> float | None:
    """Return the distance (m) of refitted faces."""
    if options.refit is None:
        return None
    if suffix_of(options.to) not in (".step", ".stp") or options.region is not None:
        raise OutputError("--refit: is for whole bodies in .step files", "Write --to NAME.step, without --region.")
    return length("--refit", options.refit)


def _write_refitted(options: argparse.Namespace, source: MeshSource, distance: float, volume: float) -> bool:
    """Write the refitted faces of the job's CAD file; warn and return False if that is not possible."""
    from hpcinv.base.files.atomic import write_output
    from hpcinv.geometry.workshop.cad_refit import NotRefitted, movement, refit
    from hpcinv.geometry.workshop.run_shapes import read_cad

    path, spec, given = read_cad(options.run)
    try:
        move = movement(given, source, spec.metres, options.scale, distance * 1e3)
        step = refit(path, move, distance * 1e3, volume * 1e9)
    except NotRefitted as fault:
        print(f"warning: {options.to}: faceted, since the faces are not refitted: {fault}", file=sys.stderr)
        return False
    write_output(options.to, step.content, "Is the directory writable, and space left?")
    body = f"volume {readable(step.volume * 1e-9, 'm^3')}, ratio {step.volume * 1e-9 / volume:.6f}"
    deviation = f"{readable(step.deviation * 1e-3, 'm')} from the shape at most, at {step.points:,} points"
    print(f"{options.to}: {step.faces} refitted faces, one solid, {deviation}; {body}")
    return True


def _describe(path: Path, solid: Solid, unit: float, more: str = "") -> None:
    size = " x ".join(readable(float(length) * unit, "m") for length in solid.size)
    volume = readable(solid.volume * unit**3, "m^3")
    print(f"{path}: {len(solid.triangles):,} triangles, closed, {size}, volume {volume}{more}")


def _warn(options: argparse.Namespace, part: Solid, split: Split | None) -> None:
    """Print what keeps the part from coming out of its mould."""
    if options.mould is None:
        return
    from hpcinv.geometry.workshop.mould import UNDERCUT, undercut

    if split is None:
        print(f"warning: {options.mould}: the cavity is closed all around; --split opens the mould", file=sys.stderr)
    elif (share := undercut(part, split)) > UNDERCUT:
        text = f"{share:.1%} of the shape's surface are undercuts for this split"
        print(f"warning: {options.mould}: {text}; a soft part may still come out", file=sys.stderr)


def _warn_of_pieces(halves: Mapping[Path, Solid], cores: Sequence[Path]) -> None:
    """Print how cores are used, and which halves have pieces that hold nowhere."""
    from hpcinv.geometry.workshop.mould import loose_pieces

    if cores:
        which = "is the core of a closed chamber" if len(cores) == 1 else "are the cores of closed chambers"
        advice = "hold it inside the mould, and melt or dissolve it out of the part; or cast the part in two pieces"
        print(f"warning: {', '.join(map(str, cores))}: {which}: {advice}", file=sys.stderr)
    for path, half in halves.items():
        if count := loose_pieces(half):
            text = f"{count} {'piece is' if count == 1 else 'pieces are'} apart from the rest: choose another --split"
            print(
                f"warning: {path}: {text}, or fix {'it' if count == 1 else 'them'} to the other half", file=sys.stderr
            )


def _cores(options: argparse.Namespace, count: int) -> list[Path]:
    """Return the files of the cores of a mould."""
    names = ["core"] if count == 1 else [f"core-{i}" for i in range(1, count + 1)]
    cores = [options.mould.with_stem(f"{options.mould.stem}-{name}") for name in names]
    if twice := [path for path in cores if path.resolve() == options.to.resolve()]:
        raise OutputError(f"--to {options.to}: is the file of the core of the mould ({twice[0]})", "Name another file.")
    return cores


def _plane(options: argparse.Namespace, unit: float) -> tuple[int, float | None] | None:
    """Return axis and position of the plane that splits the mould."""
    if options.split is None:
        return None
    if options.mould is None:
        raise OutputError(f"--split {options.split}: splits a mould, and there is none", "Give --mould FILE.")
    name, equals, position = (part.strip() for part in options.split.partition("="))
    if name not in ("x", "y", "z"):
        raise OutputError(f"--split {options.split}: must be x, y or z, and may have a position, such as 'z=12 mm'")
    return "xyz".index(name), length("--split", position, positive=False) / unit if equals else None


def _halves(path: Path | None, split: Split | None) -> list[Path]:
    """Return the files of a mould: one, or two with numbers."""
    if path is None:
        return []
    return [path] if split is None else [path.with_stem(f"{path.stem}-{i}") for i in (1, 2)]
