"""Sections of a job file that describe the body: mesh, supports, and quantities of interest."""

import math
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PrivateAttr,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.files.names import FilePath, NamesFile, exists, is_file
from hpcinv.base.files.untrusted import applies
from hpcinv.base.mesh_formats import FORMATS as MESHES
from hpcinv.base.mesh_formats import mesh_fault
from hpcinv.base.quantity.expressions import Expression, faults, faults_with_constants
from hpcinv.base.quantity.parameter_paths import Number, replace_scalar
from hpcinv.base.quantity.quantity import AnyQuantity, Length, LengthUnit, Quantity, Size
from hpcinv.base.quantity.schema import (
    Faults,
    KeyPath,
    ListOf,
    Name,
    Problems,
    Spec,
    TextOrTexts,
    Triple,
    collected,
    raise_if_any,
    shown,
)
from hpcinv.base.quantity.spatial_fields import ByRegion, ThicknessField
from hpcinv.base.quantity.stress_measures import COMPONENTS, MEASURES, PRESTRAIN_COMPONENTS, PRESTRAIN_STRESSES
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.body_kinds import KINDS, SOLID, BodyKind
from hpcinv.job.lumen import INNER, OR_OPEN, OUTER, WALL, End, WallThickness, also_open
from hpcinv.job.mesh_generators import ParameterValue, converted_parameters, is_generator, read_parameters
from hpcinv.job.remote_load import RemoteLoad

type AxisName = Literal["x", "y", "z"]
AXES: tuple[AxisName, ...] = ("x", "y", "z")
LENGTH = Dimension(length=1)
CUBIC = Dimension(length=3)
COORDINATES: dict[str, Dimension | None] = dict.fromkeys(AXES, LENGTH)
POSITIONS = COORDINATES | dict.fromkeys(("X", "Y", "Z", "ux", "uy", "uz"), LENGTH)
FITTED_SURFACES = ("sphere", "cylinder")
REGION_NAMES = COORDINATES | dict.fromkeys(("nx", "ny", "nz", "cavity"), Dimension())
"""what conditions of regions may use: position, outer normal, and the number of a cavity"""
STRESS = Dimension(length=-1, mass=1, time=-2)
STRESSES = (*COMPONENTS, *MEASURES, "energy")
NORMALS = ("nx", "ny", "nz")
FIELDS: dict[str, Dimension | None] = {
    "J": Dimension(),
    **dict.fromkeys(STRESSES, STRESS),
    **dict.fromkeys(NORMALS, Dimension()),
    **dict.fromkeys(PRESTRAIN_STRESSES, STRESS),
    **dict.fromkeys(PRESTRAIN_COMPONENTS, Dimension()),
}

Label = Annotated[int, Field(ge=1)] | Annotated[str, Field(min_length=1)]
_LABEL = {"anyOf": [{"type": "integer", "minimum": 1}, {"type": "string", "minLength": 1}]}
Labels = Annotated[
    ListOf[Label],
    BeforeValidator(lambda v: [v] if isinstance(v, int | str) else v),
    WithJsonSchema({"anyOf": [*_LABEL["anyOf"], {"type": "array", "items": _LABEL}]}),
]
CUT = "cut"
"""region of an image's mesh where a label ends with the image"""
RESERVED = ("boundary", "outside", CUT, "cavity")
"""names that regions of images and surfaces have by themselves"""


def _right_handed(orientation: str) -> str:
    """Check that letters are of three axes at right angles, in the order of a right-handed frame."""
    axes = ["LPSRAI".find(letter) % 3 if letter in "LPSRAI" else -1 for letter in orientation]
    is_even = axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    mirrored = sum(letter in "RAI" for letter in orientation) % 2 == 1
    if sorted(axes) != [0, 1, 2] or is_even == mirrored:
        raise ValueError(f"{shown(orientation)} is not a right-handed frame of three letters, such as LPS or RAS")
    return orientation


Orientation = Annotated[str, AfterValidator(_right_handed)]
Numbers = Annotated[
    ListOf[Annotated[int, Field(strict=True)]],
    BeforeValidator(lambda v: [v] if isinstance(v, int) and not isinstance(v, bool) else v),
    WithJsonSchema({"anyOf": [{"type": "integer"}, {"type": "array", "items": {"type": "integer"}}]}),
]
CONTACTS = {"contact_force": "N", "contact_area": "m^2", "contact_penetration": "m"}
CAVITY_QUANTITIES = {"volume": CUBIC, "pressure": STRESS}
"""quantities of cavities with their dimensions"""
REACTIONS = {"reaction": "N", "reaction_moment": "N m", **CONTACTS}
FORMATS = (".py", ".geo", *MESHES)
"""suffixes of generators and meshes"""
IMAGES = (".nii", ".gz", ".nrrd", ".mha", ".mhd", ".vti", ".dcm")
"""suffixes of segmented images"""
SURFACES = (".stl", ".ply", ".obj", ".vtp", ".vtk")
"""suffixes of surfaces of triangles"""
CENTRELINE = ".csv"
"""suffix of a table of centrelines"""
CADS = (".step", ".stp", ".iges", ".igs", ".brep")
"""suffixes of CAD files"""


def directory_of(info: ValidationInfo) -> Path:
    """Directory to which paths in the job are relative."""
    directory: Path = (info.context or {}).get("directory", Path())
    return directory


def _not_true(value: object) -> object:
    """Return a value unless it is true or false, which Python takes for 1 and 0."""
    if isinstance(value, bool):
        raise ValueError(f"must be a number, not {shown(value)}")
    return value


def _not_membrane(value: object) -> object:
    """Return a kind of shell unless it is a membrane."""
    if value == "membrane":
        raise ValueError("must be 'director': for a membrane, give a small thickness; bending has no effect then")
    return value


_OTHER_SOURCES = "image", "surface", "cad", "lumen"
"""keys of a mesh that stand for ``file``"""


