"""Section ``mesh`` of a job: the given mesh, or the image, surface or CAD file that it is made from."""

from collections.abc import Mapping
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

from hpcinv.base.files.names import NamesFile
from hpcinv.base.mesh_formats import FORMATS as MESHES
from hpcinv.base.quantity.quantity import Size
from hpcinv.base.quantity.schema import (
    Faults,
    KeyPath,
    ListOf,
    Name,
    Problems,
    Spec,
    TextOrTexts,
    shown,
)
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.body_kinds import KINDS, SOLID, BodyKind
from hpcinv.job.lumen import INNER, OR_OPEN, OUTER, WALL, End, WallThickness, also_open
from hpcinv.job.mesh_file import CADS, FORMATS, IMAGES, OTHER_SOURCES, RESERVED, SURFACES, MeshFile, SurfaceError
from hpcinv.job.shell_section import Shell

Label = Annotated[int, Field(ge=1)] | Annotated[str, Field(min_length=1)]
_LABEL = {"anyOf": [{"type": "integer", "minimum": 1}, {"type": "string", "minLength": 1}]}
Labels = Annotated[
    ListOf[Label],
    BeforeValidator(lambda v: [v] if isinstance(v, int | str) else v),
    WithJsonSchema({"anyOf": [*_LABEL["anyOf"], {"type": "array", "items": _LABEL}]}),
]


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
CENTRELINE = ".csv"
"""suffix of a table of centrelines"""


def _not_true(value: object) -> object:
    """Return a value unless it is true or false, which Python takes for 1 and 0."""
    if isinstance(value, bool):
        raise ValueError(f"must be a number, not {shown(value)}")
    return value


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
        if others := [key for key in ("file", *OTHER_SOURCES) if key in data and data[key] != first]:
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
