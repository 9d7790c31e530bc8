"""Integrals over a mesh whose nodes move, as integrals over the mesh as it lies.

With the motion ``χ`` of the mesh's points and ``G = I + ∂χ/∂y``, positions become ``y + χ``, gradients ``∇f G⁻¹``,
volumes ``det G dy``, and areas ``|cof(G) n| ds``. This holds for any form, whatever its physics. Derivatives by ``χ``
at 0 are the derivatives by the nodes.

Source: Haslinger & Mäkinen, *Introduction to Shape Optimization*, 2003, ch. 3, doi:10.1137/1.9780898718690.
"""

from __future__ import annotations

from typing import Any

import ufl
from ufl.classes import Grad
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from hpcinv.physics.points.scalar_graph import NotAnalytic


def on_moved_mesh(form: Any, motion: Any) -> Any:
    """Return a form on the mesh whose points are displaced by ``motion``, a vector field on the mesh as it lies.

    Raises:
        NotAnalytic: the form has a geometric quantity that is not known on the moved mesh.
    """
    rules, sizes = _Moved(motion), dict[str, Any]()
    integrals = []
    for integral in form.integrals():
        kind = integral.integral_type()
        if kind not in sizes:
            sizes[kind] = rules.size(kind)
        integrals.append(integral.reconstruct(integrand=map_expr_dag(rules, integral.integrand()) * sizes[kind]))
    return ufl.Form(integrals)


class _Moved(MultiFunction):  # type: ignore[misc]  # UFL has no types
    """Expressions on the moved mesh."""

    expr = MultiFunction.reuse_if_untouched

    def __init__(self, motion: Any) -> None:
        super().__init__()
        self._motion = motion
        self._mesh = ufl.domain.extract_unique_domain(motion)
        self._G = ufl.Identity(3) + ufl.grad(motion)
        self._inverse, self._det = ufl.inv(self._G), ufl.det(self._G)

    def size(self, kind: str) -> Any:
        """Return the volume or area of the moved mesh per volume or area of the mesh."""
        if kind == "cell":
            return self._det
        if kind != "exterior_facet":
            raise NotAnalytic(f"it has integrals over {kind}s")
        vector = self._area_vector(ufl.FacetNormal(self._mesh))
        return ufl.sqrt(ufl.inner(vector, vector))

    def _area_vector(self, normal: Any) -> Any:
        return self._det * ufl.transpose(self._inverse) * normal

    def spatial_coordinate(self, position: Any) -> Any:
        return position + self._motion

    def jacobian(self, jacobian: Any) -> Any:
        return self._G * jacobian

    def jacobian_inverse(self, inverse: Any) -> Any:
        return inverse * self._inverse

    def jacobian_determinant(self, determinant: Any) -> Any:
        return self._det * determinant

    def facet_normal(self, normal: Any) -> Any:
        vector = self._area_vector(normal)
        return vector / ufl.sqrt(ufl.inner(vector, vector))

    def geometric_quantity(self, quantity: Any) -> Any:
        raise NotAnalytic(f"it has '{type(quantity).__name__}', which is not known on a moved mesh")

    def grad(self, _: Any, function: Any) -> Any:
        i = ufl.indices(len(function.ufl_shape))
        j, k = ufl.indices(2)
        return ufl.as_tensor(Grad(function)[(*i, j)] * self._inverse[j, k], (*i, k))
