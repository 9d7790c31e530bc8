"""Files with nodes and cells that a job reads, and what it may say of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.files.names import FilePath, exists, is_file
from hpcinv.base.files.untrusted import applies
from hpcinv.base.mesh_formats import FORMATS as MESHES
from hpcinv.base.mesh_formats import mesh_fault
from hpcinv.base.quantity.quantity import LengthUnit, Size
from hpcinv.base.quantity.schema import (
    Faults,
    KeyPath,
    ListOf,
    Problems,
    Spec,
    collected,
    raise_if_any,
    shown,
)
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.body_kinds import SOLID, BodyKind
from hpcinv.job.mesh_generators import ParameterValue, converted_parameters, is_generator, read_parameters

CUT = "cut"
"""region of an image's mesh where a label ends with the image"""
RESERVED = ("boundary", "outside", CUT, "cavity")
"""names that regions of images and surfaces have by themselves"""
FORMATS = (".py", ".geo", *MESHES)
"""suffixes of generators and meshes"""
IMAGES = (".nii", ".gz", ".nrrd", ".mha", ".mhd", ".vti", ".dcm")
"""suffixes of segmented images"""
SURFACES = (".stl", ".ply", ".obj", ".vtp", ".vtk")
"""suffixes of surfaces of triangles"""
CADS = (".step", ".stp", ".iges", ".igs", ".brep")
"""suffixes of CAD files"""
OTHER_SOURCES = "image", "surface", "cad", "lumen"
"""keys of a mesh that stand for ``file``"""


def directory_of(info: ValidationInfo) -> Path:
    """Directory to which paths in the job are relative."""
    directory: Path = (info.context or {}).get("directory", Path())
    return directory


def _sources_in(data: Any) -> list[str]:
    return [key for key in OTHER_SOURCES if isinstance(data, Mapping) and key in data]


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
