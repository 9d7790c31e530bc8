"""Meshes in formats of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from helpers.mesh_cases import spec
from hpcinv.mesh import read_source
from hpcinv.mesh.source import MeshSource


def read(path: Path, **settings: object) -> MeshSource:
    return read_source(spec(path, **settings), path)


def volume(source: MeshSource) -> float:
    from hpcinv.mesh.cells import jacobians, quadrature

    points, weights = quadrature(source.kind, 6)
    determinants = np.linalg.det(jacobians(source.kind, source.degree, source.points[source.cells], points))
    assert determinants.min() > 0
    return float((determinants @ weights).sum())


BDF = """SOL 101
SET 5 = 1, 2,
 3
SET 6 = 1 THRU 3
BEGIN BULK
$HMNAME PROP           7"rubber"
$HMSET         9        1 "foot"
GRID           1              0.      0.      0.
GRID,2,,1.0,0.0,0.
GRID*                  3                              0.             1.0
*                   0.+0
GRID           4              0.      0.   10.-1
CTETRA         1       7       1       2       3       4
CTRIA3        20      30       1       2       3
SET1           9       1    THRU       3
SET3          11    ELEM       1
MAT1           1   1.0E5             0.3
ENDDATA
"""


CDB = """/PREP7
ET,        1,186
NBLOCK,6,SOLID,         4,         4
(3i9,6e21.13e3)
        1        0        0
        2        0        0 1.0000000000000E+000
        3        0        0 0.0000000000000E+000 1.0000000000000E+000
        4        0        0 0.0000000000000E+000 0.0000000000000E+000 1.0000000000000E+000
N,R5.3,LOC,       -1,
EBLOCK,19,SOLID,         1,         1
(19i9)
        1        1        1        1        0        0        0        0        8        0        5NODES
       -1
CMBLOCK,FOOT    ,NODE,       2
(8i10)
         1        -3
CMBLOCK,BODY,ELEM,       1  ! users
(8i10)
         5
MP,EX,1,2.0
"""


def cdb(nodes: tuple[int, ...] = (1, 2, 3, 3, 4, 4, 4, 4)) -> str:
    return CDB.replace("NODES", "".join(f"{node:9d}" for node in nodes)).replace("1,186", "1,185")


UNV = """    -1
  2411
         1         1         1        11
  0.0D+00  0.0D+00  0.0D+00
         2         1         1        11
  1.0D+00  0.0D+00  0.0D+00
         3         1         1        11
  0.0D+00  1.0D+00  0.0D+00
         4         1         1        11
  0.0D+00  0.0D+00  1.0D+00
    -1
    -1
  2412
         1       111         1         1         7         4
         1         2         3         4
    -1
    -1
  2467
         1         0         0         0         0         0         0         1
foot
         7         1         0         0
    -1
"""
MESH = """MeshVersionFormatted 2
Dimension 3
Vertices
4
0 0 0 0
1 0 0 0
0 1 0 0
0 0 1 0
Tetrahedra
1
1 2 3 4 3
Triangles
1
1 2 3 2
End
"""
TEXTS = {".bdf": BDF, ".cdb": cdb(), ".unv": UNV, ".mesh": MESH}
