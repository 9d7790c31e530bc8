"""Near-null space of a tangent for algebraic multigrid: rigid motions of the unknown body and of the mesh.

However large the deformation is, isotropic stress does not change under rotations of the unknown body, so the near-null
space are the rigid motions of that body, not of the mesh. In the inverse problem the tangent is not symmetric, and its
transpose has the rigid motions of the mesh; aggregation uses one basis for both, which spans both.
"""

from typing import cast

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.model.rigid_motions import Frame
from hpcinv.model.weak_form import WeakForm

# Smallest share of a motion that is orthogonal to the others: motions that are nearly the same in each aggregate make
# blocks of coarse levels singular.
_INDEPENDENT = 0.05


def near_null_space(weak_form: WeakForm, mesh: Floats, displacement: Floats) -> PETSc.NullSpace:
    """Return translations, and small rotations of the unknown body and, where they differ, of the mesh; collective.

    Args:
        mesh: positions of the owned nodes, (nodes, 3) in scaled lengths.
        displacement: their displacements, likewise.
    """
    kinematics, frame, comm = weak_form.kinematics, Frame(np.zeros(3), 1.0), weak_form.unknowns.mesh.comm
    motions = frame.motions(mesh + kinematics.sign * displacement)
    if kinematics.direction == "inverse" and comm.allreduce(bool(displacement.any()), op=MPI.LOR):
        motions = np.concatenate([motions, frame.motions(mesh)[:, :, 3:]], axis=2)
    return PETSc.NullSpace().create(vectors=_orthonormal(motions.reshape(-1, motions.shape[2]), comm), comm=comm)


def _orthonormal(columns: Floats, comm: MPI.Intracomm) -> list[PETSc.Vec]:
    """Return orthonormal vectors with the span of the columns, without nearly dependent ones."""
    basis: list[PETSc.Vec] = []
    for column in columns.T:
        vector = PETSc.Vec().createMPI((len(column), None), bsize=3, comm=cast(PETSc.Comm, comm))
        vector.array[:] = column
        length = norm(vector)
        for _ in range(2):  # the second pass removes rounding errors of the first
            for other in basis:
                vector.axpy(-dot(vector, other), other)
        if norm(vector) > _INDEPENDENT * length:
            vector.normalize()
            basis.append(vector)
    return basis
