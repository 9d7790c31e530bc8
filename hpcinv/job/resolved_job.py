"""The whole job as data from which its keys are made: choices resolved, definitions in formulas, files by content.

A key leaves out only what its table of sections names, each with the reason: a new section counts in all keys.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import IO, Any

from hpcinv.base.files.names import NamesFile
from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.mesh_formats.partitioned import read_header
from hpcinv.base.quantity.expressions import LET
from hpcinv.base.quantity.plugins import inputs_of
from hpcinv.base.quantity.schema import Spec, metadata_in
from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.job.section_memo import SectionMemo

ENTRIES = (*Job.model_fields, "directions", "inputs_of_plugins")
"""names of what a resolved job may have, in their order"""
WITH_DEFINITIONS = {LET: True}
"""Serialization context in which formulas include the definitions that they use."""

_HEADERS = (".mhd", ".mha", ".nrrd", ".nhdr")
"""suffixes of images whose header may name other files for the voxels"""
_PIECE = 2**20  # bytes that are read at once; raised, files take more memory
_LONGEST_HEADER = 2**20
"""bytes that are searched for such names; a name that comes later would not count"""


def _update(digest: Any, file: IO[bytes]) -> None:
    """Add the rest of a file, in pieces: it may be larger than the memory."""
    while piece := file.read(_PIECE):
        digest.update(piece)


def file_digest(path: Path) -> str:
    """SHA-256 of a file, including the files in which it says that its data are: XDMF files, and headers of images.

    For a partitioned mesh it is the hash of the header, which contains checksums of all arrays.
    """
    mesh_format = FORMATS.get(suffix_of(path))
    if mesh_format and mesh_format.is_partitioned:
        return read_header(path).digest()
    digest = hashlib.sha256()
    advice = "Keep the .h5 file next to the .xdmf file." if mesh_format else "Is the file readable?"
    with _mesh_errors(path, advice):
        with admitted(path).open("rb") as file:
            head = file.read(_LONGEST_HEADER)
            digest.update(head)
            names = sorted(mesh_format.data_files(path)) if mesh_format else []  # refused before hours of reading
            _update(digest, file)
        for name in names:
            with admitted(path.parent / name, path).open("rb") as file:
                _update(digest, file)
        for voxel_file in dict.fromkeys(_voxel_files(path, head) if suffix_of(path) in _HEADERS else ()):
            digest.update(voxel_file.name.encode())
            with admitted(voxel_file, path).open("rb") as voxels:
                digest.update(hashlib.file_digest(voxels, "sha256").digest())
    return digest.hexdigest()


@contextmanager
def _mesh_errors(path: Path, advice: str) -> Iterator[None]:
    """Context in which a file, or one that it names, is read; what is wrong with them becomes ``MeshError``."""
    try:
        yield
    except Fault as fault:
        raise MeshError(f"{path}: {fault.text}", "Convert it to .msh or .vtu.") from None
    except (OSError, ValueError) as error:
        missing = getattr(error, "filename", None) or path
        if isinstance(error, FileNotFoundError) and str(missing) == str(path):
            raise MeshError(f"{path}: no such file", "Paths of a job start from its directory.") from None
        raise MeshError(f"{path}: {missing} cannot be read: {getattr(error, 'strerror', error)}", advice) from None


def _voxel_files(path: Path, header: bytes) -> list[Path]:
    """Return the files next to the header of an image that hold its voxels: one, a list, or a numbered series."""
    named = re.search(
        rb"^[ \t]*(?:ElementDataFile\s*=|data ?file:)[ \t]*([^\r\n]*)", header, re.IGNORECASE | re.MULTILINE
    )
    if named is None or named[1].strip().upper() == b"LOCAL":
        return []
    words = named[1].split()
    if words and words[0].upper() == b"LIST":
        names = [line.strip() for line in header[named.end() :].splitlines()]
        return [file for name in names if name and (file := path.parent / os.fsdecode(name)).is_file()]
    if (file := path.parent / os.fsdecode(named[1].strip())).is_file():
        return [file]
    if words and b"%" in words[0]:  # a series such as slice%03d.raw 1 99 1
        pattern = re.sub("%[0-9]*d", "*", glob.escape(os.fsdecode(words[0])))
        return sorted(file for file in path.parent.glob(pattern) if file.is_file())
    return []


class EntryTexts:
    """JSON texts of the entries of a mapping.

    Args:
        texts: name of each entry, and its text for a job; empty if the job does not have the entry.
    """

    def __init__(self, *texts: tuple[str, Callable[[SectionData, Job], str]]) -> None:
        self.texts = texts


class SectionData:
    """JSON data of jobs of one file, with files by their content; sections that are the same in several are read once.

    Args:
        digest: SHA-256 of a file.
    """

    def __init__(self, digest: Callable[[Path], str] = file_digest) -> None:
        self._digest, self.memo = cache(digest), SectionMemo()
        self._functions: dict[EntryTexts, Sequence[Callable[[Job], str]]] = {}

    def digest(self, path: Path) -> str:
        """Return the SHA-256 of a file, which is read once."""
        return self._digest(path)

    def entry(self, job: Job, name: str) -> Any:
        """Return one of the `ENTRIES` of a job; ``None`` if the job does not have it. It must not be changed.

        Raises:
            MeshError: a file cannot be read.
        """
        return self.memo.of(name, partial(_entry, self, name), job)

    def joined(self, job: Job, texts: EntryTexts) -> str:
        """Return a mapping as JSON text, of the texts of its values."""
        if texts not in self._functions:
            self._functions[texts] = [partial(_named, self, *text) for text in texts.texts]
        return f"{{{', '.join(filter(None, self.memo.each_of(self._functions[texts], job)))}}}"


def _named(known: SectionData, name: str, text: Callable[[SectionData, Job], str], job: Job) -> str:
    return f'"{name}": {value}' if (value := text(known, job)) else ""


def _entry(known: SectionData, name: str, job: Job) -> Any:
    if name == "directions":
        return list(job.directions)
    if name == "inputs_of_plugins":
        inputs = [inputs_of(job.resolve(plugin)) for plugin in job.plugins]
        return inputs if any(inputs) else None
    data = known.memo.of(("section", name), partial(_section, known, name), job)
    if name == "mesh":
        return data | {"unit": job.mesh.metres}  # of an image by default mm
    if name == "expected_shape" and job.expected_shape is not None and data is not None:
        return data | {"unit": job.expected_shape.metres}
    return data | _spaces(known, job) if name == "discretisation" else data


def _section(known: SectionData, name: str, job: Job) -> Any:
    """Return the data of a section; ``None`` if it is left out."""

    def content_of(file: str) -> str:
        path = job.resolve(file)
        return f"{known.digest(path)} {suffix_of(path)}".rstrip()

    data = job.model_dump(mode="json", exclude_none=True, context=WITH_DEFINITIONS, include={name}).get(name)
    if data is None:
        return None
    if _is_file(Job, name):
        return _contents(data, content_of)
    _replace_files(getattr(job, name), data, content_of)
    return data


def resolved(job: Job, left_out: Mapping[str, str], known: SectionData | None = None) -> dict[str, Any]:
    """Return the sections of a job as JSON data, with automatic choices made, and files by their content.

    Args:
        left_out: reasons by section, or key of a section such as ``mesh.partition``; their files are not read.
        known: data of sections of earlier jobs of the same file.

    Raises:
        MeshError: a file cannot be read.
    """
    known = known or SectionData()
    entries = ((name, known.entry(job, name)) for name in ENTRIES if name not in left_out)
    return {name: without(name, entry, left_out) for name, entry in entries if entry is not None}


def _moves(job: Job) -> bool:
    """Return whether later solves are on the body that the first one finds."""
    return any(solve.mesh is not None for solve in job.plan)


def _spaces(known: SectionData, job: Job) -> dict[str, Any]:
    spaces: dict[str, Any] = {
        "formulation": "mixed" if job.is_mixed else "displacement",
        "pressure": job.pressure_degree,
    }
    if job.is_mixed and (layerings := job.layerings):  # each layer has its own pressures
        spaces["layers"] = [layering.as_data() for layering in layerings]
    if job.discretisation.displacement > 1 and known.memo.of("moves", _moves, job):
        # Later solves are on the recovered body. Earlier versions moved the nodes of its given cells only.
        spaces["recovered_geometry"] = job.discretisation.displacement
    return spaces


def _replace_files(part: Any, data: Any, content_of: Callable[[str], str]) -> None:
    """Replace the paths of files in the data of a part of a job by their content."""
    match part:
        case Spec():
            files = _files_of(type(part))
            for name, entry in data.items():
                if name in files:
                    data[name] = _contents(entry, content_of)
                elif isinstance(entry, dict | list):
                    _replace_files(getattr(part, name, None), entry, content_of)
        case Mapping():
            for name, entry in part.items():
                if name in data:
                    _replace_files(entry, data[name], content_of)
        case tuple() if len(part) == len(data):
            for entry, entry_data in zip(part, data, strict=True):
                _replace_files(entry, entry_data, content_of)


def _contents(paths: Any, content_of: Callable[[str], str]) -> Any:
    """Return the contents of files, in the structure of their paths; data of another kind stay."""
    match paths:
        case str():
            return content_of(paths)
        case {}:
            return {name: _contents(entry, content_of) for name, entry in paths.items()}
        case [str(), *_]:
            return [content_of(path) for path in paths]
    return paths


@cache
def _is_file(kind: type[Spec], name: str) -> bool:
    field = kind.model_fields[name]
    return metadata_in(NamesFile, field.annotation, *field.metadata) is not None


@cache
def _files_of(kind: type[Spec]) -> frozenset[str]:
    """Return the fields of a part that are paths of files."""
    return frozenset(name for name in kind.model_fields if _is_file(kind, name))


def without(name: str, entry: Any, left_out: Container[str]) -> Any:
    """Return an entry of a job without keys that are left out, such as ``mesh.partition``."""
    if not isinstance(entry, dict):
        return entry
    return {key: value for key, value in entry.items() if f"{name}.{key}" not in left_out}
