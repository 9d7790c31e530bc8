"""Contact pressures that a job gives on the given shape."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from hpcinv.base.quantity.spatial_fields import ByData, ByFormula, Field
from hpcinv.errors import MeshError
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.fields import BodyFields, formula_values
from hpcinv.model.interfaces.nodal_functions import NodalFunctions


def given_pressures(value: float | Field, where: str, body: Body, functions: NodalFunctions, places: Floats) -> Floats:
    """Return the pressures (Pa) of a key of the job at all vertices of an interface; collective.

    Args:
        where: place in the job.
        functions: functions with the numbers at the vertices.
        places: vertices (n, 3) in the given mesh (m).

    Raises:
        MeshError: on all ranks, if the mesh has no such array at its nodes, or a pressure is not a number from 0 on.
    """
    match value:
        case ByFormula():
            pressures = formula_values(value, places)
        case ByData():
            pressures = functions.values(_at_vertices(value, where, body))
        case number:
            pressures = np.full(len(places), float(number))  # type: ignore[arg-type]
    wrong = ~(pressures >= 0)
    if wrong.any():
        first = int(wrong.argmax())
        place = ", ".join(f"{c:.4g}" for c in places[first])
        raise MeshError(
            f"{where}: is {pressures[first]:.4g} Pa at ({place}) m of the given mesh",
            "Bodies in contact do not pull: give a pressure that is 0 or more on the whole surface.",
        )
    return np.asarray(pressures, dtype=np.float64)


def _at_vertices(value: ByData, where: str, body: Body) -> fem.Function:
    """Return an array of the mesh as function that is linear between vertices."""
    given = BodyFields(body).function(value, 1.0, where)
    if given.function_space.element.basix_element.discontinuous:
        raise MeshError(f"{where}: the array '{value.array}' is of cells", "Give an array at the nodes of the mesh.")
    linear = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1)))
    linear.interpolate(given)
    return linear
