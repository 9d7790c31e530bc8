"""Places in a job."""

type KeyPath = tuple[int | str, ...]
"""keys and indices from the outside in, such as ``("effects", 0, "density")``"""
