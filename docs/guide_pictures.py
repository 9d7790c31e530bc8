"""Pictures at the head of guides: ``python3 -m uv run python docs/guide_pictures.py [NAME…]``, by the guides' commands.

Each function runs in a directory of its own with ``jobs`` and ``meshes``, and returns the drawn picture. It is kept in
``docs/pictures``, at most 900 pixels wide. The dossier needs Chromium.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import gmsh
import pyvista
from gallery_pictures import ROOT, shrink
from PIL import Image

from hpcinv.mesh.distributed.parts import partitioned
from hpcinv.mesh.readers import FILES

SLIDING = """\
mesh: {file: meshes/thick_cylinder.py, parameters: {around: 12, radial: 4, along: 3, hexahedra: true}}
material: {law: neo-hookean, young: 100 kPa, poisson: 0.3}
effects: [{effect: pressure, region: inner, pressure: 10 kPa}]
supports:
  - {region: x0, fix: [normal]}
  - {region: y0, fix: [normal]}
  - {region: outer, fix: [normal]}
  - {region: z0, fix: [z]}
"""


def typed(line: str) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run(line, shell=True, check=True, env=os.environ | {"PATH": path}, stdout=subprocess.DEVNULL)


def cad() -> str:
    gmsh.initialize()
    block = gmsh.model.occ.addBox(0, 0, 0, 40, 30, 20)
    pin = gmsh.model.occ.addCylinder(20, 15, -8, 0, 0, 36, 6)
    gmsh.model.occ.fragment([(3, block)], [(3, pin)])
    gmsh.model.occ.synchronize()
    gmsh.write("part.step")
    gmsh.finalize()
    typed("hpcinv mesh from-cad part.step part.msh --size '4 mm' && hpcinv mesh show part.msh --output drawn.png")
    return "drawn.png"


def dossier() -> str:
    typed("hpcinv run jobs/thick-sphere.yaml --output results/job && hpcinv dossier results/job")
    options = "--headless --no-sandbox --hide-scrollbars --window-size=900,560 --screenshot=drawn.png"
    typed(f"chromium {options} results/job/dossier.html 2> chromium.log")
    return "drawn.png"


def export() -> str:
    typed("hpcinv run jobs/pdms-beam.yaml --certificate off --output results/beam")
    typed('hpcinv export results/beam --to beam.ply --mould mould.ply --wall "5 mm" --split y')
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 420))
    plotter.add_mesh(pyvista.read("mould-1.ply"), color="lightgrey", smooth_shading=True, split_sharp_edges=True)
    beam = pyvista.read("beam.ply").translate((0, 0, 28))
    plotter.add_mesh(beam, color="steelblue", smooth_shading=True, split_sharp_edges=True)
    plotter.view_vector((0.4, 1, 0.5), viewup=(0, 0, 1))
    return kept(plotter, 1.9)


def fibres() -> str:
    typed("hpcinv new ventricle job.yaml && hpcinv run job.yaml --certificate off --output results/job")
    body = pyvista.read("results/job/fields/deformed.vtu")
    centres = body.cell_centers().glyph(orient="fibre:fibre", scale=False, factor=4e-3, geom=pyvista.Tube(radius=0.05))
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 520))
    half = centres.clip("y", origin=body.center, invert=False)
    plotter.add_mesh(body.extract_surface().clip("y", origin=body.center, invert=False), color="mistyrose", opacity=0.6)
    plotter.add_mesh(half, color="firebrick")
    plotter.view_vector((0, -1, 0.3), viewup=(0, 0, 1))
    return kept(plotter, 1.3)


def new() -> str:
    typed("hpcinv new part part.yaml && hpcinv show part.yaml --output drawn.png")
    return "drawn.png"


def parts() -> str:
    typed("hpcinv mesh partition meshes/box.py box.bp --parts 8 --parameter nx=12 --parameter ny=12 --parameter nz=12")
    source, _ = partitioned(FILES[".bp"](Path("box.bp")), 8)  # a reader of the whole forgets the parts
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 520))
    colours = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb", "#ee8866")
    for first, last, colour in zip(source.parts, source.parts[1:], colours, strict=False):
        cells = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: source.cells[first:last]}, source.points)
        plotter.add_mesh(cells, color=colour, show_edges=True, line_width=0.5)
    return kept(plotter, 0.95)


def shell() -> str:
    typed("hpcinv new shell sheet.yaml && hpcinv run sheet.yaml --certificate quick --output results/sheet")
    typed("hpcinv show results/sheet --output drawn.png")
    return "drawn.png"


def sheet() -> str:
    """By the commands of the tutorial."""
    page = (ROOT / "docs" / "tutorials" / "sheet.md").read_text()
    Path("jobs").unlink()  # a link to the project's
    Path("jobs").mkdir()
    Path("jobs/scan.yaml").write_text(re.findall(r"-->\n```yaml\n(.*?)^```", page, re.M | re.S)[0])
    for block in re.findall(r"^```sh\n(.*?)^```", page, re.M | re.S):
        for line in block.splitlines():
            typed(line)
    return "sheet.png"


def supports() -> str:
    Path("tube.yaml").write_text(SLIDING)
    typed("hpcinv show tube.yaml --output drawn.png")
    return "drawn.png"


def kept(plotter: pyvista.Plotter, zoom: float) -> str:
    plotter.set_background("white")
    plotter.camera.zoom(zoom)
    plotter.screenshot("drawn.png")
    plotter.close()
    return "drawn.png"


PICTURES: dict[str, Callable[[], str]] = {
    "cad": cad,
    "dossier": dossier,
    "export-mould": export,
    "fibres": fibres,
    "new-part": new,
    "parts": parts,
    "sheet": sheet,
    "shell": shell,
    "supports": supports,
}


def main() -> None:
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as directory:
            os.chdir(directory)
            for given in ("jobs", "meshes"):
                Path(given).symlink_to(ROOT / given)
            shrink(Path(PICTURES[name]()), ROOT / "docs" / "pictures" / f"{name}.png", 900, Image.Dither.NONE)
            os.chdir(ROOT)


if __name__ == "__main__":
    main()
