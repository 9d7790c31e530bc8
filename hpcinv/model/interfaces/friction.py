"""Friction between two surfaces of one mesh: tangential tractions with the functions of the pressure.

At each function ``N_i`` of the first surface the slip of a load step is the tangential mean of the jump of its
displacement, and a traction ``λ_i`` acts, as the pressure does:

    R ← R - Bᵀ λ,      λ = Π(q - ε s),      s = s₀ + P (B̄ (u - u₀) + n₀ n₀·B̄ x₀),

where ``Π`` shortens vectors to the bound ``μ p``, and ``P`` removes the normal part. ``B`` are the jumps where the
surfaces meet at the end of the step, so a load in one step has the equations of an inverse problem, whose given shape
is that end. The slip ``s₀`` that tractions of the step before need (``λ₀ = -ε s₀``) turns with the first surface. So do
its normals ``n₀``: a gap at the beginning of the step turns, which is not slip.

Source: Puso & Laursen (2004), doi:10.1016/j.cma.2004.06.001; Simo & Laursen (1992), doi:10.1016/0045-7949(92)90540-G.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Booleans
from hpcinv.job.interfaces import Interface
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.entries import matrix_of_entries
from hpcinv.model.interfaces.facets import Facets
from hpcinv.model.interfaces.jump import Jump
from hpcinv.model.interfaces.surface_rotations import surface_rotations
from hpcinv.physics.closures.closure import Bound

_SOFTNESS = 2.0**-4
"""Penalty by the pressure's. Raised, Newton's method goes astray where much slides; lowered, more updates are needed,
and load steps before the last one slide later."""
_SOFTER = 2.0**-8
"""Penalty by the pressure's after a solve has failed, about the stiffness of the body along the surface. Above that,
functions that slide to and fro in turn pass the range in which they stick, and Newton's method may go in cycles."""
_STIFFEST, _STIFFER = 1.0, 8.0
"""Penalty by the pressure's up to which slow updates at the full load raise it, and the factor of each time. Functions
that slide little turn their tractions slowly with a low one. Raised, the tangent is worse conditioned."""
_MOST_FAILURES = 3
"""Solves that fail after penalties were raised, before these stay low. Raised, hopeless solves end later."""
_SLOW = 0.5
"""Share of the distance before, above which an update of tractions is slow, and the penalty is raised again. Lowered,
penalties are raised while functions still go to and fro, which needs more updates; raised, updates stay slow."""

_BOUNDS: Mapping[Bound, Callable[[float, Floats], tuple[Floats, Floats]]] = {
    "coulomb": lambda coefficient, pressures: (coefficient * pressures, np.full_like(pressures, coefficient)),
    "rough": lambda _, pressures: (np.where(pressures > 0, np.inf, 0.0), np.zeros_like(pressures)),
    "unbounded": lambda _, pressures: (np.full_like(pressures, np.inf), np.zeros_like(pressures)),
}
"""largest tractions by the coefficient of friction and the pressures, and their derivatives by the pressures"""


@dataclass(frozen=True)
class SlipBegin:
    """A solution with which a load step begins.

    Attributes:
        load: load factor.
        u: owned unknowns (scaled).
        points: places of the nodes of the first surface's facets on this rank; ``None`` of unloaded bodies.
        slips: ``s₀`` (n, 3), scaled, in the planes of the surface there.
        forces: pressures times areas (n,), scaled.
        energy: lost so far, scaled.
        shift: motion (3,) of a rigid obstacle, scaled.
    """

    load: float
    u: Floats
    points: Floats | None
    slips: Floats
    forces: Floats
    energy: float
    shift: Floats


@dataclass(frozen=True)
class Tractions:
    """Tangential tractions of all functions, with the numbers that they are made of.

    Attributes:
        vectors: ``λ``, (n, 3): on the second surface, or against its motion.
        slips: ``s``, (n, 3).
        sliding: whether they are shortened.
        by_slips: ``∂λ/∂(B̄ u)``, (n, 3, 3); by_pressures: ``∂λ/∂p``, (n, 3).
    """

    vectors: Floats
    slips: Floats
    sliding: Booleans
    by_slips: Floats
    by_pressures: Floats