def _sources_in(data: Any) -> list[str]:
    return [key for key in _OTHER_SOURCES if isinstance(data, Mapping) and key in data]


def _fault_of_format(path: Path) -> str:
    """Return what is wrong with a mesh that exists; empty if it has what its suffix says."""
    mesh_format = MESHES.get(suffix_of(path))
    if not is_file(path / mesh_format.head if mesh_format else path):
        return "is not of the kind of its suffix; 'hpcinv mesh partition' makes a partitioned mesh"
    try:
        return mesh_format.fault(path) if mesh_format else ""
    except OSError as error:
        return f"cannot be read: {error.strerror}"


class MeshFile(Spec):
    """A mesh: a file, or a generator that is run when the mesh is needed."""

    file: FilePath
    """path from the job file to a gmsh generator (.py, .geo), a mesh (.msh, .vtu, .xdmf, or of another program: .inp,
    .feb, .cdb, .bdf, .e, .med, .unv, .vtk, .mesh), or a partitioned mesh made by 'hpcinv mesh partition' (.bp): each
    rank reads a part"""
    unit: LengthUnit = 1.0
    """length unit of the coordinates in a mesh file, of a .geo script without 'parameters', or of a Python generator,
    such as mm: lengths are passed to it in that unit, for bodies too small or too large for gmsh's absolute tolerances
    in metres. By default m, or the unit that a mesh file states"""
    parameters: Annotated[
        Mapping[str, ParameterValue],
        WithJsonSchema({"type": "object", "additionalProperties": {"type": ["number", "string", "boolean"]}}),
    ] = {}
    """parameters of the generator, as numbers in SI or quantities"""

    formats: ClassVar[tuple[str, ...]] = FORMATS
    sources: ClassVar[Mapping[str, tuple[str, ...]]] = {"file": ()}
    """keys that name where the mesh comes from, with the further keys that each needs; a job has one of them"""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """JSON schema with the keys that stand for ``file``."""
        json_schema = super().__get_pydantic_json_schema__(schema, handler)
        content = handler.resolve_ref_schema(json_schema)
        kinds = {
            "image": "a segmented image, instead of 'file'",
            "surface": "a closed surface, instead of 'file'",
            "cad": "a CAD file (.step, .iges, .brep), instead of 'file'",
            "lumen": "a segmented image, a surface, or a table (.csv) of centrelines with radii, instead of 'file'",
        }
        content["properties"] |= {
            key: {"type": "string", "description": kinds[key]} for key in cls.sources if key in kinds
        }
        content["required"] = [key for key in content.get("required", ()) if key != "file"]
        content["oneOf"] = [{"required": [key]} for key in cls.sources]
        content["dependentRequired"] = {key: list(needed) for key, needed in cls.sources.items() if needed}
        return json_schema

    @property
    def is_partitioned(self) -> bool:
        """True if each rank reads some parts of the mesh, and none reads all of it."""
        suffix = suffix_of(self.file)
        return suffix in MESHES and MESHES[suffix].is_partitioned

    @property
    def is_image(self) -> bool:
        """True if the mesh is made from a segmented image."""
        return suffix_of(self.file) in IMAGES

    @property
    def is_surface(self) -> bool:
        """True if the mesh is made from a closed surface."""
        return suffix_of(self.file) in SURFACES

    @property
    def kind(self) -> BodyKind:
        """Kind of the body."""
        return SOLID

    @property
    def is_cad(self) -> bool:
        """True if the mesh is made from a CAD file."""
        return suffix_of(self.file) in CADS

    @model_validator(mode="before")
    @classmethod
    def _source_is_a_file(cls, data: Any) -> Any:
        sources = _sources_in(data)
        if len(sources) > 1 or (sources and "file" in data):
            other = "file" if "file" in data else sources[0]
            raise Problems(((sources[-1],), f"is given together with '{other}': a mesh is made from one of them"))
        if sources == ["lumen"] and data.get("wall") is None and "lumen" in cls.sources:
            raise Problems((("wall",), "is needed: the thickness of the wall around the lumen, such as 1.5 mm"))
        return {("file" if key in sources else key): value for key, value in data.items()} if sources else data

    @classmethod
    def _place_written(cls, place: KeyPath, data: Any) -> KeyPath:
        sources = _sources_in(data)
        return (sources[0], *place[1:]) if place[:1] == ("file",) and sources else place

    @property
    def metres(self) -> float:
        """Length unit (m) of the coordinates that are read: ``unit``; mm by default in images, and of STEP and IGES."""
        is_stated = self.is_image or (self.is_cad and suffix_of(self.file) != ".brep")
        return 1e-3 if is_stated and "unit" not in self.model_fields_set else self.unit

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str, info: ValidationInfo) -> str:
        path = directory_of(info) / file
        if suffix_of(path) == ".gz" and suffix_of(path.stem) in (*FORMATS, *SURFACES):
            raise ValueError(f"{shown(file)} is packed; unpack it by gunzip, and name the file that it makes")
        if suffix_of(path) not in cls.formats:
            raise ValueError(f"{shown(file)} is not a readable mesh; valid suffixes are {', '.join(cls.formats)}")
        if applies(info) and (fault := mesh_fault(directory_of(info), file)):
            raise ValueError(f"{shown(file)} {fault}")
        if not exists(path):
            others = [p.name for p in path.parent.glob("*")] if exists(path.parent) else []
            near = did_you_mean(path.name, others, list_all=False)
            raise ValueError(f"there is no file '{path}'.{near or ' Paths start from the directory of the job file'}")
        if fault := _fault_of_format(path):
            raise ValueError(f"'{path}' {fault}")
        return file

    @field_validator("parameters", mode="plain")
    @classmethod
    def _check_parameters(cls, given: object) -> object:
        """Leave the values as they are given, which `_completed` reads."""
        if not isinstance(given, Mapping):
            raise ValueError(f"must be a mapping of names to values, not {shown(given)}")
        return given

    def _completed(self, info: ValidationInfo) -> Self:
        """The mesh with the parameters of its generator."""
        path = directory_of(info) / self.file
        if not is_generator(path):
            text = f"only generators have parameters, and {path.name} is not one"
            raise_if_any([(("parameters",), text)] if self.parameters else [])
            return self
        problems: list[tuple[KeyPath, str]] = []
        with collected(problems, "parameters"):
            parameters, faults_of_values = read_parameters(path, self.parameters, self.unit)
            raise_if_any(faults_of_values)
        raise_if_any(problems)
        return self.model_copy(update={"parameters": parameters}) if parameters else self

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if "unit" not in self.model_fields_set:
            if self.is_surface:
                yield ("unit",), "is needed: files of surfaces do not have one"
        elif self.is_partitioned:
            yield ("unit",), "is not valid with a partitioned mesh, which is in metres"
        elif suffix_of(self.file) == ".geo":
            if self.parameters:
                yield (
                    ("unit",),
                    "is not valid with parameters of a .geo script, which does not define which of them are lengths: "
                    "leave out 'unit' and write the script in metres, or set its numbers in the script",
                )
        elif is_generator(Path(self.file)):
            try:
                converted_parameters(directory_of(info) / self.file, self.parameters, self.unit)
            except ValueError as error:
                yield ("unit",), str(error)


