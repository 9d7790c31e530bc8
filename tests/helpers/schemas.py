"""The JSON Schema of files for editors, as an independent validator understands it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from jsonschema import Draft202012Validator

from hpcinv.base.quantity.schema import Spec
from hpcinv.job.job import Job, json_schema
from hpcinv.studies.study.study_spec import Study
from hpcinv.studies.sweep.sweep_spec import Sweep


@cache
def validator(kind: type[Spec]) -> Draft202012Validator:
    schema = json_schema(kind)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def kind_of(content: Mapping[str, Any]) -> type[Spec]:
    return Study if "series" in content else Sweep if "axes" in content else Job


def refusals(content: Mapping[str, Any]) -> list[str]:
    """What the schema refuses in the content of a file."""
    errors = validator(kind_of(content)).iter_errors(content)
    return [f"{error.json_path}: {error.message[:200]}" for error in errors]
