"""Job files are YAML 1.2 within limits of size; anything else is refused with its line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from hpcinv.errors import JobError
from hpcinv.job.yaml_reader import MOST_BYTES, MOST_VALUES, read_yaml


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
def test_scalars_agree_with_yaml_1_2(tmp_path: Path, text: str, value: object) -> None:
    result = read(tmp_path, f"key: {text}")["key"]
    assert result == value
    assert type(result) is type(value)


def test_keys_are_text_whatever_they_look_like(tmp_path: Path) -> None:
    assert read(tmp_path, "on: 1\nyes: 2\n3: 3\nnull: 4\n1e6: 5") == {"on": 1, "yes": 2, "3": 3, "null": 4, "1e6": 5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb:\n  c: 1\n  c: 2\n", "job.yaml:4: duplicate key 'c'"),
        ("a: 1\na: 2\n", "job.yaml:2: duplicate key 'a'"),
        ("a: [1, 2\nb: 3\n", "job.yaml:2: "),
        ("a: 1\n\tb: 2\n", "job.yaml:2: "),
        ("a: !!python/object:os.system x\n", "job.yaml:1: the tag '!!python/object:os.system' is not allowed"),
        ("[x, y]: 1\n", "job.yaml:1: a key must be text"),
        ("a: *unknown\n", "job.yaml:1: the alias '*unknown' has no anchor"),
        ("- a\n- b\n", "job.yaml: must contain keys and values"),
        ("", "job.yaml: must contain keys and values"),
        ("a: 1\n---\nb: 2\n", "job.yaml:2: "),
        ("a: \x01\n", "job.yaml: is not valid YAML"),
        ("[" * 5000, "job.yaml:1: more than 64 nested levels"),
        ("a: ['\\ud800']\nb: \"\\uD800\"", "job.yaml:2: "),
    ],
)
def test_invalid_job_files_are_reported_with_their_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        read(tmp_path, text)
    assert f"{tmp_path}/{message}" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("a: 1\n\tb: 2\n", "which begins in line 1; indent with spaces"),
        ("a:\n\tb: 2\n", "a tab character that cannot start any token while scanning for the next token; indent with"),
        ("a:\n  -\t{b: 2}\n", "indent with spaces"),
        ("a: {b: 1\nc: [1, 2\n", "close each '{' by '}' and each '[' by ']'"),
        ("a: 'b\n", "close the quotation mark"),
        ("a: b: c\n", "in quotation marks"),
        ("a: 1\nb\n", "write 'key: value'"),
        ("a: 1\n  b: 2\n", "in quotation marks, and indent the keys of a mapping alike"),
        ("a: @b\n", "in quotation marks"),
        ("a: 1\n- b\n", "write 'key: value', with all keys"),
    ],
)
def test_syntax_errors_come_with_a_remedy(tmp_path: Path, text: str, remedy: str) -> None:
    with pytest.raises(JobError) as caught:
        read(tmp_path, text)
    assert remedy in str(caught.value)


def test_a_mesh_is_not_taken_for_a_job(tmp_path: Path) -> None:
    (tmp_path / "beam.VTU").write_text("<VTKFile>")
    with pytest.raises(JobError, match=r"beam.VTU: is a mesh; give the job"):
        read_yaml(tmp_path / "beam.VTU")


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


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("!!int 7", 7),
        ("!!int '7'", 7),
        ("!!float 7", 7.0),
        ("!!float 0x10", 16.0),
        ("!!str 7", "7"),
        ("! 7", "7"),
        ("!!bool true", True),
        ("!!null ~", None),
        ("!!map {b: 1}", {"b": 1}),
        ("!!seq [1]", [1]),
    ],
)
def test_tags_of_the_core_schema_are_known(tmp_path: Path, text: str, value: object) -> None:
    result = read(tmp_path, f"a: {text}")["a"]
    assert result == value
    assert type(result) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("!!int abc", "'abc' is not a valid !!int"),
        ("!!int 1.5", "'1.5' is not a valid !!int"),
        ("!!float abc", "'abc' is not a valid !!float"),
        ("!!bool 1", "'1' is not a valid !!bool"),
        ("!!null 1", "'1' is not a valid !!null"),
        ("!!timestamp 2001-99-99", "the tag '!!timestamp' is not allowed"),
        ("!!binary '===='", "the tag '!!binary' is not allowed"),
        ("!!map [1, 2]", "the tag '!!map' is not allowed"),
        ("!!seq {b: 1}", "the tag '!!seq' is not allowed"),
        ("!!set {b}", "the tag '!!set' is not allowed"),
        ("!!omap [b: 1]", "the tag '!!omap' is not allowed"),
        ("!!pairs [b: 1]", "the tag '!!pairs' is not allowed"),
        ("!!map b", "the tag '!!map' is not allowed"),
        ("!local 1", "the tag '!local' is not allowed"),
        ("{? [b] : 1}", "a key must be text"),
        ("{? {b: 1} : 1}", "a key must be text"),
        ("&b {c: *b}", "the alias '*b' is inside its own anchor (&)"),
        ("[&b 1, {*b : 1}]", "a key must be text"),
    ],
)
def test_invalid_yaml_tags_and_aliases_are_refused_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        read(tmp_path, f"before: 1\na: {text}")
    assert f"{tmp_path}/job.yaml:2: {message}" in str(caught.value)


def test_an_alias_has_the_value_of_its_anchor(tmp_path: Path) -> None:
    document = read(tmp_path, "a: &one [1, &two {b: 2}]\nc: *two\nd: [*one, *one]\ne: &f text\ng: *f")
    assert document == {"a": [1, {"b": 2}], "c": {"b": 2}, "d": [[1, {"b": 2}]] * 2, "e": "text", "g": "text"}


def bomb(levels: int) -> str:
    """A list of ten, of ten of these, and so on."""
    lines = ["a0: &a0 [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    lines += [f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 10)}]" for i in range(levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (bomb(30), f":6: more than {MOST_VALUES:,} values, the limit for a file, each alias"),
        ("a: [" + "1," * MOST_VALUES + "]", f":1: more than {MOST_VALUES:,} values"),
        (f"a: &a {'x' * 90_000}\nb: [" + "*a," * 5000 + "]", f":2: more than {MOST_VALUES:,} values"),
        ("a: 1\nb: " + "9" * 5000, ":2: a number of 5,000 characters; it may have 400"),
        ("b: 0." + "9" * 5000, ":1: a number of 5,002 characters"),
        ("b: 0x" + "f" * 5000, ":1: a number of 5,002 characters"),
        ("a: " + "x" * 100_001, ":1: a text of 100,001 characters; it may have 100,000"),
        ("a" * 100_001 + ": 1", ":1: "),
        ("a: " + "{b: " * 65 + "1" + "}" * 65, ":1: more than 64 nested levels"),
        ("- " * 65 + "a", ":1: more than 64 nested levels"),
        ("\n".join(f"k{i}: 1" for i in range(10_001)), ":10001: more than 10,000 keys in one section"),
        ("a: 1\n" + "#" * MOST_BYTES, f": has {MOST_BYTES + 5:,} bytes, and may have {MOST_BYTES:,}"),
    ],
    ids=lambda text: text[:12] if text.startswith(":") else "",
)
def test_oversized_yaml_is_refused_quickly(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(JobError) as caught:
        read(tmp_path, text)
    assert f"{tmp_path}/job.yaml{message}" in str(caught.value)


@pytest.mark.release
def test_a_large_table_is_read(tmp_path: Path) -> None:
    assert len(read(tmp_path, "a: [" + "1.5," * (MOST_VALUES - 3) + "]")["a"]) == MOST_VALUES - 3
    assert len(read(tmp_path, f"a: {'9' * 400}")) == 1


def test_devices_and_pipes_are_refused_without_reading_them(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for path in (Path("/dev/zero"), tmp_path / "pipe.yaml"):
        with pytest.raises(JobError, match=f"{path}: cannot be read: it is a device or a pipe"):
            read_yaml(path)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".yaml", "a/" * 3000 + "b.yaml", "\udcff.yaml", "nul\0.yaml", "line\nbreak"]
)
def test_a_name_that_no_file_can_have_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(JobError, match=r"cannot be read|not UTF-8|no such file"):
        read_yaml(tmp_path / name)
