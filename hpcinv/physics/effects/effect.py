"""Base class of the effects: everything besides the material law that loads or strains the body."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.schema import Faults, Name
from hpcinv.base.quantity.units import Dimension

if TYPE_CHECKING:
    from hpcinv.physics.kinematics.kinematics import Deformation as Deformation
    from hpcinv.physics.kinematics.kinematics import Kinematics as Kinematics
else:  # it loads UFL, which the check of a job does not need
    Deformation = Kinematics = Any

type Direction = Literal["forward", "inverse"]
type Configuration = Literal["reference", "current"]


class Effect(Ingredient):
    """A load or strain, which overrides at least one of the hooks below.

    A subclass with a literal field ``effect`` is registered under that name. In every hook ``load`` is the load factor
    of the effect's load case, from 0 to 1, and ``par`` holds the effect's quantities by name, scaled.
    """

    directions: ClassVar[frozenset[Direction]] = frozenset({"forward", "inverse"})
    """The directions that the effect supports; a job with another one is refused."""

    only_of_kind: ClassVar[str] = ""
    """Name of the kind of body that it is for, such as ``shell``; others with it are refused. Empty: for all."""

    attached: ClassVar[frozenset[str]] = frozenset()
    """Quantities of a load that belong to the body, such as its density: x, y, z in their formulas is the position in
    the given state, whatever the state of the load."""

    case: Name | None = None
    """load case (a name from 'load_cases') in which it grows from nothing to its full size; left out, the first"""

    writes_its_stress: ClassVar[bool] = False
    """True if results have the stress that its inelastic strain alone causes in the body's reference shape."""

    finds: ClassVar[str] = ""
    """Number of a load that the solve finds if a job leaves it out (``None``), so that `constraint` is zero. The forces
    of the load are in proportion to the number and to ``load``."""

    @property
    def is_unknown(self) -> bool:
        """True if the solve finds a number of it."""
        return bool(self.finds) and getattr(self, self.finds) is None

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        quantities = super().quantities()
        if self.is_unknown:
            quantities[self.finds] = 0.0, quantities[self.finds][1]
        return quantities

    @property
    def is_load(self) -> bool:
        """True if it acts in space; fields of other effects are attached to the material, as fields of laws are."""
        return type(self).virtual_work is not Effect.virtual_work

    @property
    def strain_given_on(self) -> Configuration:
        """Body on which `inelastic_strain` is given; ``F_g`` of the current body is pulled back, ``F⁻¹F_g F``."""
        return "reference"

    @property
    def presses_at_any_load(self) -> bool:
        """True if its forces act on the undeformed body whatever the load factor is, as of an elastic layer in its way.

        ``par.growing`` is 1 on forward paths on which they grow with the load factor instead, else 0.
        """
        return False

    @property
    def is_paired(self) -> bool:
        """True if it takes the part of the second surface of an interface, instead of a traction of its own."""
        return False

    def is_attached(self, name: str) -> bool:
        return not self.is_load or name in self.attached

    @property
    def holds(self) -> frozenset[str]:
        """Axes along which it resists rigid motions of the body."""
        return frozenset()

    def faults(self, first: Direction) -> Faults:
        """Yield faults, with their places, if the given body is the body of the ``first`` direction."""
        yield from ()

    def functions(self, degree: int) -> Mapping[str, tuple[int, int]]:
        """Return number of components and Lagrange degree, by name, of functions that the solver updates.

        ``par`` holds them in addition to the quantities. ``degree`` is the degree of the displacement.
        """
        return {}

    def virtual_work(self, k: Kinematics, v: Any, load: Any, par: Any) -> Any | None:
        """Return the external virtual work, a UFL form linear in the virtual displacement ``v``."""
        return None

    def constraint(self, k: Kinematics, u: Any, load: Any, par: Any) -> Any | None:
        """Return an integral that is zero at the solution, if the solve finds a number: it may depend on the number.

        ``u = x - X`` is the displacement, scaled. As ``load`` grows from 0, it leads from the unloaded body to what is
        given.
        """
        return None

    def inelastic_strain(self, k: Deformation, load: Any, par: Any) -> Any | None:
        """Return ``F_g - I`` of a stress-free stretch ``F_g``, a UFL tensor; several ones multiply in their order."""
        return None

    def potential(self, k: Deformation, load: Any, par: Any) -> Any | None:
        """Return a potential per reference volume whose derivative by ``F`` is added to the stress ``P``."""
        return None

    def positive(self, par: Any, directions: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return numbers that must be positive everywhere, by their names in messages.

        Args:
            par: samples (SI) of its quantities by name, arrays of (cells, points, …) or numbers.
            directions: samples of the unit vectors of its families of fibres, (cells, points, 3).
        """
        return {}
