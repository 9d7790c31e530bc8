"""The displacement that loads and inelastic strains would cause if nothing held or balanced them.

A body that is held all round and heated keeps its shape, as does one whose prestrain balances its traction. The
displacement is then zero but for rounding errors, which are in proportion to what cancels: each load and each inelastic
strain by itself. That is the scale by which they are recognized.
"""

from collections.abc import Sequence
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import quadrature
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.spaces import Unknowns
from hpcinv.physics.kinematics.staged_derivatives import gradient

LARGEST_STRAIN = 1.0
"""Largest nominal strain. With a larger one, small displacements under large loads would count as rounding errors."""


class NominalDisplacement:
    """Nominal displacement and force in the present state, at the present load factor; collective.

    The nominal strain ``ε`` is the sum over all effects of ``|F_g - I|`` and ``|P|/μ``, means over the body, and of
    ``Σ|f|/(μ L²)`` with the forces f of each load at the nodes. The size of the body is ``L = V^(1/3)`` with the volume
    V of its mesh. The nominal displacement is ``L min(ε, 1)``, the nominal force ``ε μ L²``, both scaled. Neither
    depends on the units or the axes.

    Args:
        strains: inelastic strains on the reference body, (3, 3).
        potentials: potentials of effects.
        works: virtual works of effects.
        by: the displacement gradient on which the potentials depend.
        shear_moduli: shear modulus and cells of each part of the body.
    """

    def __init__(
        self,
        strains: Sequence[Any],
        potentials: Sequence[Any],
        works: Sequence[Any],
        variable: Any,
        shear_moduli: Sequence[tuple[Any, Any]],
        unknowns: Unknowns,
        quadrature_degree: int,
    ) -> None:
        self._unknowns, mesh = unknowns, unknowns.mesh
        _, self._weights = quadrature(mesh.basix_cell().name, quadrature_degree)
        volume = abs(ufl.JacobianDeterminant(mesh))
        stresses = [gradient(potential, variable) for potential in potentials]
        self._parts = []
        for mu, cells in shear_moduli:
            strain: Any = sum(map(_size, strains), ufl.as_ufl(0.0)) + sum(map(_size, stresses), ufl.as_ufl(0.0)) / mu
            vector = volume * ufl.as_vector([strain, mu, 1.0])
            self._parts.append(QuadratureValues(vector, mesh, quadrature_degree, cells))
        self._works = [fem.form(work) for work in works]

    def __call__(self) -> tuple[float, float]:
        """Return displacement and force."""
        comm, sums = self._unknowns.mesh.comm, np.zeros(3)
        for part in self._parts:
            for _, values in part:
                sums += np.einsum("q,cqi->i", self._weights, values)
        comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        strain, mu, volume = sums[0] / sums[2], sums[1] / sums[2], sums[2]
        size = float(np.cbrt(volume))
        forces = float(comm.allreduce(sum(map(self._total, self._works)), op=MPI.SUM))
        strain += forces / (mu * size**2)
        return size * min(float(strain), LARGEST_STRAIN), float(strain * mu * size**2)

    def _total(self, form: fem.Form) -> float:
        """Return the sum of the sizes of the forces at the nodes that this rank owns."""
        forces = fem_petsc.assemble_vector(form)
        forces.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        nodal_forces = forces.array[self._unknowns.owned_displacement_dofs].reshape(-1, 3)
        total = float(np.linalg.norm(nodal_forces, axis=1).sum())
        forces.destroy()
        return total


def _size(tensor: Any) -> Any:
    return ufl.sqrt(ufl.inner(tensor, tensor))
