"""Functions outside of the core, by what a job asks for: imported on demand, since a plain run needs none of them.

The core never imports these packages, and runs without them.
"""

import importlib
from collections.abc import Callable
from typing import Any

from hpcinv.errors import SystemPartMissing

FUNCTIONS = {
    "arc length": "hpcinv.solver.arc_length:ArcLengthSteps",
    "comparison of surfaces": "hpcinv.geometry.workshop.surface_comparison:compare",
    "estimate of errors": "hpcinv.trust.certificate.discretisation_error:estimate",
    "finer problem": "hpcinv.trust.certificate.discretisation_error:finer_problem_of",
    "finer problem of a shell": "hpcinv.trust.certificate.finer_shell:FinerShell",
    "fixed-point method": "hpcinv.solver.methods.fixed_point:FixedPointMethod",
    "mesh of a CAD file": "hpcinv.geometry.cad.cad_mesh:cad_mesh",
    "mesh of a shell": "hpcinv.mesh.midsurface:ShellSource",
    "mesh of a vessel": "hpcinv.geometry.vessels.vessel_mesh:vessel_mesh",
    "mesh of an image": "hpcinv.geometry.imaging.image_mesh:image_mesh",
    "mesh of elements and sets": "hpcinv.formats.readers.elements:read_elements",
    "mesh of surfaces": "hpcinv.geometry.imaging.image_mesh:surface_mesh",
    "motion after failures": "hpcinv.solver.failing_motion:failing_motion",
    "picture of a result": "hpcinv.pages.pictures.result_picture:draw_result",
    "power series": "hpcinv.solver.series_continuation:SeriesSteps",
    "refined mesh": "hpcinv.mesh.refine.refinement:refine",
    "report of a run": "hpcinv.pages.reports.run_page:write_run_report",
    "search for accuracy": "hpcinv.trust.accuracy.search:Search",
    "sensitivities": "hpcinv.trust.sensitivity.analysis:sensitivities",
    "spreads by errors of the surface": "hpcinv.trust.sensitivity.surface_errors:SurfaceSpreads",
    "start from a sweep": "hpcinv.studies.sweep.reduced_basis:predicted_guesses",
    "surface in a file": "hpcinv.geometry.imaging.closed_surface:read_closed",
    "surface in an image": "hpcinv.geometry.imaging.image_surface:image_surface",
    "surface of a shell": "hpcinv.formats.readers.shell_surfaces:read_shell_surface",
}
"""module and function by what they make"""


def variant(made: str, usual: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function that makes something, or the usual one if there is none."""
    return on_demand(made) if made in FUNCTIONS else usual


def on_demand(made: str) -> Callable[..., Any]:
    """Import and return the function that makes something.

    Raises:
        SystemPartMissing: its package is not part of this installation.
    """
    module, _, function = FUNCTIONS[made].partition(":")
    try:
        result: Callable[..., Any] = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        if not (error.name and module.startswith(error.name)):
            raise
        raise SystemPartMissing(
            f"The {made} needs {module}, which this installation lacks.", "Install hpcinv."
        ) from None
    return result
