"""STEP files (AP214) of a solid with a plane face for each triangle: a faceted boundary representation.

Source: ISO 10303-42, ``faceted_brep``.
"""

from collections.abc import Iterator

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.units import as_float, parse_unit
from hpcinv.geometry.workshop.solid import Solid

_ACCURACY = 1e-7
"""distance of points that are one, relative to the size of the solid; raised, thin triangles vanish"""
_HEAD = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('faceted shape'),'2;1');
FILE_NAME('shape','1970-01-01T00:00:00',(''),(''),'hpcinv','hpcinv','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
#1=APPLICATION_CONTEXT('core data for automotive mechanical design processes');
#2=APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#1);
#3=PRODUCT_CONTEXT('',#1,'mechanical');
#4=PRODUCT('shape','shape','',(#3));
#5=PRODUCT_DEFINITION_FORMATION('','',#4);
#6=PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#7=PRODUCT_DEFINITION('design','',#5,#6);
#8=PRODUCT_DEFINITION_SHAPE('','',#7);
#9=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#10=(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.));
#11=(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT());
#12=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({accuracy}),#9,'distance_accuracy_value','');
#13=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#12))
GLOBAL_UNIT_ASSIGNED_CONTEXT((#9,#10,#11))REPRESENTATION_CONTEXT('',''));
#14=SHAPE_DEFINITION_REPRESENTATION(#8,#15);
#15=FACETED_BREP_SHAPE_REPRESENTATION('',(#16),#13);
#16=FACETED_BREP('shape',#17);
"""
_FIRST = 18


def step_content(solid: Solid, unit: str) -> bytes:
    """Return the content of a file in mm of a solid in a unit."""
    points = solid.points * (as_float(parse_unit(unit)[0]) * 1e3)
    accuracy = _real(_ACCURACY * float(np.ptp(points, axis=0).max()))
    return (_HEAD.replace("{accuracy}", accuracy) + "".join(_entities(points, solid))).encode()


def _entities(points: Floats, solid: Solid) -> Iterator[str]:
    corners = points[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    kept = np.flatnonzero(lengths > 0)
    normals = normals[kept] / lengths[kept, None]
    along = corners[kept, 1] - corners[kept, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    for number, point in enumerate(points.tolist(), _FIRST):
        yield f"#{number}=CARTESIAN_POINT('',{_triple(point)});\n"
    number = _FIRST + len(points)
    faces = []
    triangles = solid.triangles[kept].tolist()
    for triangle, normal, direction in zip(triangles, normals.tolist(), along.tolist(), strict=True):
        a, b, c = (_FIRST + row for row in triangle)
        yield f"#{number}=POLY_LOOP('',(#{a},#{b},#{c}));\n"
        yield f"#{number + 1}=FACE_OUTER_BOUND('',#{number},.T.);\n"
        yield f"#{number + 2}=DIRECTION('',{_triple(normal)});\n"
        yield f"#{number + 3}=DIRECTION('',{_triple(direction)});\n"
        yield f"#{number + 4}=AXIS2_PLACEMENT_3D('',#{a},#{number + 2},#{number + 3});\n"
        yield f"#{number + 5}=PLANE('',#{number + 4});\n"
        yield f"#{number + 6}=FACE_SURFACE('',(#{number + 1}),#{number + 5},.T.);\n"
        faces.append(number + 6)
        number += 7
    yield f"#17=CLOSED_SHELL('',({','.join(f'#{face}' for face in faces)}));\n"
    yield "ENDSEC;\nEND-ISO-10303-21;\n"


def _triple(values: list[float]) -> str:
    return f"({','.join(map(_real, values))})"


def _real(value: float) -> str:
    """Return a number with a point, as the format needs it."""
    mantissa, letter, exponent = repr(value).partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.'}{'E' if letter else ''}{exponent}"
