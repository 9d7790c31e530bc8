"""Kinds of interfaces: how the gap is measured, and the traction by a trial value ``q - ε g``.

=======  ====================================  =====================================
kind     gap                                   law
=======  ====================================  =====================================
tied     jump of the displacement, 3 numbers   λ
sliding  distance less the given mesh's        p, which may pull
contact  distance                              max(0, p), rounded near 0
=======  ====================================  =====================================

Distances are along mean normals of the first surface: of the loaded bodies in forward problems. In inverse problems
gaps are the unloaded bodies'; the pressure of ``contact`` is given, or found by the gap that a closure assumes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpcinv.job.interfaces import Interface
from hpcinv.mesh.source import Floats


@dataclass(frozen=True)
class Law:
    """What distinguishes a kind.

    Attributes:
        has_vectors: whether gaps and tractions are vectors, else numbers along normals.
        pulls: whether the surfaces cannot part.
        is_renewed: whether surfaces move on each other, so that jumps change.
        reach: distance of surfaces, in radii of their largest facet, up to which they belong together. Raised,
            bilateral kinds join bodies that are apart; lowered, curved surfaces with different meshes are refused.
        penalty: in shear moduli over the length of a facet; raised, fewer updates are needed, the tangent is worse
            conditioned, and nodes go in and out of contact.
        settled: gap in lengths of the body, and error of forces relative to the largest; updates end below both.
            Lowered, rounding errors prevent an end.
    """

    has_vectors: bool
    pulls: bool
    is_renewed: bool
    reach: float
    penalty: float
    settled: tuple[float, float]

    def __call__(self, trial: Floats, width: Floats) -> tuple[Floats, Floats]:
        """Return tractions and their derivatives by the trial values, rounded where these are within ``±width``."""
        if self.pulls:
            return trial, np.ones_like(trial)
        share = np.clip((trial + width) / np.where(width > 0, 2 * width, 1.0), 0.0, 1.0)
        is_rounded = np.abs(trial) < width
        value = np.where(is_rounded, width * share**2, np.maximum(trial, 0.0))
        return value, np.where(is_rounded, share, (trial > 0).astype(np.float64))


LAWS: Mapping[str, Law] = {
    "tied": Law(True, True, False, 0.25, 2.0**12, (2.0**-42, np.inf)),
    "sliding": Law(False, True, True, 0.25, 2.0**12, (2.0**-42, 2.0**-38)),
    "contact": Law(False, False, True, np.inf, 2.0**8, (2.0**-38, 2.0**-34)),
}


def assumption(spec: Interface, sign: int) -> str:
    """Return what determines the tractions of an interface, in words.

    Args:
        sign: of the kinematics.
    """
    other = spec.between[1]
    texts = {"tied": f"tied to '{other}'", "sliding": f"slides on '{other}'"}
    if sign < 0 and (closure := spec.assumed) is not None:
        return f"on '{other}', with a pressure for which {closure.assumes} (assumed: the shape does not determine it)"
    rough = f"with friction {spec.friction:g}" if spec.friction else "without friction"
    return texts.get(spec.kind, f"on '{other}', {rough}")
