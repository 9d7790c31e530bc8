"""A job as a model that other programs evaluate over HTTP."""
