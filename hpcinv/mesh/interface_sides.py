"""Names of the regions on both sides of an interface."""

from hpcinv.mesh.body import Body


def side_names(between: tuple[str, str]) -> tuple[str, str]:
    """Return the names of the sides of an interface between two labels."""
    a, b = between
    return f"{a}|{b}", f"{b}|{a}"


def sides_of(body: Body, between: tuple[str, str]) -> tuple[str, str]:
    """Return the regions of the boundary on both sides of an interface between two regions or two labels."""
    sides = side_names(between)
    is_of_labels = all(name in body.regions and not body.regions[name].facet_count for name in between)
    return sides if is_of_labels and all(side in body.regions for side in sides) else between
