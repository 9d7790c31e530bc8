"""A state of ParaView as a Python script, which draws both bodies of a run: ParaView's "Load State", or ``pvpython``.

The functions that it calls are the same from ParaView 5.10 on (``paraview.simple``); a state file in XML is written for
one version.
"""

from __future__ import annotations

from pathlib import Path

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.names import check_directory_of
from hpcinv.errors import OutputError
from hpcinv.output.run_directory import RunDirectory
from hpcinv.version import __version__

VIEWS = (("POINTS", "displacement", "Magnitude", "m"), ("CELLS", "von_mises", "", "Pa"))
"""array, component and unit by which the bodies of a view are coloured"""

_SCRIPT = """\
# State of ParaView, written by hpcinv {version}: File, Load State; or pvpython.
# The bodies of a run, coloured by {names}. The undeformed one is transparent.
from paraview import simple

FIELDS = {fields!r}
VIEWS = {views!r}

simple._DisableFirstRenderCameraReset()
bodies = [
    simple.PVDReader(registrationName=name, FileName=f"{{FIELDS}}/{{name}}.pvd") for name in ("undeformed", "deformed")
]
layout = simple.CreateLayout("bodies")
views = [simple.CreateView("RenderView") for _ in VIEWS]
layout.SplitHorizontal(0, 0.5)
for place, (view, (association, array, component, unit)) in enumerate(zip(views, VIEWS), start=1):
    simple.AssignViewToLayout(view=view, layout=layout, hint=place)
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    for body, opacity in zip(bodies, (0.3, 1.0)):
        shown = simple.Show(body, view)
        shown.Representation = "Surface"
        shown.NonlinearSubdivisionLevel = 2
        shown.Opacity = opacity
        simple.ColorBy(shown, (association, array, component) if component else (association, array))
        shown.RescaleTransferFunctionToDataRange(body is not bodies[0], False)
    shown.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(simple.GetColorTransferFunction(array), view)
    bar.Title, bar.ComponentTitle = f"{{array}} [{{unit}}]", ""
    bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
    bar.WindowLocation = "Upper Right Corner"
    view.CameraFocalPoint, view.CameraPosition, view.CameraViewUp = [0, 0, 0], [1, -3, 1], [0, 0, 1]
    simple.ResetCamera(view)
for number, view in enumerate(views[1:], start=1):
    simple.AddCameraLink(views[0], view, f"bodies {{number}}")
simple.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
simple.RenderAllViews()
"""


def write_paraview_state(path: Path, run: Path) -> None:
    """Write the script, which names the directory of the run's fields by its whole path.

    Raises:
        OutputError: there is no run, its job left out the fields, or the script cannot be written.
    """
    if not run.is_dir():
        raise OutputError(f"{run}: no such directory", "Give the directory that 'run' printed at its beginning.")
    check_directory_of(path)
    fields = RunDirectory(run).path.resolve() / "fields"
    if missing := [name for name in ("undeformed.pvd", "deformed.pvd") if not (fields / name).is_file()]:
        advice = "Run the job to its end, without 'output: {fields: false}'."
        raise OutputError(f"{run}: has no fields/{missing[0]}, which ParaView opens", advice)
    names = " and ".join(array for _, array, _, _ in VIEWS)
    script = _SCRIPT.format(version=__version__, fields=str(fields), views=VIEWS, names=names)
    write_output(path, script.encode(), "Is the directory writable, and space left?")
