"""Search for degree, mesh and tolerance that meet the accuracy demanded by a job at the least cost.

`hpcinv.accuracy.search` has it; few jobs need it, and it takes longer to import than the rest.
"""

from hpcinv.accuracy.accuracy_record import AccuracyRecord

__all__ = ["AccuracyRecord"]
