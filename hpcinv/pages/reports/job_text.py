"""The text of a job with more entries in a section: comments and order are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import yaml

from hpcinv.errors import OutputError


@dataclass(frozen=True)
class JobText:
    """Places in the text of a job at which entries are written.

    Attributes:
        before, after: the text around that place.
        indent: before each entry.
        style: flow if the section is in brackets, else block.
    """

    before: str
    after: str
    indent: str
    style: str

    def with_entries(self, entries: Sequence[str]) -> str:
        """Return the text with entries, each in one line."""
        if self.style == "flow":
            end = "" if self.after.lstrip()[:1] in ("}", "]") else ", "
            return f"{self.before}{', '.join(entries)}{end}{self.after}"
        return self.before + "".join(f"{self.indent}{entry}\n" for entry in entries) + self.after


def place_of_entries(text: str, section: str = "regions") -> JobText:
    """Return where the text of a job takes further entries: first in their section, else at its end.

    Args:
        section: a mapping or a list.
    """
    root = yaml.compose(text) if text.strip() else None
    if root is not None and (not isinstance(root, yaml.MappingNode) or root.flow_style):
        raise OutputError(f"the job is written in braces, into which no {section} can be written")
    node = next((value for key, value in root.value if key.value == section), None) if root else None
    dash = "- " if section == "quantities" else ""
    if not isinstance(node, yaml.CollectionNode):
        head = text if not text or text.endswith("\n") else f"{text}\n"
        return JobText(f"{head}{section}:\n", "", f"  {dash}", "block")
    if node.flow_style:
        at = node.start_mark.index + 1
        return JobText(text[:at], text[at:], "", "flow")
    at = node.start_mark.index - node.start_mark.column
    return JobText(text[:at], text[at:], " " * node.start_mark.column + dash, "block")
