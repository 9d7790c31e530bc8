"""Numbers with units of a job: the types of fields in mesh generators, laws and effects, formulas, and schema.

Mesh generators, laws and effects import the names below from here. The package needs neither MPI nor DOLFINx.
"""

from hpcinv.quantity.component import Family as Family
from hpcinv.quantity.component import Surface as Surface
from hpcinv.quantity.quantity import Acceleration as Acceleration
from hpcinv.quantity.quantity import AnyQuantity as AnyQuantity
from hpcinv.quantity.quantity import Area as Area
from hpcinv.quantity.quantity import BulkStress as BulkStress
from hpcinv.quantity.quantity import Density as Density
from hpcinv.quantity.quantity import Dimensionless as Dimensionless
from hpcinv.quantity.quantity import Divisions as Divisions
from hpcinv.quantity.quantity import Force as Force
from hpcinv.quantity.quantity import Frequency as Frequency
from hpcinv.quantity.quantity import Length as Length
from hpcinv.quantity.quantity import Mass as Mass
from hpcinv.quantity.quantity import Quantity as Quantity
from hpcinv.quantity.quantity import Size as Size
from hpcinv.quantity.quantity import Stress as Stress
from hpcinv.quantity.quantity import Time as Time
from hpcinv.quantity.quantity import Velocity as Velocity
from hpcinv.quantity.quantity import Volume as Volume
from hpcinv.quantity.schema import Faults as Faults
from hpcinv.quantity.schema import KeyPath as KeyPath
from hpcinv.quantity.schema import ListOf as ListOf
from hpcinv.quantity.schema import Name as Name
from hpcinv.quantity.schema import Problems as Problems
from hpcinv.quantity.schema import Triple as Triple
from hpcinv.quantity.schema import raise_if_any as raise_if_any
from hpcinv.quantity.spatial_fields import BulkModulusField as BulkModulusField
from hpcinv.quantity.spatial_fields import DensityField as DensityField
from hpcinv.quantity.spatial_fields import DispersionField as DispersionField
from hpcinv.quantity.spatial_fields import ExpansionField as ExpansionField
from hpcinv.quantity.spatial_fields import LameField as LameField
from hpcinv.quantity.spatial_fields import ModulusField as ModulusField
from hpcinv.quantity.spatial_fields import MomentField as MomentField
from hpcinv.quantity.spatial_fields import NumberField as NumberField
from hpcinv.quantity.spatial_fields import PositiveField as PositiveField
from hpcinv.quantity.spatial_fields import StiffnessField as StiffnessField
from hpcinv.quantity.spatial_fields import StressField as StressField
from hpcinv.quantity.spatial_fields import TemperatureField as TemperatureField
from hpcinv.quantity.spatial_fields import VaryingQuantity as VaryingQuantity
from hpcinv.quantity.tensor_fields import TensorField as TensorField
