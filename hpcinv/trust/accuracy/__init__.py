"""Search for degree, mesh and tolerance that meet the accuracy demanded by a job at the least cost.

`hpcinv.trust.accuracy.search` has it; few jobs need it, and it takes longer to import than the rest.
"""

from hpcinv.trust.accuracy.accuracy_record import AccuracyRecord

__all__ = ["AccuracyRecord"]
