"""Rules of structure that neither the linter nor the import contracts have."""

from house_counts import dense_functions


def test_functions_are_not_dense() -> None:
    """A function above this is split by meaning, or a table of its cases."""
    assert dense_functions("hpcinv", 20) == []
