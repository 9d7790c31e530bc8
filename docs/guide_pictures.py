"""Pictures at the head of guides: ``python3 -m uv run python docs/guide_pictures.py [NAME…]``, by the guides' commands.

Each function runs in a directory of its own with ``jobs`` and ``meshes``, and returns the drawn picture. It is kept in
``docs/pictures``, at most 900 pixels wide. The dossier needs Chromium, and other programs their own.
"""

from __future__ import annotations

import json
import os
import re
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from urllib.error import URLError
from urllib.request import Request, urlopen

import gmsh
import numpy as np
import pyvista
import yaml
from gallery_pictures import ROOT, shrink
from matplotlib.figure import Figure
from PIL import Image
from stress_plots import curves

from hpcinv.mesh.distributed.partition import partitioned
from hpcinv.mesh.readers import FILES
from hpcinv.physics.materials import laws

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


VESSEL = """\
mesh: {lumen: vessel.csv, unit: mm, wall: 1.5 mm, size: 5 mm, ends: open}
material: {law: neo-hookean, young: 500 kPa, poisson: 0.45}
effects: [{effect: pressure, region: inner, pressure: 100 mmHg}]
supports: [{region: end-1, fix: [x, y, z]}]
"""
ARCH = """\
x, y, z, radius, branch
0, 0, 0, 12, trunk
0, 0, 60, 12, trunk
0, 0, 60, 8, left
-14, 0, 80, 7, left
-18, 0, 110, 7, left
0, 0, 60, 8, right
14, 0, 80, 6, right
26, 0, 105, 6, right
"""


def typed(line: str, *, code: int = 0) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path}
    done = subprocess.run(line, shell=True, check=False, env=environment, stdout=subprocess.DEVNULL)
    assert done.returncode == code, line


def block(page: str, language: str) -> str:
    """Return the first code box of a guide in a language."""
    text = (ROOT / "docs" / "how-to" / f"{page}.md").read_text()
    found = re.search(rf"^```{language}\n(.*?)^```", text, re.M | re.S)
    assert found
    return found[1]


def figure(width: float = 6, height: float = 3.2) -> Figure:
    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def saved(drawing: Figure) -> str:
    drawing.savefig("drawn.png")
    return "drawn.png"


def boxes(*rows: list[str]) -> str:
    """Draw rows of boxes with arrows from each to the next; texts that begin with "refused" are red."""
    drawing = figure(8, 1.3 * len(rows))
    axes = drawing.subplots()
    axes.set_axis_off()
    axes.set(xlim=(-0.6, max(map(len, rows)) - 0.4), ylim=(0.5 - len(rows), 0.5))
    for y, row in enumerate(rows):
        for x, text in enumerate(row):
            colour = "#fbe3e4" if text.startswith("refused") else "#e6f0f8"
            style = {"boxstyle": "round,pad=0.5", "facecolor": colour, "edgecolor": "#888888"}
            axes.text(x, -y, text, ha="center", va="center", fontsize=9, bbox=style)
            if x:
                axes.annotate("", (x - 0.42, -y), (x - 0.58, -y), arrowprops={"arrowstyle": "->", "color": "#555555"})
    return saved(drawing)


def card() -> str:
    typed("hpcinv fit jobs/treloar/uniaxial.csv --law yeoh --largest-stretch 4 --plot drawn.png --output fit.json")
    return "drawn.png"


def compare() -> str:
    typed("hpcinv run jobs/pdms-beam.yaml --certificate off --output results/beam")
    straight = pyvista.Cylinder(center=(91, 0, 0), direction=(1, 0, 0), radius=4.25, height=182, resolution=200)
    straight.triangulate().save("straight.stl")
    typed("hpcinv compare results/beam straight.stl --unit mm --to distance.vtp")
    surface = pyvista.read("distance.vtp")
    surface["distance in µm"] = 1e6 * surface["distance"]
    plotter = pyvista.Plotter(off_screen=True, window_size=(900, 380))
    plotter.add_mesh(surface, scalars="distance in µm", cmap="coolwarm", scalar_bar_args={"color": "black"})
    plotter.view_vector((0.3, 0.3, 1), viewup=(0, 1, 0))
    return kept(plotter, 1.9)


