"""Sensitivities of the computed body and of its quantities of interest to parameters of the job."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