class ExpectedShape(MeshFile):
    """The body that a run should find: a mesh with the nodes of the given one, a closed surface (written as 'surface'
    instead of 'file'), or a segmented image ('image')."""

    labels: ListOf[Annotated[int, Field(strict=True)]] = ()
    """numbers of the body's voxels in an image; by default all but 0"""
    align: bool = False
    """whether the computed body is moved rigidly to a surface or image before it is compared"""

    formats: ClassVar[tuple[str, ...]] = FORMATS + IMAGES + SURFACES
    sources: ClassVar[Mapping[str, tuple[str, ...]]] = {"file": (), "image": (), "surface": ("unit",)}

    @property
    def has_nodes(self) -> bool:
        """True for a mesh."""
        return not self.is_image and not self.is_surface

    def _contradictions(self, info: ValidationInfo) -> Faults:
        yield from super()._contradictions(info)
        if self.labels and not self.is_image:
            yield ("labels",), "is for segmented images only"
        if self.align and self.has_nodes:
            yield ("align",), "is for surfaces and images only: nodes are compared where they are"


class SurfaceError(Spec):
    """Error of the given surface along its normal: random, with a standard deviation, and smooth."""

    sd: Size
    """standard deviation of the surface's position along its normal"""
    correlation: Size | None = None
    """length over which errors are alike; by default 10 standard deviations"""
    samples: Annotated[int, Field(ge=2, le=10_000)] = 16
    """random surfaces; each takes a linear solve, and m of them give a standard deviation to 1/√(2m)"""


class ArrayLabels(Spec):
    """Regions of a mesh by the values of an array of integers, in its cells, surface cells or nodes."""

    array: str
    """name of the array; a value in nodes is the region of boundary facets and cells all of whose vertices have it"""
    names: Mapping[Name, Numbers] = {}
    """values by name of the region; a value may be in several regions, and one without a name is a region such as
    material-2"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for name in self.names.keys() & {*RESERVED}:
            yield ("names", name), "is the name of another region; choose another"


class Shell(Spec):
    """A shell whose surface is the mesh: triangles and quadrilaterals, in a file or by a generator of gmsh.

    The displacement is quadratic through each layer, and any law of three dimensions holds there.
    """

    thickness: ThicknessField | None = None
    """thickness of the given body along its director: a number, a formula of x, y, z on the surface, or an array at
    the nodes of the file, such as {data: wall, unit: mm}"""
    surface: Literal["middle", "outer", "inner"] = "middle"
    """where the mesh is in the shell: half way through the thickness, or one of the faces"""
    layers: Annotated[Mapping[Name, float], Field(exclude_if=lambda layers: not layers)] = {}
    """layers from the inner to the outer face, which are regions of cells, with their relative thicknesses, such as
    {core: 3, coat: 1}; by default one"""
    director: Literal["normal", "data"] = "normal"
    """of the given body: the normal of the surface; or data: the arrays 'outer' and 'inner' of the file, vectors (m)
    from its nodes to both faces, which give the thickness too, as shape files of runs have them"""
    kind: Annotated[Literal["director"], BeforeValidator(_not_membrane)] = "director"
    """director: with bending, and with shear and strain through the thickness"""

    @property
    def levels(self) -> tuple[float, ...]:
        """Distances of the nodes of a column from the inner face, by the thickness: three in each layer."""
        shares = tuple(self.layers.values()) or (1.0,)
        ends = [sum(shares[:i]) / sum(shares) for i in range(len(shares) + 1)]
        return (0.0, *(p for low, high in pairwise(ends) for p in ((low + high) / 2, high)))

    @property
    def surface_place(self) -> float:
        """Distance of the given surface from the inner face, by the thickness."""
        return {"inner": 0.0, "middle": 0.5, "outer": 1.0}[self.surface]

    @property
    def surface_level(self) -> int | None:
        """Number of the level at which the given surface is, ``None`` between levels."""
        return next((i for i, place in enumerate(self.levels) if abs(place - self.surface_place) < 1e-9), None)

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The thickness, if it is one number; else the reason why it is not."""
        if self.thickness is None:
            return {}
        is_number = isinstance(self.thickness, float)
        return {("thickness",): Number(self.thickness, LENGTH) if is_number else "varies over the surface"}

    def unset_number(self, place: KeyPath) -> str:
        """Return why a number can only be differentiated by: a run has one mesh."""
        return "changes the mesh: vary it in a sweep"

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.director == "normal" and self.thickness is None:
            yield ("thickness",), "is needed, unless the file has the faces ('director: data')"
        elif self.director == "data" and self.thickness is not None:
            yield ("thickness",), "is not valid with 'director: data', which gives it"
        if isinstance(self.thickness, ByRegion):
            yield ("thickness",), "cannot be by region, since it would jump: give a formula or an array at the nodes"
        for name, share in self.layers.items():
            if name in (*RESERVED, "outer", "inner"):
                yield ("layers", name), "is the name of another region; choose another"
            if not 0 < share < math.inf:
                yield ("layers", name), f"must be a positive number, the relative thickness, not {share:g}"