def extend() -> str:
    Path("own.py").write_text(block("extend", "python"))
    kind = runpy.run_path("own.py")["Biderman"]
    drawing = figure()
    axes = drawing.subplots()
    stretches = np.linspace(1.0, 1.8, 61)
    for test, stress in curves(kind.model_validate(kind.example), stretches).items():
        axes.plot(stretches, stress / 1e3, label=test)
    axes.set(xlabel="stretch", ylabel="nominal stress of biderman in kPa", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    return saved(drawing)


BODIES = """\
import os
import FreeCAD, FreeCADGui
from feminout import importInpMesh

document = FreeCAD.newDocument("bodies")
for name, mode in (("rest", "Faces & Wireframe"), ("Mesh", "Wireframe")):
    importInpMesh.insert(os.path.join(os.getcwd(), f"{name}.inp"), "bodies")
    document.Objects[-1].ViewObject.ShapeColor = (0.3, 0.6, 0.9)
    document.Objects[-1].ViewObject.DisplayMode = mode
view = FreeCADGui.ActiveDocument.ActiveView
view.setAnimationEnabled(False)
view.viewFront()
FreeCADGui.SendMsgToActiveView("ViewFit")
FreeCADGui.updateGui()
view.saveImage(os.path.join(os.getcwd(), "drawn.png"), 1300, 560, "White")
os._exit(0)
"""


def freecad() -> str:
    """Needs FreeCAD and a display, which xvfb-run has; root draws its start page in no sandbox."""
    Path("part_in_freecad.py").write_text(block("freecad", "python"))
    typed("freecadcmd part_in_freecad.py < /dev/null")
    typed("hpcinv new job --from Mesh.inp --unit mm --stress-unit MPa part.yaml")
    typed("sed -i 's/^analysis: forward/analysis: inverse/' part.yaml")
    typed("hpcinv run part.yaml --certificate off")
    typed("hpcinv export results/part --to rest.inp --copy-of Mesh.inp")
    Path("bodies.py").write_text(BODIES)
    typed("QTWEBENGINE_DISABLE_SANDBOX=1 xvfb-run -a -s '-screen 0 1400x900x24' freecad bodies.py")
    return "drawn.png"


def hard() -> str:
    typed("hpcinv run jobs/hard/sagging-slender-beam.yaml --certificate off --output results/beam")
    typed("hpcinv show results/beam --output drawn.png")
    return "drawn.png"


def interruption() -> str:
    job = yaml.safe_load(Path("jobs/pdms-beam.yaml").read_text())
    job["mesh"]["file"] = str(ROOT / "jobs" / job["mesh"]["file"])
    job |= {"solver": {"strategy": "fixed", "steps": 12}, "quantities": [], "expected_shape": None}
    Path("beam.yaml").write_text(yaml.safe_dump(job))
    log = Path("results/beam/run.log")
    program = [sys.executable, "-m", "hpcinv", "run", "beam.yaml", "--certificate", "off", "--output", "results/beam"]
    with subprocess.Popen(program, stdout=subprocess.DEVNULL) as run:
        while not log.exists() or "load 0.4167" not in log.read_text():
            time.sleep(0.1)
        run.send_signal(signal.SIGUSR1)
    time.sleep(8)
    typed("hpcinv resume results/beam")
    found = re.findall(r"^(.{19}) +load ([\d.]+): ", Path("results/beam/run.log").read_text(), re.M)
    clock = [datetime.fromisoformat(at).timestamp() for at, _ in found]
    drawing = figure()
    axes = drawing.subplots()
    axes.step([at - clock[0] for at in clock], [float(load) for _, load in found], "o-", where="post")
    axes.set(xlabel="seconds", ylabel="load factor of saved states", ylim=(0, 1.05))
    axes.grid(alpha=0.3)
    return saved(drawing)


def chosen() -> str:
    names = ("neo-hookean", "mooney-rivlin", "yeoh", "gent", "fung-demiray", "veronda-westmann")
    drawing = figure()
    axes = drawing.subplots()
    stretches = np.linspace(1.0, 1.8, 161)
    for name in names:
        stress = curves(laws()[name].model_validate(laws()[name].example), stretches)["uniaxial"]
        axes.plot(stretches, stress / stress[1] * (stretches[1] - 1), label=name)
    axes.set(xlabel="stretch", ylabel="nominal stress / Young's modulus", ylim=(0, 2))
    axes.grid(alpha=0.3)
    axes.legend()
    return saved(drawing)


def meshes() -> str:
    gmsh.initialize()
    block_tag = gmsh.model.occ.addBox(0, 0, 0, 60, 30, 20)
    hole = gmsh.model.occ.addCylinder(40, 15, -1, 0, 0, 22, 8)
    (_, body), *_ = gmsh.model.occ.cut([(3, block_tag)], [(3, hole)])[0]
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [body], name="part")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 5)
    gmsh.model.mesh.generate(3)
    gmsh.write("part.inp")
    gmsh.finalize()
    typed("hpcinv mesh show part.inp --unit mm --output drawn.png")
    return "drawn.png"


