"""How a fixed-point method moves the reference body: the part that plain, relaxed and accelerated methods differ in."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import numpy.typing as npt

type Floats = npt.NDArray[np.float64]


class Update(ABC):
    """The next step of a search for ``r(X) = 0``, from all the points that it has been asked at.

    A step need not be taken as it was proposed: each rule goes by the points themselves.

    Args:
        relaxation: share of the first correction ``-r`` that is taken.
        memory: number of earlier steps to learn from.
        inner: inner product of two arrays of the shape of ``X``, over all ranks.

    Attributes:
        names: what a job may call the rule.
    """

    names: ClassVar[tuple[str, ...]]

    def __init__(self, relaxation: float, memory: int, inner: Callable[[Floats, Floats], float]) -> None:
        self.relaxation, self.memory, self.inner = relaxation, memory, inner

    @abstractmethod
    def step(self, X: Floats, r: Floats) -> Floats:
        """What to add to ``X``, where the residual is ``r``."""
