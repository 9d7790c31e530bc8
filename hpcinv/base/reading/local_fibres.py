"""Fibres of FEBio's models along a line between two nodes of each element (``<fiber type="local">``).

The reader of the mesh makes an array of their directions, and ``hpcinv new job --from`` names it.
"""


def local_nodes(text: str) -> tuple[int, int]:
    """Return the numbers, from 1, of the nodes from and to which fibres point.

    Raises:
        ValueError: they are not two different nodes.
    """
    first, second = (int(entry) for entry in text.replace(",", " ").split())
    if first <= 0 and second <= 0:  # FEBio's default
        first, second = 1, 2
    if first <= 0 or second <= 0 or first == second:
        raise ValueError(f"{text!r} are not two different nodes")
    return first, second


def local_name(nodes: tuple[int, int]) -> str:
    """Return the name of the array of the directions."""
    return f"local-{nodes[0]}-{nodes[1]}"