class MeshSpec(MeshFile):
    """The mesh on which the job is solved: of the reference body in a forward analysis, else of the current body."""

    geometry_degree: Annotated[Literal[1, 2] | None, BeforeValidator(_not_true)] = None
    """degree of the geometry of the given cells; by default the file's, and 1 for generators (2 for curved bodies
    in a search for an accuracy). The recovered body has the degree of the displacement in any case"""
    maximum_cells: Annotated[int, Field(ge=1)] = 10_000_000
    """largest number of cells of a generated mesh; if more are expected, meshing stops early"""
    partition: Literal["metis", "scotch"] = "metis"
    """partitioner of the cells; a partitioned mesh (.bp) keeps its partition, unless scotch partitions it again"""
    labels: Annotated[Mapping[Name, Labels], Field(exclude_if=lambda labels: not labels)] = {}
    """of a segmented image (written as 'image' instead of 'file'): the numbers of the voxels of each region,
    or names of segments of a DICOM segmentation or of a .seg.nrrd of 3D Slicer"""
    array_labels: Annotated[ArrayLabels | None, Field(exclude_if=lambda labels: labels is None)] = None
    """of a mesh file (written as 'labels'): an array of integers whose values are regions, such as
    {array: material, names: {plaque: 2}}"""
    faces: Annotated[Mapping[Name, TextOrTexts], NamesFile(), Field(exclude_if=lambda faces: not faces)] = {}
    """of a mesh file: surfaces of triangles with the facets of further regions, in the unit of the mesh, such as
    {inlet: mesh-surfaces/inlet.vtp}"""
    neighbours: Annotated[Mapping[Name, Labels], Field(exclude_if=lambda labels: not labels)] = {}
    """of a segmented image: numbers of voxels around the body that are not meshed; the surface of a label next to them
    is the region LABEL|NEIGHBOUR instead of LABEL|outside"""
    surfaces: Annotated[Mapping[Name, TextOrTexts], NamesFile(), Field(exclude_if=lambda surfaces: not surfaces)] = {}
    """closed surfaces instead of 'file': the files of each region, which is between a shell and those in it, such as
    {wall: [outer.stl, inner.stl]}; a region in another one is cut out of it"""
    orientation: Annotated[Orientation, Field(exclude_if=lambda frame: frame == "LPS")] = "LPS"
    """of a segmented image: sides of the patient to which x, y and z of the mesh point, such as RAS: letters of left or
    right, posterior or anterior, superior or inferior"""
    size: Annotated[Size | None, Field(exclude_if=lambda size: size is None)] = None
    """largest length of edges in the mesh of an image, or of a closed surface (as 'surface' instead of 'file')"""
    grade: Annotated[Annotated[float, Field(ge=1, le=20)] | None, Field(exclude_if=lambda grade: grade is None)] = None
    """ratio of 'size' and the smallest size of cells, which thin walls and strong curvatures have: 1 for cells of one
    size; by default at most 4 in walls, as far as there are not more than four times as many cells"""
    glue: Annotated[Size | None, Field(exclude_if=lambda gap: gap is None)] = None
    """of a CAD file (written as 'cad' instead of 'file'): distance up to which solids that miss each other are
    joined"""
    shell: Annotated[Shell | None, Field(exclude_if=lambda shell: shell is None)] = None
    """of a surface mesh: the shell around it, such as {thickness: 1.2 mm}; its faces are the regions 'outer' and
    'inner'"""
    wall: Annotated[WallThickness | None, Field(exclude_if=lambda wall: wall is None)] = None
    """of a lumen (written as 'lumen' instead of 'file'): thickness of the wall around it, such as 1.5 mm, or a table
    along it, such as {distance: [0 mm, 80 mm], thickness: [2 mm, 1.4 mm]}; regions are 'wall', 'inner', 'outer' and
    the ends"""
    ends: Annotated[
        Mapping[Name, End], OR_OPEN, Field(exclude_if=lambda ends: not ends, json_schema_extra=also_open)
    ] = {}
    """of a lumen: open, or the places of ends by the names of their regions, such as {inlet: {at: [0 mm, 0 mm, 0 mm]}}
    or, cut by a plane, {inlet: {at: […], normal: [0, 0, -1]}}; the others are end-1, end-2, …, the largest first"""
    layers: Annotated[int, Field(ge=1, le=20, exclude_if=lambda layers: layers == 2)] = 2
    """of a lumen: layers of cells through its wall"""
    surface_error: Annotated[SurfaceError | None, Field(exclude_if=lambda error: error is None)] = None
    """error of the given surface, whose effect on shape and quantities the certificate reports; of an image by default
    {sd: 0.12 voxels, correlation: a voxel or half of 'size'}"""

    formats: ClassVar[tuple[str, ...]] = (*FORMATS, *IMAGES, *SURFACES, *CADS, CENTRELINE)
    sources: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "file": (),
        "cad": ("size",),
        "image": ("labels", "size"),
        "surface": ("unit", "size"),
        "surfaces": ("unit", "size"),
        "lumen": ("wall", "size"),
    }

    _interfaces: tuple[tuple[str, str], ...] = PrivateAttr(default=())

    @property
    def may_be_cut(self) -> bool:
        """True if nodes of different parts may coincide, since the job has interfaces."""
        return bool(self._interfaces)

    @property
    def interfaces(self) -> tuple[tuple[str, str], ...]:
        """Regions or labels between which the job has interfaces."""
        return self._interfaces

    def cut(self, interfaces: tuple[tuple[str, str], ...]) -> Self:
        """Return the mesh of a job with interfaces between pairs of regions or labels."""
        mesh = self.model_copy()
        mesh._interfaces = interfaces
        return mesh

    @property
    def is_surface(self) -> bool:
        """True if the mesh is made from a closed surface; a .vtk file without a size of cells is a mesh."""
        return super().is_surface and (self.size is not None or suffix_of(self.file) not in MESHES)

    @property
    def files(self) -> tuple[str, ...]:
        """All files from which the mesh is made."""
        main = tuple(file for group in self.surfaces.values() for file in group) or (self.file,)
        return main + tuple(file for group in self.faces.values() for file in group)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """JSON schema in which labels of images and of arrays are one key."""
        json_schema = super().__get_pydantic_json_schema__(schema, handler)
        properties = handler.resolve_ref_schema(json_schema)["properties"]
        if "array_labels" in properties:
            arrays = [kind for kind in properties.pop("array_labels")["anyOf"] if kind.get("type") != "null"]
            described = properties["labels"]
            text = f"{described.pop('description')}; of a mesh file {{array: material, names: {{plaque: 2}}}}"
            properties["labels"] = {"description": text, "anyOf": [described, *arrays]}
        return json_schema

    @model_validator(mode="before")
    @classmethod
    def _labels_of_array(cls, data: Any) -> Any:
        """Distinguish labels of a mesh, which name an array, from an image's, which are numbers by region."""
        labels = data.get("labels") if isinstance(data, Mapping) else None
        if not isinstance(labels, Mapping) or not isinstance(labels.get("array"), str) or "image" in data:
            return data
        return {key: value for key, value in data.items() if key != "labels"} | {"array_labels": labels}

    @model_validator(mode="before")
    @classmethod
    def _surfaces_are_files(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not data.get("surfaces"):
            return data
        given = data["surfaces"]
        first = next(iter(given.values())) if isinstance(given, Mapping) else None
        first = first[0] if isinstance(first, list | tuple) and first else first
        if not isinstance(first, str):
            raise Problems((("surfaces",), "must be names of regions and their files, such as {body: body.stl}"))
        if others := [key for key in ("file", *_OTHER_SOURCES) if key in data and data[key] != first]:
            raise Problems((("surfaces",), f"is given together with '{others[0]}': a mesh is made from one of them"))
        return {**data, "file": first}

    @classmethod
    def _place_written(cls, place: KeyPath, data: Any) -> KeyPath:
        if place[:1] == ("array_labels",):
            return ("labels", *place[1:])
        surfaces = data.get("surfaces") if isinstance(data, Mapping) and "file" not in data else None
        if place[:1] == ("file",) and isinstance(surfaces, Mapping):
            return ("surfaces", *list(surfaces)[:1], *place[1:])
        return super()._place_written(place, data)

    @field_validator("surfaces", "faces")
    @classmethod
    def _check_surfaces(cls, surfaces: Mapping[str, tuple[str, ...]], info: ValidationInfo) -> Mapping[str, Any]:
        for name, files in surfaces.items():
            if name in RESERVED:
                raise Problems(((name,), "is the name of another region; choose another"))
            if not files:
                raise Problems(((name,), "has no file"))
            for file in files:
                if suffix_of(file) not in SURFACES:
                    raise Problems(((name,), f"{shown(file)} is not a surface; the suffixes are {', '.join(SURFACES)}"))
                try:
                    cls._check_file(file, info)
                except ValueError as error:
                    raise Problems(((name,), str(error))) from None
        return surfaces

    def _contradictions(self, info: ValidationInfo) -> Faults:
        yield from super()._contradictions(info)
        if self.geometry_degree is not None and self.is_partitioned:
            text = "is the degree of the partitioned mesh; pass it to 'hpcinv mesh partition' as --geometry-degree"
            yield ("geometry_degree",), text
        yield from self._faults_of_kind()
        yield from self._faults_of_labels()
        if self.is_image and not self.labels:
            yield ("labels",), "is needed: the numbers of the voxels of each region, as {liver: 5}"
        if self.is_cad and (suffix_of(self.file) == ".brep") != ("unit" in self.model_fields_set):
            stated = "is needed: BREP files do not have one"
            yield ("unit",), stated if "unit" not in self.model_fields_set else "is in the file already; leave it out"
        yield from self._faults_of_vessel()
        if self._is_meshed and self.size is None and not self.kind.reads_surface:
            yield ("size",), "is needed: the largest length of edges, as 5 mm"

    @property
    def kind(self) -> BodyKind:
        return KINDS[next(iter(self.sections_of_kind), SOLID.name)]

    @property
    def sections_of_kind(self) -> dict[str, Shell]:
        """The section that says the kind of the body, by its key; a solid has none."""
        given = {name: getattr(self, name, None) for name in KINDS}
        return {name: section for name, section in given.items() if section is not None}

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Regions of cells that the section of the kind names."""
        return tuple(name for section in self.sections_of_kind.values() for name in section.layers)

    @property
    def _is_meshed(self) -> bool:
        return self.is_image or self.is_surface or self.is_cad or self.wall is not None

    def _faults_of_kind(self) -> Faults:
        """Yield the keys that belong to other kinds of files."""
        is_read = suffix_of(self.file) in MESHES and not self.is_partitioned
        meshed = "is for CAD files, images and surfaces only"
        for is_kind, keys, text in (
            (self.is_image, ("labels", "orientation", "neighbours"), "is for segmented images only"),
            (is_read, ("array_labels", "faces"), "is for mesh files that are read whole"),
            (self.is_cad, ("glue",), "is for CAD files only"),
            (self._is_meshed, ("size",), f"{meshed}; give a generator's among its 'parameters'"),
            (self._is_meshed, ("grade",), meshed),
        ):
            stated = [key for key in keys if key in self.model_fields_set and getattr(self, key) not in (None, {}, ())]
            yield from (((key,), text) for key in stated if not is_kind)

    def _faults_of_vessel(self) -> Faults:
        is_centreline = suffix_of(self.file) == CENTRELINE
        if self.wall is None:
            if is_centreline:
                yield (), "a table of centrelines is given as 'lumen', with the 'wall' around it"
            yield from (((key,), "is for a 'lumen' only") for key in ("ends", "layers") if key in self.model_fields_set)
            return
        yield from self._faults_of_lumen(is_centreline=is_centreline)

    def _faults_of_lumen(self, *, is_centreline: bool) -> Faults:
        if not (self.is_image or self.is_surface or is_centreline):
            kinds = f"an image ({', '.join(IMAGES)}), a surface ({', '.join(SURFACES)}) or a table ({CENTRELINE})"
            yield ("lumen",), f"must be {kinds}"
        if is_centreline and "unit" not in self.model_fields_set:
            yield ("unit",), "is needed: tables of centrelines do not have one"
        for key in ("neighbours", "surfaces", "shell", "glue", "grade"):
            if key in self.model_fields_set and getattr(self, key):
                yield (key,), "is not valid with a lumen"
        for name in {WALL, INNER, OUTER, *RESERVED} & self.ends.keys():
            yield ("ends", name), "is the name of another region; choose another"

    def _faults_of_labels(self) -> Faults:
        names: dict[int | str, str] = {}
        for key, labels in (("labels", self.labels), ("neighbours", self.neighbours)):
            for name, numbers in labels.items():
                if name in RESERVED or (key == "neighbours" and name in self.labels):
                    yield (key, name), "is the name of another region; choose another"
                for number in numbers:
                    if isinstance(number, str) and suffix_of(self.file) != ".dcm":
                        yield (key, name), f"must be numbers, not {shown(number)}: only DICOM segments have names"
                    if (other := names.setdefault(number, name)) != name:
                        yield (key, name), f"has the number {number}, which '{other}' has too"


Turn = Annotated[
    float,
    Quantity("", at_least=-1.5707963267948968, at_most=1.5707963267948968, remedy="write degrees as '60 deg'"),
]


class Motion(Spec):
    """A rigid motion: a rotation about an axis, then a displacement."""

    rotate: Turn = 0.0
    """angle, by the right-hand rule"""
    axis: Triple[float] = (0.0, 0.0, 1.0)
    """direction of the axis, of any length"""
    about: Triple[Length] = (0.0, 0.0, 0.0)
    """a point on the axis, in the unloaded body"""
    move: Triple[Length] = (0.0, 0.0, 0.0)
    """displacement of that point"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not any(self.axis):
            yield ("axis",), "must not be zero"


class Support(Spec):
    """Prescribed displacement on a region: zero for the components in ``fix``, by formulas, or a rigid motion, which is
    given or follows from a force and a moment.

    ``fix: [normal]`` lets a region slide: no motion along the normal of the given mesh, at each node; with 'surface'
    its nodes stay on a curved surface, however far they move.
    """

    alternatives: ClassVar[tuple[str, ...]] = ("fix", "displacement", "motion", "remote")

    region: str
    """physical group of the mesh, a name from 'regions', or 'boundary' for the whole of it"""
    fix: ListOf[Literal["x", "y", "z", "normal"]] | None = None
    """fixed components, some of x, y, z and normal, the normal of the given mesh"""
    normal: Triple[float] | None = None
    """direction that 'normal' stands for, of any length; by default the normal of each node's surface"""
    surface: Expression | None = Field(default=None, exclude_if=lambda surface: surface is None)
    """smooth surface on which the nodes stay with 'fix: [normal]', in both bodies: a formula of x, y, z in the given
    mesh that is zero on it, or 'sphere' or 'cylinder' for the one nearest to the region's nodes"""
    displacement: Triple[Expression | None] | None = None
    """three formulas of x, y, z in the given mesh, with null for a free component"""
    motion: Motion | None = None
    """rigid motion of the region from the unloaded to the loaded body, in all three components"""
    remote: RemoteLoad | None = Field(default=None, exclude_if=lambda remote: remote is None)
    """force and moment on the region, which moves as a rigid body"""
    constants: Mapping[str, AnyQuantity] = {}
    """values of further names in the formulas"""
    case: Name | None = None
    """load case (a name from 'load_cases') of the displacement; by default the first"""
    hinge: bool = Field(default=False, exclude_if=lambda hinge: not hinge)
    """of the edge of a shell: hold its midsurface only, about which the shell may turn"""

    @property
    def moves(self) -> bool:
        """True if the region is moved, not only held."""
        return self.fix is None

    @property
    def held(self) -> frozenset[AxisName]:
        """The components that the support determines."""
        if self.motion is not None or self.remote is not None:
            return frozenset(AXES)
        if self.displacement is None:
            return frozenset(axis for axis in AXES if axis in (self.fix or ()))
        return frozenset(a for a, formula in zip(AXES, self.displacement, strict=True) if formula is not None)

    @property
    def slides(self) -> bool:
        """True if the region is fixed along its normal, which need not be an axis."""
        return "normal" in (self.fix or ())

    @property
    def fitted_surface(self) -> str | None:
        """Name of the kind of surface that is fitted to the region; ``None`` for others."""
        name = self.surface.source.strip() if self.surface is not None else ""
        return name if name in FITTED_SURFACES else None

    @property
    def components(self) -> list[str]:
        """Names of what is prescribed, for messages."""
        return [*sorted(self.held), *(["normal"] if self.slides else [])]

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The constants of the formulas, or the numbers of a motion or a remote load, by place.

        Constants of a surface do not vary.
        """
        if self.surface is not None:
            return {}
        if self.remote is not None:
            return {("remote", *place): number for place, number in self.remote.numbers().items()}
        if self.motion is not None:
            vectors = (("about", self.motion.about), ("move", self.motion.move))
            numbers: dict[KeyPath, Number | str] = {("motion", "rotate"): Number(self.motion.rotate, Dimension())}
            for key, vector in vectors:
                numbers |= {("motion", key, i): Number(x, LENGTH) for i, x in enumerate(vector)}
            return numbers
        return {("constants", name): Number(value, None) for name, value in self.constants.items()}

    def number_replaced(self, place: KeyPath, number: float) -> Self:
        """A copy with another number (SI) at one of the places of `numbers`."""
        if self.motion is not None:
            key = str(place[1])
            moved = replace_scalar(getattr(self.motion, key), place[2:], number)
            return self.model_copy(update={"motion": self.motion.model_copy(update={key: moved})})
        return self.model_copy(update={"constants": replace_scalar(self.constants, place[1:], number)})

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if [self.fix, self.displacement, self.motion, self.remote].count(None) != 3:
            parts = "'fix' (components), 'displacement' (formulas), 'motion' (rigid) and 'remote' (force and moment)"
            yield (), f"needs exactly one of {parts}"
        elif not self.components:
            yield (), "prescribes no component; remove it or name some of x, y, z, normal"
        elif self.displacement is not None:
            yield from faults_with_constants("displacement", self.displacement, self.constants, COORDINATES, LENGTH)
        else:
            if self.case is not None and not self.moves:
                yield ("case",), "is not valid without 'displacement': what is fixed is fixed in every load case"
            if self.constants and (self.surface is None or self.fitted_surface):
                yield ("constants",), "are not valid without a formula: 'displacement' or 'surface'"
        if self.surface is not None:
            yield from self._surface_faults()
        if self.normal is not None:
            yield from self._normal_faults(self.normal)

    def _normal_faults(self, normal: Sequence[float]) -> Faults:
        if not self.slides:
            yield ("normal",), "is valid with 'fix: [normal]' only"
        elif not any(normal):
            yield ("normal",), "must not be zero"

    def _surface_faults(self) -> Faults:
        if not self.slides:
            yield ("surface",), "is valid with 'fix: [normal]' only"
        elif self.normal is not None:
            yield ("surface",), "has its own normals: leave 'normal' out"
        elif self.surface is not None and not self.fitted_surface:
            problems = faults_with_constants("surface", [self.surface], self.constants, COORDINATES, None)
            yield from ((where[:1] if where[0] == "surface" else where, text) for where, text in problems)
            if self.surface.names.isdisjoint(AXES):
                yield ("surface",), f"'{self.surface}' does not depend on x, y or z; or name a sphere or cylinder"


def is_of_nodes(quantity: Mapping[str, Any], let: Mapping[str, Any]) -> bool:
    """Return whether a quantity in a summary is a mean or rms of nodes, which depends on where a mesh has them.

    Args:
        let: definitions of names in its formula.
    """
    if quantity.get("on") is None or quantity.get("over") is not None or quantity.get("reduce") not in ("mean", "rms"):
        return False
    words, texts = set[str](), [str(quantity["of"])]
    while texts:
        new_words = set(re.findall(r"[A-Za-z_]\w*", texts.pop())) - words
        words |= new_words
        texts += [str(let[name]) for name in new_words & let.keys()]
    return words.isdisjoint(FIELDS)


type QuantityValue = float | list[float]
"""value (SI) of a quantity of interest: a number or three components"""


class QuantityOfInterest(Spec):
    """A reported result: the displacement or a formula at a point, a formula reduced over a region, the volume of a
    cavity, or the force or moment of the supports of a region.

    Formulas can use the reference position X, Y, Z, the current position x, y, z, the displacement ux, uy, uz, the
    volume ratio J, the Cauchy stress sxx, syy, szz, sxy, syz, sxz, stress measures such as p = -(sxx + syy + szz)/3 and
    von_mises, and the energy per reference volume; on a surface also its outward unit normal nx, ny, nz in the current
    body; with prestrain its stress-free stretch F0xx, F0xy, … F0zz, and the stress that it causes alone in the
    reference shape, prestrain_sxx, …, prestrain_p, prestrain_von_mises.
    """

    alternatives: ClassVar[tuple[str, ...]] = ("at", "on", "region", "cavity")

    name: Name
    """its name in the summary"""
    of: Expression
    """'displacement' (the vector, at a point), 'reaction' (the force that the supports of a region exert on the body),
    'reaction_moment' (its moment), 'contact_force', 'contact_area', 'contact_penetration' (of contact on a region),
    'volume' (of a cavity), 'pressure' (of a cavity where it is unknown), or a formula"""
    at: Triple[Length] | None = None
    """a point in the given mesh"""
    on: str | None = None
    """region over which the formula is reduced: positions over its nodes, other fields over its cells or, if it has
    none, facets; or the region of a support for a reaction"""
    cavity: Name | None = Field(default=None, exclude_if=lambda cavity: cavity is None)
    """cavity (a name from 'cavities') of a volume or pressure"""
    reduce: Literal["max", "min", "mean", "max_abs", "rms", "integral"] | None = None
    """reduction of the values on a region to one value; mean and rms of positions are of the nodes, all with the same
    weight, unless 'over' makes them means over volume or area; max and min of stresses, J and energy are over the
    quadrature points, which lie inside the cells or facets"""
    over: Literal["reference", "current"] | None = None
    """body over whose volume or area an integral, mean or rms is taken; by default the reference body for means and rms
    of stresses. Body of a cavity's volume; by default the current one"""
    state: Name | None = Field(default=None, exclude_if=lambda state: state is None)
    """state of the body in which it is evaluated; by default each loaded one, under names such as NAME-STATE"""
    from_state: Name | None = Field(default=None, exclude_if=lambda state: state is None)
    """loaded state whose value is subtracted: a displacement is then the way of the point from that state; 'from' is
    the same key"""
    about: Triple[Length] | None = Field(default=None, exclude_if=lambda about: about is None)
    """reference point of a reaction_moment; by default the origin"""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        json_schema = super().__get_pydantic_json_schema__(schema, handler)
        properties = handler.resolve_ref_schema(json_schema)["properties"]
        properties["region"] = {"type": "string", "description": "the same as 'on', which YAML 1.1 reads as true"}
        properties["from"] = {"type": "string", "description": "the same as 'from_state'"}
        return json_schema

    @model_validator(mode="before")
    @classmethod
    def _take_other_names(cls, data: Any) -> Any:
        """Accept ``region`` for ``on``, which programs for YAML 1.1 read as true, and ``from`` for ``from_state``."""
        if not isinstance(data, Mapping):
            return data
        same = {"region": "on", "from": "from_state"}
        for other, key in same.items():
            if other in data and key in data:
                raise Problems(((other,), f"is the same key as '{key}'; give one of them"))
        return {same.get(key, key): value for key, value in data.items()}

    @property
    def unit(self) -> str:
        """SI unit of its values; empty for pure numbers, for integrals, and where only the mesh defines it."""
        if self.is_reaction:
            return REACTIONS[self.of.source.strip()]
        return "" if (dimension := self.dimension) is None else dimension.unit

    def unit_of_integral(self, dimensions: int) -> str:
        """Return the SI unit of an integral over a volume (3 ``dimensions``) or an area (2)."""
        dimension = self.of.check(POSITIONS | FIELDS)
        length, *others = dimension if isinstance(dimension, Dimension) else Dimension()
        return Dimension(length + dimensions, *others).unit

    @property
    def is_displacement(self) -> bool:
        return self.of.source.strip() == "displacement"

    @property
    def is_of_cavity(self) -> bool:
        """True if it is the volume or the pressure of a cavity."""
        return self.of.source.strip() in CAVITY_QUANTITIES

    @property
    def is_reaction(self) -> bool:
        """True if it is the force or the moment of supports, or a result of a contact."""
        return self.of.source.strip() in REACTIONS

    @property
    def is_contact(self) -> bool:
        """True if it is the force, the area or the largest penetration of a contact."""
        return self.of.source.strip() in CONTACTS

    @property
    def is_moment(self) -> bool:
        return self.of.source.strip() == "reaction_moment"

    @property
    def is_vector(self) -> bool:
        return self.is_displacement or (
            self.is_reaction and not self.of.source.strip().endswith(("area", "penetration"))
        )

    @property
    def fields(self) -> frozenset[str]:
        """Names of solution fields in the formula."""
        return self.of.names & FIELDS.keys()

    @property
    def needs_surface(self) -> bool:
        """True if the formula has the normal of a surface."""
        return not self.of.names.isdisjoint(NORMALS)

    @property
    def prestrain_names(self) -> list[str]:
        """Names in the formula that only bodies with prestrain have."""
        return [name for name in (*PRESTRAIN_STRESSES, *PRESTRAIN_COMPONENTS) if name in self.of.names]

    @property
    def dimension(self) -> Dimension | None:
        """Dimension of a displacement or formula; ``None`` if numbers leave it open, or only the mesh defines it."""
        if self.is_displacement:
            return LENGTH
        if self.is_of_cavity:
            return CAVITY_QUANTITIES[self.of.source.strip()]
        dimension = self.of.check(POSITIONS | FIELDS)
        # The dimension of an integral depends on whether its region is a volume or a surface.
        return dimension if isinstance(dimension, Dimension) and self.reduce != "integral" else None

    @property
    def uses_quadrature(self) -> bool:
        """True if it is reduced over the volume or area of a region, rather than over its nodes."""
        return self.on is not None and (self.over is not None or bool(self.fields))

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.about is not None and not self.is_moment:
            yield ("about",), "is valid only with 'of: reaction_moment'"
        if self.is_of_cavity:
            yield from self._faults_of_cavity()
        elif self.cavity is not None:
            yield ("cavity",), "is valid only with 'of: volume' and 'of: pressure'"
        elif self.is_reaction:
            yield from self._faults_of_reaction()
        else:
            yield from self._faults_of_formula()

    def _faults_of_cavity(self) -> Faults:
        source = self.of.source.strip()
        if self.cavity is None:
            yield ("cavity",), f"is needed for a {source}: a name from 'cavities'"
        for field in ("at", "on", "reduce", *(["over"] if source == "pressure" else [])):
            if getattr(self, field) is not None:
                yield (field,), f"is not valid with the {source} of a cavity"

    def _faults_of_reaction(self) -> Faults:
        if self.on is None:
            yield ("on",), f"is needed for a reaction: the region of {'a contact' if self.is_contact else 'a support'}"
        for field in ("at", "reduce", "over"):
            if getattr(self, field) is not None:
                yield (field,), "is not valid with a reaction, which is a sum over the region of a support"

    def _faults_of_place(self) -> Faults:
        is_on_region = self.on is not None
        if (self.at is not None) == is_on_region:
            yield (), "needs exactly one of 'at' (a point) and 'on' (a region)"
        elif is_on_region and self.reduce is None:
            yield ("reduce",), "is needed on a region: max, min, mean, max_abs, rms or integral"
        elif not is_on_region and self.reduce is not None:
            yield ("reduce",), "is not valid at a point"
        if self.over is None and is_on_region and self.reduce == "integral":
            yield ("over",), "is needed for an integral: over the 'reference' or the 'current' body"
        elif self.over is not None and (not is_on_region or self.reduce in ("max", "min", "max_abs")):
            yield ("over",), "is valid only with an integral, a mean or rms on a region"

    def _faults_of_formula(self) -> Faults:
        yield from self._faults_of_place()
        if self.at is not None and self.needs_surface:
            yield ("of",), "has the normal of a surface: name a region of the boundary with 'on', not 'at'"
        if self.is_displacement and self.on is not None:
            yield ("of",), "is a vector; use a formula on a region, such as norm(ux, uy, uz)"
        elif not self.is_displacement:
            yield from faults([(("of",), self.of)], POSITIONS | FIELDS, None)
