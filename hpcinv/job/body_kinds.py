"""Kinds of bodies: what differs between them in numbers and words. Their finer problems are in `trust.certificate`."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class BodyKind:
    """A kind of body.

    Attributes:
        dimension: number of directions in which cells get smaller.
        raises_degree: whether a higher degree makes its error smaller.
        fill: exponent of the entries of factors by the number of unknowns: O(N^(4/3)) and O(N log N) by nested
            dissection (George 1973, doi:10.1137/0710032). Analyses of sheets by MUMPS with METIS have 1.21 from 10,000
            to 38,000 unknowns and 1.15 to 150,000. Lowered, a mesh may take more memory than there is.
        against_multigrid: why multigrid does not suit its cells; empty if it does.
        rigid_share: share of a motion (of its squares) that is rigid, above which the body is said to be nearly free.
            Raised, less firm supports are not named.
        is_slack: whether it hardly resists across itself before it is tense.
    """

    dimension: Literal[2, 3]
    raises_degree: bool
    fill: float
    against_multigrid: str
    rigid_share: float
    is_slack: bool


SOLID = BodyKind(3, raises_degree=True, fill=4 / 3, against_multigrid="", rigid_share=0.5, is_slack=False)
SHELL = BodyKind(
    2,
    raises_degree=False,
    fill=1.2,
    against_multigrid="the cells of a shell are too thin for multigrid",
    rigid_share=0.9,  # a square that is hinged at its edges and bends has 0.66
    is_slack=True,
)
