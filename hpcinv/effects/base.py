"""What the scene asks of an effect: anything beside the material law that loads or strains the body."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.schema import Name

if TYPE_CHECKING:
    from hpcinv.kinematics.kinematics import Deformation, Kinematics

type Direction = Literal["forward", "inverse"]
type Configuration = Literal["reference", "current"]


class Effect(Ingredient):
    """A load or strain, which overrides those of the hooks below that it needs.

    A subclass with a literal field ``effect`` is registered by that. In every hook ``load`` is the load factor of the
    effect's load case, from 0 to 1, and ``par`` holds the effect's quantities by name, scaled.
    """

    directions: ClassVar[frozenset[Direction]] = frozenset({"forward", "inverse"})
    """The analyses that the effect can serve; a job that asks for another is refused."""

    case: Name | None = None
    """load case (a name from 'load_cases') in which it grows from nothing to its full size; left out, the first"""

    @property
    def holds(self) -> frozenset[str]:
        """Axes along which it keeps the body from moving as a whole."""
        return frozenset()

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any | None:
        """External virtual work, a UFL form linear in the virtual displacement ``v``."""
        return None

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any | None:
        """``F_g - I`` of a stress-free stretch ``F_g`` of the reference body, a UFL tensor."""
        return None

    def potential(self, k: Deformation, load: Any, par: Any) -> Any | None:
        """A potential per reference volume whose derivative by ``F`` adds to the stress ``P``."""
        return None
