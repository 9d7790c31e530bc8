"""A format of mesh files is one file: the one in CONTRIBUTING.md, in a copy of the package."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

from helpers.command_line import environment

ROOT = Path(__file__).parents[2]
MESH = """5 2
0 0 0
1 0 0
0 1 0
0 0 1
1 1 1
0 1 2 3 core
1 2 3 4 skin
"""
CHECK = """
import sys
from pathlib import Path

from hpcinv.errors import MeshError
from hpcinv.job.region_names import unknown_regions

path = Path(sys.argv[1])
print([place for place, _ in unknown_regions(path, [], [(("a",), "core"), (("b",), "rind")])], "numpy" in sys.modules)
from hpcinv.job.mesh_file import FORMATS
from hpcinv.mesh.readers import FILES

source = FILES[".tets"](path)
print(".tets" in FORMATS, source.kind, source.points[4].tolist(), [(g.name, g.members.tolist()) for g in source.groups])
path.write_text(path.read_text()[:-15])
try:
    FILES[".tets"](path)
except MeshError as error:
    print(error)
"""


def test_a_mesh_format_is_added_in_one_file(tmp_path: Path) -> None:
    """It is read without a change of another file, its regions are known without numpy, and bad input is refused."""
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Add a mesh format\n")[2]
    (code, *_) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    shutil.copytree(ROOT / "hpcinv", tmp_path / "hpcinv", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "hpcinv" / "formats" / "tets.py").write_text(code)
    mesh = tmp_path / "body.tets"
    mesh.write_text(MESH)
    command = [sys.executable, "-c", CHECK, str(mesh)]
    variables = environment() | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    regions, content, fault = done.stdout.splitlines()[:3]
    assert regions == "[('b',)] False"
    assert content == "True tetrahedron [1.0, 1.0, 1.0] [('core', [0]), ('skin', [1])]"
    assert "has 6 lines after the counts, not 7" in fault
