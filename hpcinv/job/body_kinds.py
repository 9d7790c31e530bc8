"""Kinds of bodies: what differs between them in numbers and words.

Other packages have a class for each kind, which they find by its name: rules (`hpcinv.job.kind_rules`), the mesh
(`hpcinv.mesh.kind_source`), arrays of results (`hpcinv.output.vtk`) and the finer problem (`hpcinv.trust.certificate`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from hpcinv.base.mesh_formats import SAVED
from hpcinv.base.reading.mesh_format import INNER, OUTER, Groups


@dataclass(frozen=True)
class BodyKind:
    """A kind of body.

    Attributes:
        name: key of the section of a mesh that makes it a body of this kind; other packages find their classes by it.
        dimension: number of directions in which cells get smaller.
        raises_degree: whether a higher degree makes its error smaller.
        fill: exponent of the entries of factors by the number of unknowns: O(N^(4/3)) and O(N log N) by nested
            dissection (George 1973, doi:10.1137/0710032). Analyses of sheets by MUMPS with METIS have 1.21 from 10,000
            to 38,000 unknowns and 1.15 to 150,000. Lowered, a mesh may take more memory than there is.
        against_multigrid: why multigrid does not suit its cells; empty if it does.
        rigid_share: share of a motion (of its squares) that is rigid, above which the body is said to be nearly free.
            Raised, less firm supports are not named.
        is_slack: whether it hardly resists across itself before it is tense.
        reads_surface: whether its mesh is a surface, around which it is made.
        saved: formats that its shape may have.
        actions: of ``hpcinv.base.reading.isolated_reader`` by suffix, where other bodies have another one.
        groups: makes its groups from the groups of its mesh file.
        faces: regions of the two faces where its results are shown; a solid has none.
        has_singular_edges: whether its re-entrant and held edges are singular. Edges of a shell act on a strip as wide
            as it is thick.
        facets_remedy: what to do about a region that has no facets.
    """

    name: str
    dimension: Literal[2, 3]
    raises_degree: bool
    fill: float
    against_multigrid: str
    rigid_share: float
    is_slack: bool
    reads_surface: bool
    saved: tuple[str, ...]
    actions: Mapping[str, str]
    groups: Callable[[Groups], Groups]
    faces: tuple[str, ...]
    has_singular_edges: bool
    facets_remedy: str


SOLID = BodyKind(
    "solid",
    3,
    raises_degree=True,
    fill=4 / 3,
    against_multigrid="",
    rigid_share=0.5,
    is_slack=False,
    reads_surface=False,
    saved=SAVED,
    actions={},
    groups=lambda groups: groups,
    faces=(),
    has_singular_edges=True,
    facets_remedy="Name a physical surface, or a geometric region that contains whole facets of the boundary.",
)
SHELL = BodyKind(
    "shell",
    2,
    raises_degree=False,
    fill=1.2,
    against_multigrid="the cells of a shell are too thin for multigrid",
    rigid_share=0.9,  # a square that is hinged at its edges and bends has 0.66
    is_slack=True,
    reads_surface=True,
    saved=("inp", "msh", "vtu"),
    actions={".inp": "inp-shells"},
    groups=Groups.of_shell,
    faces=(OUTER, INNER),
    has_singular_edges=False,
    facets_remedy="Name an edge of the surface, or a face: '{name}|outer', '{name}|inner'.",
)
KINDS: Mapping[str, BodyKind] = {kind.name: kind for kind in (SOLID, SHELL)}
"""by name"""