class Friction:
    """Tangential tractions of one interface. Methods are collective, and all ranks have all numbers.

    Args:
        names: sorted global numbers of the functions.
        owned: number of owned unknowns.
        turns: whether tractions turn with the first surface; a rigid obstacle keeps them.

    Attributes:
        q: multipliers (n, 3); softness: penalty by the pressure's.
    """

    def __init__(
        self, bound: Bound, coefficient: float, names: Ints, owned: int, comm: MPI.Intracomm, *, turns: bool = True
    ) -> None:
        self._bound = partial(_BOUNDS[bound], coefficient)
        self._names, self._owned, self._comm = names, owned, comm
        self._turns, self._shift = turns, np.zeros(3)
        self.reset()

    def reset(self) -> None:
        """Begin with the unloaded bodies, without tractions."""
        self.q: Floats = np.zeros((len(self._names), 3))
        self.softness, self._distance = _SOFTNESS, float("inf")
        self._stiffest, self._has_stiffened, self._failures = _STIFFEST, False, 0
        if "_jump" in vars(self):
            self._penalties = self.softness * self._pressure_penalties
        self.begin_unloaded()

    def begin_unloaded(self) -> None:
        """Let the slip begin with the unloaded bodies; tractions stay."""
        count, still = len(self._names), np.zeros(3)
        self._rest = SlipBegin(-1.0, np.zeros(self._owned), None, np.zeros((count, 3)), np.zeros(count), 0.0, still)
        self._begin, self._begins = self._rest, list[SlipBegin]()
        self._restored: Floats | None = None
        self._slips = self._rest.slips
        if "_jump" in vars(self):
            self._carry()

    @property
    def penalties(self) -> Floats:
        """Present penalties (n,), scaled."""
        return self._penalties

    def scale_penalties(self, factor: float) -> None:
        """Take other penalties."""
        self._set_softness(self.softness * factor)

    # Surfaces that move.

    def set_jump(
        self, jump: Jump, penalties: Floats, first: Facets, unloaded: Facets, u: Floats, shift: Floats
    ) -> None:
        """Take the jumps where the surfaces are now, with the pressure's penalties, the first surface, and unknowns.

        Args:
            unloaded: first surface of the unloaded bodies.
            u: owned unknowns.
            shift: motion (3,) of a rigid obstacle, scaled; 0 of surfaces of the mesh.
        """
        self.destroy()
        self._shift = shift
        self._jump, self._pressure_penalties, self._first = jump, penalties, first
        self._penalties = self.softness * penalties
        self._unloaded, self._u = unloaded.points, u.copy()
        self._forces = jump.vector_matrix(self._owned, means=False)
        self._means = jump.vector_matrix(self._owned, means=True)
        self._left: PETSc.Vec = self._means.createVecLeft()
        self._right: PETSc.Vec = self._means.createVecRight()
        if self._restored is not None:
            count = len(self._names)
            slipped = self._restored
            self._rest = SlipBegin(-1.0, u.copy(), first.points, slipped, np.zeros(count), 0.0, shift)
            self._begin, self._begins, self._restored = self._rest, [], None
        self._carry()

    def soften(self) -> bool:
        """Take lower penalties until updates are slow; return whether they were not lower before."""
        before, self._distance = self.softness, float("inf")
        self._failures += self._has_stiffened
        if self._failures == _MOST_FAILURES:
            self._stiffest = _SOFTER
        self._set_softness(_SOFTER)
        self._has_stiffened = False
        return before > _SOFTER

    def soften_updates(self) -> None:
        """Take the penalties of load steps, and no higher ones until the next `reset`."""
        self._stiffest = min(self._stiffest, _SOFTNESS)
        self._set_softness(self.softness_of_steps)

    def after_update(self, distance: float, *, is_same: bool) -> bool:
        """Follow an update by a `distance`; return whether the penalties have changed.

        At the full load, tractions do not depend on them. They are raised only where the same functions stick and slide
        as before.
        """
        is_slow, self._distance = distance > _SLOW * self._distance, distance
        if not (is_slow and is_same) or self.softness >= self._stiffest:
            return False
        self._distance, self._has_stiffened = float("inf"), True
        self._set_softness(min(_STIFFER * self.softness, self._stiffest))
        return True

    @property
    def softness_of_steps(self) -> float:
        """Penalty by the pressure's in load steps before the last one."""
        return min(self.softness, _SOFTNESS)

    def _set_softness(self, softness: float) -> None:
        self.softness = softness
        self._penalties = softness * self._pressure_penalties

    def destroy(self) -> None:
        """Free PETSc objects."""
        for name in ("_forces", "_means", "_left", "_right"):
            if name in vars(self):
                getattr(self, name).destroy()

    def begin(self, load: float) -> None:
        """Let the slip begin with the last solution below a load factor."""
        while self._begins and self._begins[-1].load >= load:
            self._begins.pop()
        self._begin = self._begins[-1] if self._begins else self._rest
        if load < 1.0:
            self._set_softness(self.softness_of_steps)
        self._carry()

    def _carry(self) -> None:
        begin = self._begin
        turned = self._turned(begin.points)
        normals = np.einsum("nba,nb->na", turned, self._jump.normals)
        vectors = self._jump.vectors - self._jumped(self._u)
        gaps = np.einsum("ni,ni->n", normals, vectors)[:, None] * normals
        self._slips = self._tangential(np.einsum("nab,nb->na", turned, begin.slips) + gaps)

    def _turned(self, points: Floats | None) -> Floats:
        """Return the rotations (n, 3, 3) of the first surface from a place, by default the unloaded body's."""
        return self._rotations(self._unloaded if points is None else points, self._first.points)

    def _rotations(self, before: Floats, after: Floats) -> Floats:
        """Return the rotations (n, 3, 3) of the first surface between two places."""
        if not self._turns:
            return np.broadcast_to(np.eye(3), (len(self._names), 3, 3))
        return surface_rotations(self._names, self._first.nodes, before, after, self._comm)

    def _tangential(self, vectors: Floats) -> Floats:
        normals = self._jump.normals
        tangential: Floats = vectors - np.einsum("ni,ni->n", vectors, normals)[:, None] * normals
        return tangential

    def end(self, load: float, u: Floats, points: Floats, pressures: Floats) -> None:
        """Keep a solution; another load step may begin there.

        Args:
            u: owned unknowns; points: places of the nodes of the first surface's facets on this rank.
        """
        found = self.tractions(u, pressures)
        turned = self._rotations(self._first.points, points)
        slips = np.einsum("nab,nb->na", turned, -self._lengths(found.vectors))
        forces = pressures * self._jump.areas
        energy = self.energy(found, pressures)
        self._begins.append(SlipBegin(load, u.copy(), points, slips, forces, energy, self._shift))

    def begin_before(self, load: float) -> SlipBegin | None:
        """Return the last solution up to a load factor, below the full load; ``None`` for the unloaded bodies."""
        found = [begin for begin in self._begins if begin.load <= load and begin.load < 1.0]
        return found[-1] if found else None

    def resume(self, begin: SlipBegin, softness: float) -> None:
        """Let the slip begin with a solution, and with a penalty by the pressure's, of a run before."""
        self._begins, self._begin = [begin], begin
        self._set_softness(softness)
        self._carry()

    def _lengths(self, tractions: Floats) -> Floats:
        """Return tractions (n, 3) over the penalties, 0 without one."""
        penalties = self._penalties[:, None]
        lengths: Floats = np.divide(tractions, penalties, where=penalties > 0, out=np.zeros_like(tractions))
        return lengths

    def distance(self, found: Tractions) -> float:
        """Return the largest difference of tractions from ``q``, as a length."""
        return float(np.linalg.norm(self._lengths(found.vectors - self.q), axis=1).max(initial=0.0))

    def restore(self, q: Floats, slips: Floats) -> None:
        """Take tractions (n, 3), and the slips with which the state that is put next has them, both scaled."""
        self.reset()
        self.q, self._restored = q, slips

    # Tractions.

    def _products(self, u: Floats) -> Floats:
        self._right.array[:] = u
        self._means.mult(self._right, self._left)
        return np.concatenate(self._comm.allgather(np.array(self._left.array))).reshape(-1, 3)

    def _jumped(self, u: Floats) -> Floats:
        """Return the change (n, 3) of the jumps since the step began."""
        return self._products(u - self._begin.u) + (self._shift - self._begin.shift)

    def tractions(self, u: Floats, pressures: Floats) -> Tractions:
        """Return the tractions for owned unknowns and pressures."""
        penalties, normals = self._penalties, self._jump.normals
        slips = self._slips + self._tangential(self._jumped(u))
        trial = self._tangential(self.q) - penalties[:, None] * slips
        bounds, slopes = self._bound(pressures)
        sizes = np.linalg.norm(trial, axis=1)
        sliding = sizes > bounds
        directions = trial / np.where(sizes > 0, sizes, 1.0)[:, None]
        shares = np.where(sliding, np.divide(bounds, sizes, where=sliding, out=np.ones_like(sizes)), 1.0)
        removed = np.einsum("na,nb->nab", normals, normals)
        removed += sliding[:, None, None] * np.einsum("na,nb->nab", directions, directions)
        return Tractions(
            shares[:, None] * trial,
            slips,
            sliding,
            -(penalties * shares)[:, None, None] * (np.eye(3) - removed),
            (sliding * slopes)[:, None] * directions,
        )

    def add_forces(self, tractions: Floats, forces: Floats, share: float = 1.0) -> None:
        """Add the nodal forces of tractions (n, 3), times a share, to forces on the owned unknowns at first."""
        start, end = self._left.getOwnershipRange()
        self._left.array[:] = tractions.ravel()[start:end]
        self._forces.multTranspose(self._left, self._right)
        forces[: self._owned] += share * self._right.array

    def add_products(self, found: Tractions, x: Floats, pressure_rates: Floats, forces: Floats) -> None:
        """Add the stiffness times owned unknowns, along which pressures have these rates, to forces."""
        rates = np.einsum("nab,nb->na", found.by_slips, self._products(x))
        rates += found.by_pressures * pressure_rates[:, None]
        self.add_forces(rates, forces, -1.0)

    def stiffness(self, found: Tractions, pressure_rates: PETSc.Mat, free: PETSc.Vec) -> PETSc.Mat:
        """Return a new matrix: the derivative of the forces, without rows and columns of unknowns that are not free.

        Args:
            pressure_rates: derivative of the pressures by the free unknowns.
        """
        count = len(self._names)
        slips = self._blocks(found.by_slips, 3 * count)
        pressures = self._blocks(found.by_pressures[:, :, None], count)
        rates = slips.matMult(self._means)
        rates.diagonalScale(None, free)
        more = pressures.matMult(pressure_rates)
        different: Any = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN  # its stub has the wrong type
        rates.axpy(1.0, more, different)
        forces = self._forces.copy()
        forces.diagonalScale(None, free)
        product = forces.transposeMatMult(rates)
        product.scale(-1.0)
        for matrix in (slips, pressures, rates, more, forces):
            matrix.destroy()
        return product

    def _blocks(self, blocks: Floats, columns: int) -> PETSc.Mat:
        """Return the matrix with blocks (n, 3, w) on its diagonal, distributed as the functions are."""
        count, height, width = blocks.shape
        sizes = self._left.getLocalSize(), 3 * count
        start, end = self._left.getOwnershipRange()
        own = PETSc.DECIDE if width == 1 else sizes[0]
        rows, places = np.broadcast_arrays(
            np.arange(3 * count).reshape(count, height, 1),
            width * np.arange(count)[:, None, None] + np.arange(width),
        )
        own_rows = (rows >= start) & (rows < end)
        chosen = rows[own_rows], places[own_rows]
        return matrix_of_entries(self._comm, sizes, (own, columns), chosen, blocks[own_rows])

    # Results.

    def energy(self, found: Tractions, pressures: Floats) -> float:
        """Return the energy lost since the unloaded state, scaled: the mean bound in each step times its sliding."""
        begin = self._begin
        elastic = self._lengths(self._tangential(self.q) - found.vectors)
        slid = np.where(found.sliding[:, None], found.slips - elastic, 0.0)
        sizes = np.linalg.norm(found.vectors, axis=1)
        against = -np.einsum("ni,ni->n", slid, found.vectors) / np.where(sizes > 0, sizes, 1.0)
        along = np.where(sizes > 0, against, np.linalg.norm(slid, axis=1))  # surfaces that have opened slid before
        bounds = self._bound((begin.forces + pressures * self._jump.areas) / 2)[0]
        return begin.energy + float((np.where(np.isfinite(bounds), bounds, 0.0) * along).sum())


def frictions_of(
    spec: Interface, sign: int, names: Ints, owned: int, comm: MPI.Intracomm, *, turns: bool
) -> tuple[Friction, ...]:
    """Return the friction of an interface, or nothing without it.

    Args:
        sign: of the kinematics.
        turns: whether tractions turn with the first surface.
    """
    if not spec.friction:
        return ()
    bound: Bound = "coulomb" if sign > 0 or spec.assumed is None else spec.assumed.bound
    return (Friction(bound, spec.friction, names, owned, comm, turns=turns),)
