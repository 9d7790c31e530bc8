"""Damaged files of all formats of meshes, CAD and lumens: each gets one message, or is read, and none hangs.

Command: OMP_NUM_THREADS=1 python benchmarks/damaged_meshes.py [files of each format [suffix …]]
"""

import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import gmsh
import numpy as np
import pyvista

from hpcinv.errors import HpcinvError
from hpcinv.job.sections import MeshSpec
from hpcinv.mesh import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource

SLOW = 60.0  # seconds that a file may take; more is reported
MESHES = (".inp", ".feb", ".cdb", ".bdf", ".unv", ".mesh", ".med", ".e", ".vtk", ".vtu")
LUMEN = {"wall": "1 mm", "size": "4 mm", "unit": "mm"}


def whole_files(place: Path) -> dict[Path, dict[str, object]]:
    """Write a valid file of each format; return them with the section 'mesh' of a job."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 20, 5)
    gmsh.model.occ.synchronize()
    gmsh.write(str(place / "part.step"))
    gmsh.write(str(place / "part.brep"))
    gmsh.finalize()
    cad = {"size": "5 mm"}
    files: dict[Path, dict[str, object]] = {place / "part.step": {"cad": "part.step", **cad}}
    files[place / "part.brep"] = {"cad": "part.brep", **cad, "unit": "mm"}
    (place / "tube.csv").write_text("x, y, z, radius\n" + "".join(f"0, 0, {z}, 5\n" for z in range(0, 30, 3)))
    files[place / "tube.csv"] = {"lumen": "tube.csv", **LUMEN}
    pipe = pyvista.Cylinder(radius=5, height=30, resolution=24, capping=False).triangulate().clean()
    pipe.save(place / "pipe.stl", binary=False)
    files[place / "pipe.stl"] = {"lumen": "pipe.stl", **LUMEN}
    grid = pyvista.ImageData(dimensions=(16, 16, 20))
    x, y, _ = np.meshgrid(*(np.arange(n) - 8.0 for n in grid.dimensions), indexing="ij")
    grid.point_data["label"] = (x**2 + y**2 < 25).astype(np.uint8).ravel(order="F")
    grid.save(place / "scan.vti", binary=False)
    files[place / "scan.vti"] = {"lumen": "scan.vti", "labels": {"blood": 1}, "wall": "1 mm", "size": "4 mm"}
    source = read(place / "part.step", files[place / "part.step"])
    groups = tuple(replace(group, name=group.name.replace("-", "_")) for group in source.groups)
    source = replace(source, groups=groups, unit=1.0)
    for suffix in MESHES:
        save(place / f"part{suffix}", source, source.points)
        files[place / f"part{suffix}"] = {"file": f"part{suffix}"}
    return files


def read(path: Path, section: dict[str, object]) -> MeshSource:
    spec = MeshSpec.model_validate(section, context={"directory": path.parent, "untrusted": False})
    source = read_source(spec, path)
    check(source)
    return source


def damaged(content: bytes, dice: random.Random) -> bytes:
    """Return content that is cut, or has other bytes or numbers in places."""
    changed = bytearray(content)
    for _ in range(dice.randint(1, 6)):
        at = dice.randrange(len(changed)) if changed else 0
        match dice.randrange(5):
            case 0:
                changed[at : at + 1] = bytes([dice.randrange(256)])
            case 1:
                del changed[at : at + dice.randrange(200)]
            case 2 if dice.random() < 0.3:
                del changed[max(at, 1) :]
            case 3:
                changed[at : at + 4] = dice.choice([b"nan ", b"-1  ", b"9999", b"1e99", b"\xff\xff\xff\x7f"])
            case _:
                changed[at:at] = dice.choice([b"\n", b" 0 ", b"-7", b"1e308", b"\0"])
    return bytes(changed)


def main(each: int, suffixes: list[str]) -> int:
    wrong = list[str]()
    with tempfile.TemporaryDirectory() as directory:
        for path, section in whole_files(Path(directory)).items():
            if suffixes and path.suffix not in suffixes:
                continue
            content, dice, outcomes = path.read_bytes(), random.Random(45), Counter[str]()
            for number in range(each):
                path.write_bytes(damaged(content, dice))
                began = time.perf_counter()
                try:
                    read(path, section)
                    outcome = "read"
                except HpcinvError as error:
                    outcome = "message"
                    text = str(error)
                    if "Traceback" in text or "Error:" in text or len(text.splitlines()) > 12:
                        wrong.append(f"{path.name} {number}: {text[:300]}")
                except ValueError as error:  # of the job's section, as pydantic raises it
                    outcome = "message"
                    if "validation error" not in str(error):
                        wrong.append(f"{path.name} {number}: {type(error).__name__}: {str(error)[:300]}")
                except Exception as error:  # what must not happen
                    outcome = "traceback"
                    wrong.append(f"{path.name} {number}: {type(error).__name__}: {str(error)[:300]}")
                outcomes[outcome] += 1
                if (seconds := time.perf_counter() - began) > SLOW:
                    wrong.append(f"{path.name} {number}: took {seconds:.0f} s")
            path.write_bytes(content)
            print(path.suffix, ", ".join(f"{count} {name}" for name, count in sorted(outcomes.items())), flush=True)
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 14, sys.argv[2:]))
