"""Which of point and comma is decimal in the columns of a table, where the other one may group thousands.

``1,234`` alone is 1.234 to some programs and 1234 to others. Other entries of its column decide, else other columns.
"""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest

from hpcinv.base.quantity.units import NUMBER

POINT, COMMA, MIXED, OPEN, EXACT = "point", "comma", "mixed", "open", ""
"""decimal mark of an entry; mixed where both occur, open where nothing decides, `EXACT` for numbers of a workbook"""

_NUMBER = re.compile(NUMBER)
_EXPONENT = r"(?:[eE][+-]?\d{1,3})?"
_WITH_COMMA = re.compile(rf"[+-]?\d*,\d+{_EXPONENT}")
_THOUSANDS = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}{mark}\d{{3}}") for mark in (",", "[.]")}
"""``1,234`` or ``1.234``: with a decimal mark, or a mark of thousands"""
_GROUPED = {
    COMMA: re.compile(r"[+-]?[1-9]\d{0,2}(?:(?:\.\d{3})+,\d*|(?:\.\d{3}){2,})"),
    POINT: re.compile(r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3})+\.\d*|(?:,\d{3}){2,})"),
}
"""numbers with marks of thousands, by their decimal mark"""
_RARE = 10
"""times that a mark occurs more often than one that does not count; raised, more tables are ambiguous"""
_UNGROUPED = re.compile(r"[+-]?\d{4,}")


def _mark_of(text: str) -> str:
    """Return the decimal mark that an entry shows; `OPEN` if it may be either, or has none."""
    for mark, pattern in _GROUPED.items():
        if pattern.fullmatch(text):
            return mark
    if any(pattern.fullmatch(text) for pattern in _THOUSANDS.values()):
        return OPEN
    if _WITH_COMMA.fullmatch(text):
        return COMMA
    return POINT if "." in text and _NUMBER.fullmatch(text) else OPEN


def decimal_marks(rows: Sequence[Sequence[str]], unknown: str, given: str = OPEN) -> list[str]:
    """Return the decimal mark of each column: `POINT`, `COMMA`, `MIXED` or `OPEN`.

    Args:
        rows: entries, which need not be numbers.
        unknown: mark where no entry of the table decides.
        given: mark that the user gives.
    """
    columns = [[text for text in column if text] for column in zip_longest(*rows, fillvalue="")]
    counts = [Counter(mark for text in column if (mark := _mark_of(text)) != OPEN) for column in columns]
    others = Counter({given: len(rows)}) if given != OPEN else sum(counts, Counter())
    return [
        _decided(column, _most(count), _most(others), unknown) for column, count in zip(columns, counts, strict=True)
    ]


def _most(marks: Counter[str]) -> str:
    """Return the mark that occurs; `MIXED` where the other one is not rare, such as a version in a head."""
    if not marks:
        return OPEN
    (mark, count), *rest = marks.most_common()
    return MIXED if rest and rest[0][1] * _RARE > count else mark


def _decided(column: Sequence[str], own: str, others: str, unknown: str) -> str:
    if own != OPEN:
        return own
    has_commas, has_points = (any(map(p.fullmatch, column)) for p in _THOUSANDS.values())
    if has_points:  # decimal, unless other columns have decimal commas
        return MIXED if has_commas or others == COMMA else POINT
    if others != OPEN or not has_commas:
        return others
    return COMMA if any(map(_UNGROUPED.fullmatch, column)) else unknown


class AmbiguousNumber(ValueError):
    """The mark in an entry may be decimal, or one of thousands."""


def number_of(text: str, mark: str) -> float:
    """Return the number that an entry of a column is; ``ValueError`` with the reason if it is none."""
    if not text:
        raise ValueError("is empty")
    plain = _plain(text, mark)
    if _NUMBER.fullmatch(plain):
        return float(plain)
    comma = "; a decimal comma is written as a point" if _WITH_COMMA.fullmatch(text) else ""
    raise ValueError(f"{shortened(text)} is not a number{comma}")


def _plain(text: str, mark: str) -> str:
    """Return an entry as a number is written in code."""
    is_thousands = {sign: bool(pattern.fullmatch(text)) for sign, pattern in _THOUSANDS.items()}
    if mark in (MIXED, OPEN) and any(is_thousands.values()) and (mark == MIXED or is_thousands[","]):
        digits = text.replace(",", ".")
        both = f"{digits} or {digits.replace('.', '')}"
        raise AmbiguousNumber(f"'{text}' may be {both}, and the other entries do not decide; write one of these")
    if mark == COMMA or (mark == MIXED and _mark_of(text) == COMMA):
        if _GROUPED[COMMA].fullmatch(text) or is_thousands["[.]"]:
            text = text.replace(".", "")
        return text.replace(",", ".") if _WITH_COMMA.fullmatch(text) else text
    if mark in (POINT, MIXED, OPEN) and (_GROUPED[POINT].fullmatch(text) or (mark == POINT and is_thousands[","])):
        return text.replace(",", "")
    return text


def is_grouped(text: str, mark: str) -> bool:
    """Return whether an entry is read with marks of thousands."""
    sign = {COMMA: "[.]", POINT: ","}.get(mark)
    return sign is not None and bool(_THOUSANDS[sign].fullmatch(text) or _GROUPED[mark].fullmatch(text))


def shortened(text: str) -> str:
    return repr(text) if len(text) <= 60 else f"{text[:57]!r}..."
