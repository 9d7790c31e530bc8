"""Jobs that differ from one job in some sections: what they have in common is read once."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from hpcinv.base.quantity.schema import Faults
from hpcinv.job.contradictions import CONTRADICTIONS
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import SECTIONS, Job, keep_source, parse, unknown_references
from hpcinv.job.preamble import Preamble
from hpcinv.job.region_references import REFERENCES, References
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import numbers_of, reuse_group_of
from hpcinv.job.section_memo import SectionMemo
from hpcinv.job.varied_part import ReadWhole, copied, has_parts, is_read_alone, reader, varied


class _Template(NamedTuple):
    """The last content that was read, its sections before what follows from several, and what they were read with.

    Attributes:
        following: memory of what follows from several sections.
    """

    content: Mapping[str, Any]
    sections: Job
    context: Mapping[str, Any]
    following: SectionMemo


class JobVariants:
    """Reader of contents of one job file that share the sections in which they do not differ.

    Args:
        path: of the file; relative paths start from its directory.
        untrusted: as in `hpcinv.job.job.load`.
    """

    def __init__(self, path: Path, *, untrusted: bool) -> None:
        self.path, self.untrusted = path, untrusted
        self._templates: dict[frozenset[str], _Template] = {}
        self._known = SectionData()

    def job(self, content: Mapping[str, Any]) -> Job:
        """Return the job of a content, the same as `hpcinv.job.job.parse`.

        Of a content with the sections of an earlier one, those that are other objects are read.

        Raises:
            JobError: as of `hpcinv.job.job.parse`.
        """
        names = frozenset(content)
        template = self._templates.get(names)
        if template is not None and (read := self._varied(template, content)) is not None:
            job, sections = read
            self._templates[names] = template._replace(content=content, sections=sections)
            return job
        context: dict[str, Any] = {}
        job = parse(content, self.path, untrusted=self.untrusted, context=context)
        sections = context.pop(SECTIONS)
        keep_source(sections, self.path, content, untrusted=self.untrusted)
        self._templates[names] = _Template(content, sections, context, SectionMemo())
        return job

    def identity(self, job: Job) -> tuple[str, str, tuple[float, ...], Path]:
        """Return the content key, the reuse group and the numbers of a job, and the directory of its mesh file."""
        known = self._known
        home = known.memo.of("home", lambda job: job.resolve(job.mesh.file).absolute().parent, job)
        return content_key(job, known), reuse_group_of(job, known), numbers_of(job, known), home

    def _varied(self, template: _Template, content: Mapping[str, Any]) -> tuple[Job, Job] | None:
        """Return the job of a content, and its sections before what follows from several.

        Return ``None`` if all of it must be read: it has a fault, which `parse` names, or another section depends on
        what differs.
        """
        changed = [key for key, value in content.items() if value is not template.content[key]]
        if not all(map(_is_read_alone, changed)):
            return None
        context = {**template.context}
        try:
            read = {key: _varied_section(template, key, content, context) for key in changed}
            job = sections = copied(template.sections, read)
            if following := template.following.of("following", Job._following_sections, job):
                job = copied(job, following)
            job._data = content
            has_faults = any(self._known.memo.each_of(_CHECKS, job))
        except Exception:  # of a plugin, too
            return None
        return None if has_faults else (job, sections)


def _has_any(faults: Callable[[Job], Faults], job: Job) -> bool:
    return next(faults(job), None) is not None


def _has_unknown(references: Callable[[Job], References], job: Job) -> bool:
    return next(unknown_references(job, references(job)), None) is not None


_CHECKS = (
    *(partial(_has_any, contradictions) for contradictions in CONTRADICTIONS),
    *(partial(_has_unknown, references) for references in REFERENCES),
)


@cache
def _is_read_alone(section: str) -> bool:
    """Return whether a section can be read without others, and defines nothing for them."""
    return section not in Preamble.model_fields and is_read_alone(Job, section)


def _varied_section(template: _Template, name: str, content: Mapping[str, Any], context: dict[str, Any]) -> Any:
    """Return a section of another content; of a section with parts, only the values are read that differ."""
    if has_parts(Job, name):
        with suppress(ReadWhole):
            return varied(getattr(template.sections, name), template.content[name], content[name], context)
    return reader(Job, name).validate_python(content[name], context=context)
