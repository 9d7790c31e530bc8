"""Jobs that demand an accuracy: degree, mesh and tolerance are chosen to meet it at the least cost."""

from __future__ import annotations

from hpcinv.accuracy.record import AccuracyRecord
from hpcinv.accuracy.search import Search

__all__ = ["AccuracyRecord", "Search"]
