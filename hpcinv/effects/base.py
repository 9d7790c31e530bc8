"""What the scene asks of an effect: anything beside the material law that loads or strains the body."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.schema import Spec

if TYPE_CHECKING:
    from hpcinv.kinematics import Kinematics

type Direction = Literal["forward", "inverse"]


class Effect(Spec):
    """A load or strain.

    A subclass in a module of this package, with a literal field ``effect``, is registered by that.
    """

    directions: ClassVar[frozenset[Direction]] = frozenset({"forward", "inverse"})
    """The analyses that the effect can serve; a job that asks for another is refused."""

    @abstractmethod
    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any:
        """External virtual work, a UFL form linear in ``v``.

        Args:
            k: kinematics, whose integrals and gradients the form is written with.
            v: virtual displacement.
            load: load factor, from 0 to 1.
            par: the effect's quantities by name, scaled.
        """
