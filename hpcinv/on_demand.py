"""What few jobs need, by what they ask for: functions and classes that are imported on demand.

Some are outside of the core, which never imports their packages and runs without them. Others are rooms of the core: a
strategy, a method, a kind of body, a way to support or to cut, which a plain run leaves alone. A module that is listed
here is imported by its neighbours only, and a name such as ``mesh of a shell`` ends with the key that asks for it.
"""

import importlib
from collections.abc import Callable
from typing import Any

from hpcinv.errors import SystemPartMissing

FUNCTIONS = {
    "arc length": "hpcinv.solver.arc_length:ArcLengthSteps",
    "arrays of integers": "hpcinv.mesh.label_groups:integer_arrays",
    "cells of a rank in a partitioned mesh": "hpcinv.mesh.distributed.partitioned:cells_of",
    "cells of another degree": "hpcinv.mesh.refine.degree:change_degree",
    "check of cavities": "hpcinv.model.cavities:check_cavities",
    "check of hinges": "hpcinv.solver.hinge_checks:check_hinges",
    "check of rest surfaces": "hpcinv.trust.intervals.rest_surfaces:check_rest_surfaces",
    "comparison of surfaces": "hpcinv.geometry.workshop.surface_comparison:compare",
    "constraints of slides": "hpcinv.model.sliding:MatrixConstraint",
    "contact intervals": "hpcinv.trust.intervals.contact_interval:contact_intervals",
    "contents of a mesh file": "hpcinv.job.mesh_contents:contents_of",
    "diagnosis of a failure": "hpcinv.solver.diagnosis:diagnose",
    "directions of a rule": "hpcinv.model.fibre_directions:rule_directions",
    "doubled nodes": "hpcinv.mesh.label_interfaces:double_nodes",
    "enclosed volume": "hpcinv.model.cavities:enclosed_volume",
    "estimate of errors": "hpcinv.trust.discretisation.discretisation_error:estimate",
    "file of functions": "hpcinv.output.function_files:write_function",
    "file of a partitioned mesh": "hpcinv.mesh.distributed.partitioned:write_partitioned",
    "filled tangent": "hpcinv.model.assembly.csr_tangent:FilledTangent",
    "finer problem": "hpcinv.trust.discretisation.discretisation_error:finer_problem_of",
    "finer problem of a shell": "hpcinv.trust.discretisation.finer_shell:FinerShell",
    "fixed-point method": "hpcinv.solver.methods.fixed_point:FixedPointMethod",
    "function of a file": "hpcinv.output.function_files:read_function",
    "geometry of a CAD surface": "hpcinv.mesh.refine.finer_geometry:surface_geometry",
    "geometry of a mesh file": "hpcinv.mesh.refine.finer_geometry:file_geometry",
    "contact of least energy": "hpcinv.trust.intervals.least_energy:solve_least_energy",
    "interfaces": "hpcinv.model.interfaces.pair:pairs_of",
    "kernel in NumPy": "hpcinv.physics.points.array_interpreter:ArrayKernel",
    "limit of friction": "hpcinv.solver.friction_limit:friction_limit",
    "lowest eigenvalue": "hpcinv.trust.stability.lowest_eigenvalue:lowest_eigenvalue",
    "mesh of a CAD file": "hpcinv.geometry.cad.cad_mesh:cad_mesh",
    "mesh of a shell": "hpcinv.mesh.midsurface:ShellSource",
    "mesh of a vessel": "hpcinv.geometry.vessels.vessel_mesh:vessel_mesh",
    "mesh of an image": "hpcinv.geometry.imaging.image_mesh:image_mesh",
    "mesh of elements and sets": "hpcinv.formats.readers.elements:read_elements",
    "mesh of surfaces": "hpcinv.geometry.imaging.image_mesh:surface_mesh",
    "motion after failures": "hpcinv.solver.failing_motion:failing_motion",
    "multigrid": "hpcinv.solver.linear.iterative:Iterative",
    "multigrid for the certificate": "hpcinv.trust.stability.multigrid_solver:MultigridSolver",
    "nested iteration": "hpcinv.solver.methods.nested_iteration:solve_nested",
    "nodes of cells of 20 nodes": "hpcinv.mesh.refine.degree:serendipity",
    "nodes on a CAD surface": "hpcinv.mesh.io.cad_surface:cad_surface",
    "partitioned mesh": "hpcinv.mesh.distributed.partitioned:read_partitioned",
    "picture of a result": "hpcinv.pages.pictures.result_picture:draw_result",
    "notes on rules of fibres": "hpcinv.model.fibre_directions:notes_on_rules",
    "pins of free parts": "hpcinv.solver.free_parts:pins_of",
    "power series": "hpcinv.solver.series_continuation:SeriesSteps",
    "products with derivatives": "hpcinv.trust.sensitivity.adjoint:vjp",
    "products with directions": "hpcinv.trust.sensitivity.forward_products:jvp",
    "programs of a form": "hpcinv.physics.points.form_programs:programs_of",
    "quadrilaterals of surfaces": "hpcinv.mesh.quadrilaterals:quadrilaterals",
    "refined factors": "hpcinv.solver.linear.refined:Refined",
    "refined mesh": "hpcinv.mesh.refine.refinement:refine",
    "region of a remote load": "hpcinv.model.remote_loads:RemoteFace",
    "regions in other files": "hpcinv.mesh.face_files:add_face_files",
    "regions of an array": "hpcinv.mesh.label_groups:add_label_groups",
    "report of a run": "hpcinv.pages.reports.run_page:write_run_report",
    "response to gaps": "hpcinv.trust.intervals.gap_response:gap_response",
    "distance without tractions": "hpcinv.trust.intervals.gap_response:unpressed_distance",
    "rigid motion": "hpcinv.physics.kinematics.rigid_motion:RigidMotion",
    "rigid obstacle": "hpcinv.model.obstacle_contact:ObstacleContact",
    "search for accuracy": "hpcinv.trust.accuracy.search:Search",
    "settled contacts": "hpcinv.trust.sensitivity.settled_contacts:SettledContacts",
    "second opinion": "hpcinv.studies.second_opinion.opinion:opinion_line",
    "sensitivities": "hpcinv.trust.sensitivity.analysis:sensitivities",
    "shear of one layer": "hpcinv.physics.kinematics.transverse_shear:corrected_for_shear",
    "slide of a support": "hpcinv.model.sliding:slide_of",
    "slides": "hpcinv.model.sliding:Sliding",
    "smooth face": "hpcinv.mesh.smooth_faces:smooth_face",
    "spreads by errors of the surface": "hpcinv.trust.sensitivity.surface_errors:SurfaceSpreads",
    "stability with cavities": "hpcinv.trust.stability.cavity_stability:unstable_with_cavities",
    "start from a sweep": "hpcinv.studies.sweep.reduced_basis:predicted_guesses",
    "start shape": "hpcinv.mesh.start_shape:start_nodes",
    "surface in a file": "hpcinv.geometry.imaging.closed_surface:read_closed",
    "surface in an image": "hpcinv.geometry.imaging.image_surface:image_surface",
    "surface of an obstacle": "hpcinv.model.obstacle_surface:ObstacleSurface",
    "surface of a shell": "hpcinv.formats.readers.shell_surfaces:read_shell_surface",
    "symbolic analysis": "hpcinv.solver.linear.symbolic_analysis:operations_of",
    "tangent with interfaces": "hpcinv.model.assembly.paired_tangent:PairedTangent",
    "unknowns of directors": "hpcinv.model.assembly.director_unknowns:DirectorUnknowns",
    "vertices at points": "hpcinv.mesh.vertex_sets:vertices_at",
    "voxels of an image": "hpcinv.base.reading.image_headers:source_of",
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
