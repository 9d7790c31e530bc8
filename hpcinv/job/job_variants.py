"""Jobs that differ from one job in some sections: what they have in common is read once."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationInfo

from hpcinv.base.quantity.schema import Spec
from hpcinv.job.job import SECTIONS, Job, keep_source, parse, with_sections
from hpcinv.job.preamble import Preamble


class _Context(NamedTuple):
    """What `with_sections` takes of a validation."""

    context: dict[str, Any]


class _Template(NamedTuple):
    """A content that was read, its sections before what follows from several, and what they were read with."""

    content: Mapping[str, Any]
    sections: Job
    context: Mapping[str, Any]


class JobVariants:
    """Reader of contents of one job file that share the sections in which they do not differ.

    Args:
        path: of the file; relative paths start from its directory.
        untrusted: as in `hpcinv.job.job.load`.
    """

    def __init__(self, path: Path, *, untrusted: bool) -> None:
        self.path, self.untrusted = path, untrusted
        self._templates: dict[frozenset[str], _Template] = {}

    def job(self, content: Mapping[str, Any]) -> Job:
        """Return the job of a content, the same as `hpcinv.job.job.parse`.

        Of a content with the sections of an earlier one, those that are other objects are read.

        Raises:
            JobError: as of `hpcinv.job.job.parse`.
        """
        template = self._templates.get(frozenset(content))
        if template is not None and (job := self._varied(template, content)) is not None:
            return job
        context: dict[str, Any] = {}
        job = parse(content, self.path, untrusted=self.untrusted, context=context)
        self._templates[frozenset(content)] = _Template(content, context.pop(SECTIONS), context)
        return job

    def _varied(self, template: _Template, content: Mapping[str, Any]) -> Job | None:
        """Return the job of a content, or ``None`` if all of it must be read: it has a fault, which `parse` names, or
        another section depends on what differs.
        """
        changed = [key for key, value in content.items() if value is not template.content[key]]
        if not all(map(_is_read_alone, changed)):
            return None
        info = _Context({**template.context})
        try:
            read = {key: _reader(key).validate_python(content[key], context=info.context) for key in changed}
            job = with_sections(template.sections, read, cast(ValidationInfo, info))
            if job is not None:
                keep_source(job, self.path, content, untrusted=self.untrusted)
        except Exception:  # of a plugin, too
            return None
        return job


@cache
def _is_read_alone(section: str) -> bool:
    """Return whether the type of a section is all that is needed to read it, and no other one depends on it then."""
    validators = Job.__pydantic_decorators__.field_validators.values()
    has_own = any(section in validator.info.fields for validator in validators)
    return section in Job.model_fields and section not in Preamble.model_fields and not has_own


@cache
def _reader(section: str) -> TypeAdapter[Any]:
    field = Job.model_fields[section]
    kind: Any = field.annotation
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return TypeAdapter(kind)
    return TypeAdapter(Annotated[kind, *field.metadata] if field.metadata else kind, config=_STRICT)


_STRICT = ConfigDict(strict=Spec.model_config["strict"], allow_inf_nan=Spec.model_config["allow_inf_nan"])
