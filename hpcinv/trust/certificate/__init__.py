"""Certificate of a run: checks of its result that are independent of the solve, registered by subclassing `Check`."""

from __future__ import annotations

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.base.quantity.schema import import_modules
from hpcinv.trust.certificate.certify import Check, CheckedRun, certify, certify_all, checks
from hpcinv.trust.certificate.check import (
    TOPICS,
    Certificate,
    Line,
    Topic,
    Verdict,
    lower_bound_line,
    skipped,
    topic,
    upper_bound_line,
)
from hpcinv.trust.discretisation.estimate import Estimate

import_modules(__name__, __path__)

__all__ = [
    "TOPICS",
    "Certificate",
    "Check",
    "CheckedRun",
    "Estimate",
    "Line",
    "Topic",
    "Verdict",
    "certify",
    "certify_all",
    "checks",
    "lower_bound_line",
    "skipped",
    "topic",
    "upper_bound_line",
]
