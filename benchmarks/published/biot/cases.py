"""The number of unstable directions of the block, counted as for Euler's column."""

from ..euler.cases import quantities

__all__ = ["quantities"]
