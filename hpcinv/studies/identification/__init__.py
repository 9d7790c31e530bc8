"""Identification of parameters of a job, together with the rest shape, from observations of several states."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
