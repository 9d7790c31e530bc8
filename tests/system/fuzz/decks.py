"""Damaged files of other programs: whatever comes, the answer is an error that names the file, or the whole body.

A body with fewer cells, and a job of a cut file with fewer supports or loads, need a word: a note or a comment that the
whole file does not have. Each cell of these files has a node of its own, so that a lost one leaves a loose node.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import signal
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import yaml
from mutations import mutated_bytes

from hpcinv.__main__ import main
from hpcinv.base.reading import isolated_reader
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import HpcinvError, MeshError
from hpcinv.formats import feb
from hpcinv.formats.readers import elements, shell_surfaces
from hpcinv.mesh.io import isolated
from hpcinv.mesh.readers import FILES

PATIENCE = 20
"""seconds, many times what an answer takes"""
POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, -1), (1, 1, 1), (-1, 0.5, 0.5), (0.5, -1, 0.5)]
CELLS = [(1, 3, 2, 5), (2, 3, 4, 6), (1, 4, 3, 7), (1, 2, 4, 8)]
"""tetrahedra on the faces of one that is not there"""


def numbered(rows: list[Any]) -> str:
    return "".join(f"{i}, {', '.join(map(str, row))}\n" for i, row in enumerate(rows, 1))


MODEL = """*MATERIAL, NAME=rubber
*HYPERELASTIC, MOONEY-RIVLIN
0.1, 0.2, 0.3
*DENSITY
1e-9
*AMPLITUDE, NAME=up
0., 0., 1., 0.5
"""
STEP = """*STEP, NLGEOM
*STATIC
0.1, 1.
*BOUNDARY
foot, 1, 3
6, 3, 3, 0.1
*DSLOAD, AMPLITUDE=up
side, P, 0.01
*DLOAD, OP=NEW
all, GRAV, 9810., 0., 0., -1.
*CLOAD
top, 1, 2.
*END STEP
"""
SETS = "*NSET, NSET=foot\n1, 2, 5\n*NSET, NSET=top,\n2, 4, 8\n*SURFACE, NAME=side\n4, S4\n3, S3\n"
FLAT = f"*HEADING\nfour cells\n*NODE, NSET=every\n{numbered(POINTS)}*ELEMENT, TYPE=C3D4, ELSET=all\n{numbered(CELLS)}"
PLATE = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 2, 0, 0
6, 2, 1, 0
*ELEMENT, TYPE=S4, ELSET=all
1, 1, 2, 3, 4
2, 2, 5, 6, 3
*NSET, NSET=foot
1, 4
*MATERIAL, NAME=steel
*ELASTIC
200., 0.3
*SHELL SECTION, ELSET=all, MATERIAL=steel
0.1,
*STEP, NLGEOM
*STATIC
*BOUNDARY
foot, 1, 6
*DLOAD
all, P, 0.1
*END STEP
"""
FEB_NODES = "".join(f'<node id="{i}">{x},{y},{z}</node>\n' for i, (x, y, z) in enumerate(POINTS, 1))
FEB_CELLS = "".join(f'<elem id="{i}">{",".join(map(str, cell))}</elem>\n' for i, cell in enumerate(CELLS, 1))
FEB = f"""<febio_spec version="4.0"><Module type="solid"/>
<Material><material id="1" name="soft" type="neo-Hookean"><E>2</E><v>0.3</v></material></Material>
<Mesh><Nodes>
{FEB_NODES}</Nodes><Elements type="tet4" name="all">
{FEB_CELLS}</Elements>
<Surface name="side"><tri3 id="1">1,3,7</tri3></Surface><NodeSet name="foot">1,2,5</NodeSet></Mesh>
<MeshDomains><SolidDomain name="all" mat="soft"/></MeshDomains>
<Boundary><bc node_set="foot" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc></Boundary>
<Loads><surface_load surface="side" type="pressure"><pressure>3</pressure></surface_load></Loads>
</febio_spec>
"""
CDB_NODES = "".join(f"{i:9d}{0:9d}{0:9d}{x:16.9f}{y:16.9f}{z:16.9f}\n" for i, (x, y, z) in enumerate(POINTS, 1))
CDB_CELLS = "".join(
    "".join(f"{n:9d}" for n in (1, 1, 1, 1, 0, 0, 0, 0, 4, 0, i, *cell)) + "\n" for i, cell in enumerate(CELLS, 1)
)
CDB = f"""ET,1,285
NBLOCK,6,SOLID,8,8
(3i9,6e16.9)
{CDB_NODES}N,R5.3,LOC,       -1,
EBLOCK,19,SOLID,4,4
(19i9)
{CDB_CELLS}       -1
CMBLOCK,FOOT,NODE,3
(8i10)
         1         2         5
MP,EX,1,2.5
MP,PRXY,1,0.3
D,1,UX,0
D,2,UX,0
D,5,UX,0
FINISH
"""
ASSEMBLY = f"""*PART, NAME=p
{FLAT.partition("four cells")[2].lstrip()}*SOLID SECTION, ELSET=all, MATERIAL=rubber
*END PART
*ASSEMBLY, NAME=a
*INSTANCE, NAME=i, PART=p
0., 0., 1.
*END INSTANCE
*NODE
1, 0, 0, 5
*NSET, NSET=point
1,
*NSET, NSET=foot, INSTANCE=i
1, 2, 5
*ELSET, ELSET=_side, INSTANCE=i
4
*SURFACE, NAME=side
_side, S4
*COUPLING, CONSTRAINT NAME=c, REF NODE=point, SURFACE=side
*KINEMATIC
*END ASSEMBLY
{MODEL}*STEP, NLGEOM
*STATIC
*BOUNDARY
foot, ENCASTRE
*CLOAD
point, 3, 0.5
*END STEP
"""
JOBS = {
    "flat.inp": f"{FLAT}{SETS}{MODEL}*SOLID SECTION, ELSET=all, MATERIAL=rubber\n{STEP}",
    "assembly.inp": ASSEMBLY,
    "plate.inp": PLATE,
    "model.feb": FEB,
    "archive.cdb": CDB,
}
MESHES = {
    "mesh.bdf": "BEGIN BULK\n"
    + "".join(f"GRID,{i},,{float(x)},{float(y)},{float(z)}\n" for i, (x, y, z) in enumerate(POINTS, 1))
    + "".join(f"CTETRA,{i},1,{','.join(map(str, cell))}\n" for i, cell in enumerate(CELLS, 1))
    + "ENDDATA\n",
    "mesh.mesh": "MeshVersionFormatted 2\nDimension 3\nVertices\n8\n"
    + "".join(f"{x} {y} {z} 0\n" for x, y, z in POINTS)
    + "Tetrahedra\n4\n"
    + "".join(f"{a} {b} {c} {d} 1\n" for a, b, c, d in CELLS)
    + "End\n",
}


