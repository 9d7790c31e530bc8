"""The discrete model of a job on a body: spaces, supports, parameters and weak form."""

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)
