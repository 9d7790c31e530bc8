"""Numbers with units of a job: the types of fields in mesh generators, laws and effects, formulas, and schema.

Mesh generators, laws and effects import the names below from here. The package needs neither MPI nor DOLFINx.
"""

from hpcinv.base.quantity.component import Family as Family
from hpcinv.base.quantity.component import Surface as Surface
from hpcinv.base.quantity.quantity import Acceleration as Acceleration
from hpcinv.base.quantity.quantity import AnyQuantity as AnyQuantity
from hpcinv.base.quantity.quantity import Area as Area
from hpcinv.base.quantity.quantity import BulkStress as BulkStress
from hpcinv.base.quantity.quantity import Density as Density
from hpcinv.base.quantity.quantity import Dimensionless as Dimensionless
from hpcinv.base.quantity.quantity import Divisions as Divisions
from hpcinv.base.quantity.quantity import Force as Force
from hpcinv.base.quantity.quantity import Frequency as Frequency
from hpcinv.base.quantity.quantity import Length as Length
from hpcinv.base.quantity.quantity import Mass as Mass
from hpcinv.base.quantity.quantity import Quantity as Quantity
from hpcinv.base.quantity.quantity import Size as Size
from hpcinv.base.quantity.quantity import Stress as Stress
from hpcinv.base.quantity.quantity import Time as Time
from hpcinv.base.quantity.quantity import Velocity as Velocity
from hpcinv.base.quantity.quantity import Volume as Volume
from hpcinv.base.quantity.schema import Faults as Faults
from hpcinv.base.quantity.schema import KeyPath as KeyPath
from hpcinv.base.quantity.schema import ListOf as ListOf
from hpcinv.base.quantity.schema import Name as Name
from hpcinv.base.quantity.schema import Problems as Problems
from hpcinv.base.quantity.schema import Triple as Triple
from hpcinv.base.quantity.schema import raise_if_any as raise_if_any
from hpcinv.base.quantity.spatial_fields import BulkModulusField as BulkModulusField
from hpcinv.base.quantity.spatial_fields import DensityField as DensityField
from hpcinv.base.quantity.spatial_fields import DispersionField as DispersionField
from hpcinv.base.quantity.spatial_fields import ExpansionField as ExpansionField
from hpcinv.base.quantity.spatial_fields import LameField as LameField
from hpcinv.base.quantity.spatial_fields import ModulusField as ModulusField
from hpcinv.base.quantity.spatial_fields import MomentField as MomentField
from hpcinv.base.quantity.spatial_fields import NumberField as NumberField
from hpcinv.base.quantity.spatial_fields import PositiveField as PositiveField
from hpcinv.base.quantity.spatial_fields import StiffnessField as StiffnessField
from hpcinv.base.quantity.spatial_fields import StressField as StressField
from hpcinv.base.quantity.spatial_fields import TemperatureField as TemperatureField
from hpcinv.base.quantity.spatial_fields import VaryingQuantity as VaryingQuantity
from hpcinv.base.quantity.tensor_fields import TensorField as TensorField
