"""Seeded mutations of job files and of mesh files."""

from __future__ import annotations

import random
import re

EXTREMES = (
    *("0", "-0", "-1", "1", "1e308", "-1e308", "1e309", "1e-320", "1e999", ".nan", ".inf", "-.inf", "0x7f"),
    *("4294967296", "-9223372036854775809", "9" * 400, "9" * 5000, "1/0", "10**400"),
    *("1 m", "1 Pa", "400 °C", "-1 kg/m^3", "5 °", "1 %"),
)
TEXTS = (
    *("", "~", "null", "true", "[]", "{}", "[[]]", "{a: b}", "a", "x", "'", '"', "\t", "#", "|", ">"),
    *("boundary", "elsewhere", "incompressible", "x" * 300, "..", ".", "/dev/zero", "/dev/null", "no/such.py"),
    *("*a", "&a 1", "<<", "!!int abc", "!!float abc", "!!timestamp 2001-99-99", "!!map [1]", "!!set {a}"),
    *("!!binary x", "!!python/object:os.system x", "? [a]", "- - -", "%YAML 9.9", "---", "..."),
    *("-" * 900 + "1", "(I1-3)**1e308", "(" * 300 + "x" + ")" * 300, "x**x**x", "x < 1 and", "log(0)"),
    *("norm(x, y, z) < 1 mm", "\x00", "\x07", "\ufeff", "\u2028", "ſ", "𝐱", "\udc80"),
)
TOKEN = re.compile(r"[A-Za-z_][\w-]*|[-+]?\d[\w.+-]*|[^\w\s]")


def mutated_text(source: random.Random, texts: list[str]) -> bytes:
    """One of the texts of a corpus after one to four changes, now and then of bytes."""
    text = source.choice(texts)
    for _ in range(source.randint(1, 4)):
        text = source.choice(_TEXT_CHANGES)(source, text, texts)
    content = text.encode("utf-8", "surrogatepass")
    return mutated_bytes(source, content, lines=False) if source.random() < 0.1 else content


def mutated_bytes(source: random.Random, content: bytes, *, lines: bool) -> bytes:
    """A file after one change of its bytes, or of its ``lines`` and the numbers in them."""
    changes = [_flip, _flip, _extreme, _cut, _remove, _repeat, _reversed]
    if lines:
        changes += [_without_line, _line_twice, _lines_swapped, _number, _number, _number]
    return source.choice(changes)(source, content) if content else source.randbytes(8)


def mutated_header(source: random.Random, content: bytes, size: int) -> bytes:
    """A file after one change of its first ``size`` bytes; numbers in them may become huge ones."""
    head, rest = content[:size], content[size:]
    changes = (_flip, _extreme, _remove, _reversed, _number, _number, _number, _without_line, _line_twice)
    return source.choice(changes)(source, head) + rest


def _replaced(source: random.Random, text: str, by: str) -> str:
    tokens = list(TOKEN.finditer(text))
    if not tokens:
        return by
    chosen = source.choice(tokens)
    return text[: chosen.start()] + by + text[chosen.end() :]


def _token_extreme(source: random.Random, text: str, _texts: list[str]) -> str:
    return _replaced(source, text, source.choice(EXTREMES))


def _token_text(source: random.Random, text: str, _texts: list[str]) -> str:
    return _replaced(source, text, source.choice(TEXTS))


def _token_other(source: random.Random, text: str, texts: list[str]) -> str:
    others = TOKEN.findall(source.choice(texts))
    return _replaced(source, text, source.choice(others)) if others else text


def _line_of_text(source: random.Random, text: str, texts: list[str]) -> str:
    lines = text.split("\n")
    place = source.randrange(len(lines))
    match source.randrange(5):
        case 0:
            del lines[place]
        case 1:
            lines.insert(place, lines[source.randrange(len(lines))])
        case 2:
            lines[place] = " " * source.randint(1, 4) + lines[place]
        case 3:
            lines.insert(place, source.choice(source.choice(texts).split("\n")))
        case 4:
            lines[place] = lines[place][: source.randrange(len(lines[place]) + 1)]
    return "\n".join(lines)


def _nested(source: random.Random, text: str, _texts: list[str]) -> str:
    tokens = list(TOKEN.finditer(text))
    if not tokens:
        return text
    chosen, depth = source.choice(tokens), source.choice((1, 3, 30, 70, 2000))
    left, right = source.choice((("[", "]"), ("{a: ", "}"), ("(", ")"), ("-", ""), ("sin(", ")"), ("not ", "")))
    return text[: chosen.start()] + left * depth + chosen[0] + right * depth + text[chosen.end() :]


_TEXT_CHANGES = (_token_extreme, _token_text, _token_other, _line_of_text, _line_of_text, _nested)


def _flip(source: random.Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(source.choice((1, 1, 1, 4, 16))):
        changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
    return bytes(changed)


def _extreme(source: random.Random, content: bytes) -> bytes:
    size = source.choice((1, 4, 8))
    place = source.randrange(len(content))
    value = source.choice((b"\x00", b"\xff", b"\x7f", b"\x80")) * size
    return content[:place] + value + content[place + size :]


def _cut(source: random.Random, content: bytes) -> bytes:
    return content[: source.randrange(len(content))]


def _remove(source: random.Random, content: bytes) -> bytes:
    place = source.randrange(len(content))
    return content[:place] + content[place + source.choice((1, 4, 8, 64)) :]


def _repeat(source: random.Random, content: bytes) -> bytes:
    place, size = source.randrange(len(content)), source.choice((1, 8, 64))
    return content[: place + size] + content[place:]


def _reversed(source: random.Random, content: bytes) -> bytes:
    """Bytes of a number in the other order."""
    place, size = source.randrange(len(content)), source.choice((2, 4, 8))
    return content[:place] + content[place : place + size][::-1] + content[place + size :]


def _without_line(source: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    del lines[source.randrange(len(lines))]
    return b"\n".join(lines)


def _line_twice(source: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    lines.insert(source.randrange(len(lines)), source.choice(lines))
    return b"\n".join(lines)


def _lines_swapped(source: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    i, j = source.randrange(len(lines)), source.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _number(source: random.Random, content: bytes) -> bytes:
    numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", content))
    if not numbers:
        return content
    chosen = source.choice(numbers)
    value = source.choice(
        (b"0", b"-1", b"1", b"2", b"4000000000", b"-4000000000", b"99999999999999999999", b"1e308", b"nan", b"x", b"")
    )
    return content[: chosen.start()] + value + content[chosen.end() :]
