"""Search for degree, mesh and tolerance that meet the accuracy demanded by a job at the least cost."""

from hpcinv.accuracy.accuracy_record import AccuracyRecord
from hpcinv.accuracy.search import Search

__all__ = ["AccuracyRecord", "Search"]
