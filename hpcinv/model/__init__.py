"""The model of a scene: its spaces, supports, parameters and virtual work."""

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)