@dataclass
class Answer:
    """What is made of a file.

    Attributes:
        cells: their number.
        job: supports, effects and materials.
        words: notes and comments.
    """

    cells: int
    job: dict[str, Any] = field(default_factory=dict)
    words: set[str] = field(default_factory=set)


class Decks:
    """Whole files of other programs; damaged copies of them are read."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.answers: Counter[str] = Counter()
        _read_in_this_process()
        self.texts = JOBS | MESHES
        self.right: dict[str, Answer] = {}
        for name, text in self.texts.items():
            (directory / name).write_text(text)
            answer = answer_to(directory / name)
            assert isinstance(answer, Answer), (name, answer)
            self.right[name] = answer

    def fault_of_next(self, source: random.Random) -> tuple[bytes, str] | None:
        """Damage one of the files and read it; its content and what is wrong with the answer, if something is."""
        name = source.choice(sorted(self.texts))
        original = self.texts[name].encode()
        is_cut = source.random() < 0.3
        content = cut(source, original) if is_cut else damaged(source, original)
        path = self.directory / name
        path.write_bytes(content)
        if (fault := self.fault_of(path, self.right[name], is_cut=is_cut)) is None:
            return None
        return content, f"{name}: {fault}"

    def fault_of(self, path: Path, right: Answer, *, is_cut: bool) -> str | None:
        """What is wrong with the answer to a damaged file."""
        answer = answer_to(path)
        if isinstance(answer, str):
            self.answers["refused" if not answer else "wrong"] += 1
            return answer or None
        self.answers["read"] += 1
        has_word = bool(answer.words - right.words)
        if answer.cells < right.cells and not has_word:
            return f"has {answer.cells} of {right.cells} cells without a word"
        if is_cut and answer.job != right.job and not has_word:
            return f"is cut and has another job without a word: {answer.job}"
        return None


def cut(source: random.Random, content: bytes) -> bytes:
    """A file up to the end of one of its lines."""
    lines = content.splitlines(keepends=True)
    return b"".join(lines[: source.randrange(1, len(lines))])


def damaged(source: random.Random, content: bytes) -> bytes:
    """A file after one change of its bytes, lines, fields or options."""
    changes = (_without_field, _without_comma, _with_comma, _other_name, None, None)
    change = source.choice(changes)
    return mutated_bytes(source, content, lines=True) if change is None else change(source, content)


def _without_field(source: random.Random, content: bytes) -> bytes:
    places = [match.span() for match in re.finditer(rb"(?<=[,>])[^,<>\n]+(?=[,<])", content)] or [(0, 0)]
    start, end = source.choice(places)
    return content[:start] + content[end:]


def _without_comma(source: random.Random, content: bytes) -> bytes:
    places = [match.start() for match in re.finditer(rb",", content)] or [0]
    at = source.choice(places)
    return content[:at] + b" " + content[at + 1 :]


def _with_comma(source: random.Random, content: bytes) -> bytes:
    lines = content.split(b"\n")
    lines[source.randrange(len(lines))] += b","
    return b"\n".join(lines)


def _other_name(source: random.Random, content: bytes) -> bytes:
    words = [match.span() for match in re.finditer(rb"[A-Za-z]{2,}", content)]
    (start, end), (first, last) = source.choice(words), source.choice(words)
    return content[:start] + content[first:last] + content[end:]


def answer_to(path: Path) -> Answer | str:
    """What is made of a file; empty text if it is refused as it should be, else what is wrong with the answer."""

    def hangs(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, hangs)
    signal.alarm(PATIENCE)
    try:
        return _job(path) if path.name in JOBS else _mesh(path)
    except BaseException as error:
        return "".join(traceback.format_exception(error)[-4:])
    finally:
        signal.alarm(0)


def _mesh(path: Path) -> Answer | str:
    try:
        source = FILES[suffix_of(path)](path)
    except HpcinvError as error:
        return "" if path.name in str(error) and len(str(error)) < 1000 else f"does not name the file: {error}"
    return Answer(len(source.cells), words=set(source.notes))


def _job(path: Path) -> Answer | str:
    out, err, output = io.StringIO(), io.StringIO(), path.with_suffix(".yaml")
    command = ["new", "job", "--from", str(path), "--unit", "mm", "--stress-unit", "MPa", str(output), "--force"]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(command)
    if code:
        text = err.getvalue()
        is_right = code == 2 and path.name in text and "Traceback" not in text and len(text) < 1000
        return "" if is_right else f"exit code {code}: {text}"
    text = output.read_text()
    words = {line for line in text.splitlines() if line.startswith("#")} | set(err.getvalue().splitlines())
    words = {re.sub(r"Regions of the mesh.*", "", word) for word in words}
    job = {key: value for key, value in yaml.safe_load(text).items() if key in ("supports", "effects", "material")}
    return Answer(LAST_CELLS[-1], job, words)


LAST_CELLS: list[int] = []
"""number of cells that the last file has"""


def _read_in_this_process() -> None:
    """Read without a process for each file, which takes half a second."""

    def read(action: str, path: Path, *_: str) -> Any:
        try:
            head, arrays = isolated_reader.action_of(action)(path, isolated_reader.Limits(0, 0))
        except Fault as fault:
            raise MeshError(f"{path}: {fault.text}", fault.advice) from None
        LAST_CELLS.append(len(arrays["cell_tags"]))
        return head, arrays

    isolated_reader.limit = lambda _: None
    for module in (isolated, elements, feb, shell_surfaces):
        if hasattr(module, "read_isolated"):
            module.read_isolated = read
