"""Summary of a run: its content, and its files."""

from hpcinv.output.summary.content import statistics, versions
from hpcinv.output.summary.files import write_summary

__all__ = ["statistics", "versions", "write_summary"]