def paraview() -> str:
    """Needs ParaView and a display, which xvfb-run has."""
    typed("hpcinv run jobs/pdms-beam.yaml --certificate off --output results/beam")
    typed("hpcinv export results/beam --to beam.py")
    script = (
        "exec(open('beam.py').read())\n"
        "simple.SaveScreenshot('drawn.png', layout, ImageResolution=[1400, 560], SeparatorWidth=0)\n"
    )
    Path("drawn.py").write_text(script)
    typed("xvfb-run -a pvpython drawn.py")
    return "drawn.png"


def security() -> str:
    return boxes(
        ["download/job.yaml", "meshes and images, formulas,\nnumbers with units", "read"],
        ["download/job.yaml", "plugins, generators (.py, .geo),\nlibraries of PETSc", "refused with --untrusted"],
    )


def serve() -> str:
    Path("block.yaml").write_text(block("serve", "yaml"))
    program = [sys.executable, "-m", "hpcinv", "serve", "block.yaml", "--port", "4247"]
    moduli = np.linspace(14e3, 30e3, 9)
    with subprocess.Popen(program, stdout=subprocess.DEVNULL) as server:
        heights = [evaluated(modulus) for modulus in moduli]
        server.terminate()
    drawing = figure()
    axes = drawing.subplots()
    axes.plot(moduli / 1e3, heights, "o-")
    axes.set(xlabel="material.mu in kPa", ylabel="height in m, by the server")
    axes.grid(alpha=0.3)
    return saved(drawing)


def evaluated(modulus: float) -> float:
    """Return the first output of the server, when it is there."""
    data = json.dumps({"name": "block", "input": [[modulus, 1000.0]], "config": {}}).encode()
    for _ in range(600):
        try:
            with urlopen(
                Request("http://127.0.0.1:4247/Evaluate", data, {"Content-Type": "application/json"})
            ) as answer:
                return float(json.load(answer)["output"][0][0])
        except URLError:
            time.sleep(0.2)
    raise SystemExit("the server does not answer")


def slurm() -> str:
    return boxes(
        [
            "sbatch slurm/job.sbatch\njob.yaml",
            "runs, and saves\nat each load step",
            "before the time limit:\nsaves, is requeued",
        ],
        ["the scheduler\nstarts it again", "resumes at the\nlast load step", "summary.json,\nfields, shape"],
    )


def start_up() -> str:
    drawing = figure(6, 2)
    axes = drawing.subplots()
    for row, run in enumerate(("first", "second")):
        typed(f"HPCINV_KERNELS=kernels hpcinv run jobs/thick-sphere.yaml --certificate off --output results/{run}")
        phases = json.loads(Path(f"results/{run}/summary.json").read_text())["timings"]["phases"]
        seconds = {"compile": 0.0, "mesh": 0.0, "the solve and the rest": 0.0}
        for phase, times in phases.items():
            seconds[phase if phase in seconds else "the solve and the rest"] += times["max"]
        left = 0.0
        for (phase, length), colour in zip(seconds.items(), ("#ee6677", "#ccbb44", "#4477aa"), strict=True):
            axes.barh(f"{run} run", length, left=left, color=colour, label=phase if row == 0 else None)
            left += length
    axes.invert_yaxis()
    axes.set(xlabel="seconds")
    axes.legend()
    return saved(drawing)


def vessel() -> str:
    Path("vessel.csv").write_text(ARCH)
    Path("vessel.yaml").write_text(VESSEL)
    typed("hpcinv show vessel.yaml --output drawn.png")
    return "drawn.png"


def failed() -> str:
    typed("hpcinv run jobs/hard/sphere-beyond-its-limit.yaml --output results/sphere 2> said.txt", code=3)
    typed("hpcinv show results/sphere --output drawn.png")
    return "drawn.png"


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
    "card": card,
    "chosen-laws": chosen,
    "compare": compare,
    "dossier": dossier,
    "export-mould": export,
    "failed": failed,
    "fibres": fibres,
    "freecad": freecad,
    "hard-case": hard,
    "interruption": interruption,
    "mesh-file": meshes,
    "new-part": new,
    "own-law": extend,
    "paraview": paraview,
    "parts": parts,
    "security": security,
    "serve": serve,
    "sheet": sheet,
    "shell": shell,
    "slurm": slurm,
    "start-up": start_up,
    "supports": supports,
    "vessel": vessel,
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
