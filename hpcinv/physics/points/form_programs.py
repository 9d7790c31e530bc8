"""Programs of forms and expressions, made where the cache does not have them yet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx.fem import IntegralType
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.classes import CoefficientDerivative, Jacobian

from hpcinv.physics.points import point_scalars
from hpcinv.physics.points.integrands import Integrand, Sources
from hpcinv.physics.points.program_files import Integral, Programs
from hpcinv.physics.points.scalar_graph import NotAnalytic
from hpcinv.physics.points.tables import Tables, cell_rule, facet_rule, on_facets

_TYPES = tuple(IntegralType.__members__)


def programs_of(item: Any) -> Programs:
    """Return the programs of a form, or of an expression and points (n, 3) in a cell or (n, 2) on a facet.

    Raises:
        NotAnalytic: it has what programs do not have.
    """
    return _form_programs(item) if isinstance(item, ufl.Form) else _expression_programs(*item)


def _form_programs(form: Any) -> Programs:
    (mesh,) = form.ufl_domains()
    if not point_scalars.is_supported(mesh):
        raise NotAnalytic("its mesh is not one of solids")
    kind, rank = mesh.ufl_coordinate_element().cell_type.name, len(form.arguments())
    sources = Sources(form.coefficients(), form.constants())
    domains = []
    for (type_number, number), rules in sorted(_by_domain(form).items()):
        is_cell = _TYPES[type_number] == "cell"
        programs, functions = [], set[Any]()
        for metadata, integrands in rules.values():
            for integrand in _joined(integrands):
                tables = Tables(*(cell_rule if is_cell else facet_rule)(kind, metadata))
                maker = Integrand(mesh, tables, sources)
                programs.append(maker.form(integrand, "volume" if is_cell else "area", rank))
                functions |= maker.functions
        cell = basix.CellType[kind]
        domain = cell if is_cell else basix.cell.subentity_types(cell)[2][0]
        domains.append((_TYPES[type_number], number, int(domain), functions, tuple(programs)))
    integrals = []
    for name, number, cell_number, taken, made in domains:
        used = {sources.number(f) for f in taken}
        enabled = tuple(i in used for i in range(len(sources.used)))
        integrals.append(Integral(name, number, cell_number, enabled, made))
    return Programs(sources.used, integrals)


def _by_domain(form: Any) -> dict[tuple[int, int], dict[str, tuple[Any, list[Any]]]]:
    """Return metadata and integrands by quadrature rule, by type and region of the integral; -1 is everywhere."""
    found: dict[tuple[int, int], dict[str, tuple[Any, list[Any]]]] = {}
    for integral in _with_degrees(form.integrals()):
        if integral.integral_type() not in ("cell", "exterior_facet"):
            raise NotAnalytic(f"it has integrals over {integral.integral_type()}s")
        regions = integral.subdomain_id()
        for region in regions if isinstance(regions, tuple) else (regions,):
            place = _TYPES.index(integral.integral_type()), -1 if isinstance(region, str) else int(region)
            rules = found.setdefault(place, {})
            rules.setdefault(repr(integral.metadata()), (integral.metadata(), []))[1].append(integral.integrand())
    return found


def _with_degrees(integrals: Sequence[Any]) -> list[Any]:
    """Return the integrals; those without a quadrature degree get the one that UFL estimates, as FFCx does."""
    given = [
        i for i in integrals if i.metadata().get("quadrature_degree", -1) != -1 or "quadrature_rule" in i.metadata()
    ]
    others = [i for i in integrals if i not in given]
    if not others:
        return given
    data = ufl.algorithms.compute_form_data(
        ufl.Form(others),
        do_apply_function_pullbacks=True,
        do_apply_integral_scaling=True,
        do_apply_geometry_lowering=True,
        preserve_geometry_types=(Jacobian,),
        do_append_everywhere_integrals=False,
    )
    parts = [part for group in data.integral_data for part in group.integrals]
    degree = max(int(np.max(part.metadata()["estimated_polynomial_degree"])) for part in parts)
    return [*given, *(i.reconstruct(metadata=i.metadata() | {"quadrature_degree": degree}) for i in others)]


def _joined(integrands: Sequence[Any]) -> list[Any]:
    """Return integrands of which those that are not derivatives are one sum."""
    derivatives = [i for i in integrands if isinstance(i, CoefficientDerivative)]
    others = [i for i in integrands if not isinstance(i, CoefficientDerivative)]
    return [*derivatives, *([sum(others[1:], others[0])] if others else [])]


def _expression_programs(expression: Any, points: npt.NDArray[np.float64]) -> Programs:
    domains = ufl.domain.extract_domains(expression)
    if len(domains) != 1 or not point_scalars.is_supported(domains[0]):
        raise NotAnalytic("its mesh is not one of solids")
    sources = Sources(extract_coefficients(expression), extract_constants(expression))
    if points.shape[1] == 3:
        tables = Tables(points)
    else:
        places, normals = on_facets(domains[0].ufl_coordinate_element().cell_type.name, points)
        tables = Tables(places, normals=normals)
    program = Integrand(domains[0], tables, sources).expression(expression)
    return Programs.of_expression(program, sources.used)
