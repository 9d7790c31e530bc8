"""Job files are YAML 1.2, and what is no YAML is told with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hpcinv.errors import JobError
from hpcinv.loading import read_yaml


def read(tmp_path: Path, text: str) -> dict[str, Any]:
    path = tmp_path / "job.yaml"
    path.write_text(text, encoding="utf-8")
    return read_yaml(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e6", 1e6),
        ("1E-3", 1e-3),
        ("-2.5e+3", -2500.0),
        (".5", 0.5),
        ("1.", 1.0),
        ("010", 10),
        ("0o10", 8),
        ("0xff", 255),
        ("-7", -7),
        (".inf", float("inf")),
        ("-.inf", float("-inf")),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("yes", "yes"),
        ("off", "off"),
        ("12:30:45", "12:30:45"),
        ("2024-01-01", "2024-01-01"),
        ("1_000", "1_000"),
        ("963 kg/m^3", "963 kg/m^3"),
        ("'1e6'", "1e6"),
        ("=", "="),
    ],
)
def test_scalars_are_those_of_yaml_1_2(tmp_path: Path, text: str, value: object) -> None:
    result = read(tmp_path, f"key: {text}")["key"]
    assert result == value
    assert type(result) is type(value)


def test_keys_are_text_whatever_they_look_like(tmp_path: Path) -> None:
    assert read(tmp_path, "on: 1\nyes: 2\n3: 3\nnull: 4\n1e6: 5") == {"on": 1, "yes": 2, "3": 3, "null": 4, "1e6": 5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb:\n  c: 1\n  c: 2\n", "job.yaml:4: 'c' stands twice"),
        ("a: 1\na: 2\n", "job.yaml:2: 'a' stands twice"),
        ("a: [1, 2\nb: 3\n", "job.yaml:2: "),
        ("a: 1\n\tb: 2\n", "job.yaml:2: "),
        ("a: !!python/object:os.system x\n", "job.yaml:1: could not determine a constructor"),
        ("[x, y]: 1\n", "job.yaml:1: a key must be text"),
        ("a: *unknown\n", "job.yaml:1: found undefined alias"),
        ("- a\n- b\n", "job.yaml: must hold keys and values"),
        ("", "job.yaml: must hold keys and values"),
        ("a: 1\n---\nb: 2\n", "job.yaml:2: "),
        ("a: \x01\n", "job.yaml: is no YAML"),
        ("[" * 5000, "job.yaml: is no YAML"),
    ],
)
def test_what_is_no_job_file_is_told_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        read(tmp_path, text)
    assert f"{tmp_path}/{message}" in str(caught.value)


def test_a_missing_file_suggests_a_neighbour(tmp_path: Path) -> None:
    (tmp_path / "beam.yaml").write_text("a: 1")
    with pytest.raises(JobError, match=r"baem.yaml: no such file. Did you mean 'beam.yaml'\?"):
        read_yaml(tmp_path / "baem.yaml")


def test_a_directory_and_a_binary_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="cannot be read"):
        read_yaml(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(JobError, match="not a text file"):
        read_yaml(tmp_path / "binary.yaml")
