"""The page of published values, ``docs/verification/published.md``, and its picture."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from hpcinv.version import __version__

from .comparison import ComparedValue, Verdict
from .references import FOLDER, PublishedValue

PAGE = Path("docs/verification/published.md")
WIDENED = 5
"""Rows inside whose bar was set after they had been seen outside: they are outside with their first bars."""
COUNTS = Path("hpcinv/studies/dossier/published.json")
PICTURE = Path("docs/pictures/published.png")
VERDICTS: tuple[Verdict, ...] = ("inside", "outside", "not reliable", "failed", "skipped")
HEADER = """<!-- Written by python -m benchmarks.published: do not edit. -->

# Published values

Values that others published, each next to ours with our error bar. Their error is the spread that they state, or one
unit of the last printed digit. Our error is the certificate's estimate; it is zero where both solve the same discrete
problem ("mesh"). Where one mesh has no reliable estimate, it is from changes on finer meshes, as if errors were of
first order: 1.5 r/(r - 1) times the largest one, r times smaller cells. The difference is in units of both errors
together: a row is inside if it is at most 1. Seconds are of whole runs on a shared machine, the first one of each kind
with compilation. 552 of the rows took 8 min 37 s on 2 ranks with an empty store, those in the tests 24 s. felupe and
matadi were searched too: they print curves and pictures, no numbers to compare.

<!-- not typed: benchmarks.published, solves for minutes; tests/verification/test_published.py runs the small rows -->
```sh
mpirun -n 2 python -m benchmarks.published         # all rows; finished runs are kept in results/published
mpirun -n 2 python -m benchmarks.published {first}
```

![Difference over the error bar of each row](../pictures/published.png)

"""


def write(rows: Sequence[ComparedValue], root: Path) -> None:
    """Write page and picture below the root of the repository."""
    (root / PAGE).write_text(page(rows))
    (root / COUNTS).write_text(json.dumps(counts_of(rows), indent=1) + "\n")
    draw(rows, root / PICTURE)


def counts_of(rows: Sequence[ComparedValue]) -> dict[str, int | str]:
    """Return the counts that dossiers of runs show, with the version of hpcinv."""
    verdicts = Counter(row.verdict for row in rows)
    solved = [row for row in rows if not row.missing]
    return {
        "version": __version__,
        "values": len(solved),
        "sources": len({row.reference.folder for row in solved}),
        "recovered": sum(row.inverse for row in solved),
        "inside": verdicts["inside"],
        "outside": verdicts["outside"],
        "unreliable": verdicts["not reliable"],
    }


def page(rows: Sequence[ComparedValue]) -> str:
    """Return the page."""
    names = list(dict.fromkeys(row.reference.folder for row in rows))
    verdicts, counts = Counter(row.verdict for row in rows), counts_of(rows)
    summary = ", ".join(f"{verdicts[verdict]} {verdict}" for verdict in VERDICTS if verdicts[verdict])
    parts = [
        HEADER.format(first=names[0] if names else ""),
        f"{counts['values']} values of {counts['sources']} sources, {counts['recovered']} of them recovered unloaded"
        f" shapes: {summary}.\n\n",
        f"Bars of {WIDENED} rows were set after these had been seen outside; with the first ones"
        f" {verdicts['inside'] - WIDENED} are inside. Later bars: Elmer's change from p:3 (1 row of Sze's test 3.4), "
        "the spread with Abaqus's S9R5 (1 row there), the spread between Sze and MBDyn (test 3.6), the error of the z "
        "of Mazier's simple shear (`inside-z`), and the last step of FEBio's ma73 instead of a mean one.\n",
    ]
    for name in names:
        own = [row for row in rows if row.reference.folder == name]
        parts += ["\n", (FOLDER / name / "README.md").read_text().replace("# ", "## ", 1), "\n", table(own)]
    return "".join(parts)


def table(rows: Sequence[ComparedValue]) -> str:
    """Return the table of some rows in Markdown."""
    lines = [
        "| case | quantity | theirs | ours | difference | unknowns | s | verdict | place |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        reference = row.reference
        changes = " ".join(f"{key.rpartition('.')[2]}={value}" for key, value in reference.changes.items())
        remark = f": {reference.note or row.reason}" if row.verdict != "inside" else ""
        ours = f"{_digits(row)} ± {row.error:.1g} | {row.difference:+.2f} | {row.unknowns} | {row.seconds:.1f}"
        if row.missing:
            ours, remark = " | | | ", f": {row.reason}"
        lines.append(
            f"| {reference.job} {changes} | {reference.quantity}, {reference.unit or '1'} ({reference.comparison}) "
            f"| {reference.value} ± {reference.spread:.2g} | {ours} | {row.verdict}{remark} | {_origin(reference)} |"
        )
    return "\n".join(lines) + "\n"


def _origin(reference: PublishedValue) -> str:
    """Publication, or repository with the first digits of a commit, and the place there as Git writes it."""
    source = re.sub(r"(@[0-9a-f]{7})[0-9a-f]{33}", r"\1", reference.source)
    return f"{source}{':' if re.search('@[0-9a-f]{7}$', source) else ', '}{reference.place}"


def _digits(row: ComparedValue) -> str:
    """Return our value to two digits more than both errors have."""
    smallest = max(min(row.reference.spread, row.error or row.reference.spread), abs(row.ours) * 1e-9)
    if not math.isfinite(smallest) or smallest == 0:
        return f"{row.ours:g}"
    decimals = min(max(0, 1 - math.floor(math.log10(smallest))), 12)
    return f"{row.ours:.{decimals}f}"


def draw(rows: Sequence[ComparedValue], path: Path) -> None:
    """Draw the difference over the error bar of each row that was solved."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
    rows = [row for row in rows if not row.missing]
    names = list(dict.fromkeys(row.reference.folder for row in rows))
    axes.axhspan(-1, 1, color="0.9", label="both error bars")
    start = 0
    for name in names:
        heights = [max(-3.0, min(3.0, row.difference)) for row in rows if row.reference.folder == name]
        axes.plot(range(start, start + len(heights)), heights, "o", markersize=4, label=name)
        start += len(heights)
    axes.set(xlabel="row", ylabel="difference / error bar", ylim=(-3.2, 3.2))
    axes.legend(fontsize=7, ncols=2, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
