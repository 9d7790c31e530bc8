"""SANM and hpcinv on the scenes of SANM (`benchmarks/published/sanm`), each as a whole process with one thread.

SANM must be built as its README says. Both write the shape; hpcinv writes no fields and no certificate, and factorizes.
Of each process the table has factorizations, processor seconds, and processor seconds of the solution. The latter
are the whole's, times the solution's share of the elapsed time that both programs print: a busy machine slows both.

Repeat it, since the first time compiles kernels.

Command: HPCINV_SCENES=DIRECTORY python benchmarks/beside_sanm.py --sanm SANM/build/fea/fea --configurations SANM/config
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

SCENES = ("bar", "bob", "jet", "plant", "armadillo_small")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
SETTINGS = {
    "solver": {"linear": "direct"},
    "certificate": "off",
    "output": {"fields": False, "mesh": ["vtu"], "snapshots": 0},
}


@dataclass(frozen=True)
class MeasuredRun:
    factorizations: int
    seconds: float
    solving: float

    def __str__(self) -> str:
        return f"{self.factorizations} | {self.seconds:.2f} | {self.solving:.2f}"


def finished(command: Sequence[str], place: Path) -> tuple[str, float, float]:
    """Return the output of a command, its processor seconds, and the seconds that elapsed."""
    begin = time.perf_counter()
    with (place / "log").open("w+") as log:
        settings = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | ONE_THREAD
        with subprocess.Popen(command, cwd=place, env=settings, stdout=log, stderr=log) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        log.seek(0)
        text = log.read()
    if process.returncode:
        sys.exit(f"{' '.join(command)} ended with exit code {process.returncode}:\n{text[-2000:]}")
    return text, used.ru_utime + used.ru_stime, time.perf_counter() - begin


def number_after(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    return float(found[1]) if found else float("nan")


def sanm(binary: Path, configurations: Path, scene: str, direction: str, place: Path) -> MeasuredRun:
    overrides = ["override_order20.json", *(["override_inverse.json"] if direction == "inverse" else [])]
    files = [str(configurations / name) for name in ("sys.json", f"{scene}.json", *overrides)]
    text, seconds, elapsed = finished([str(binary), *files], place)
    solving = number_after(r"timing\(sec\).*solve=([\d.]+)", text)
    summaries = [path for path in place.glob("*.json") if "iter" in json.loads(path.read_text())]
    return MeasuredRun(int(json.loads(summaries[0].read_text())["iter"]), seconds, seconds * solving / elapsed)


def hpcinv(scenes: Path, scene: str, direction: str, place: Path) -> MeasuredRun:
    job = yaml.safe_load((scenes / f"{scene}-{direction}.yaml").read_text())
    job["mesh"]["file"] = str(scenes / job["mesh"]["file"])
    (place / "job.yaml").write_text(yaml.safe_dump(job | SETTINGS))
    text, seconds, elapsed = finished(
        [sys.executable, "-m", "hpcinv", "run", "job.yaml", "--output", "results", "--overwrite"], place
    )
    solves = json.loads((place / "results" / "summary.json").read_text())["solutions"][0]["solves"]
    solving = number_after(r"solving: ([\d.]+) s", text)
    return MeasuredRun(sum(solve["factorizations"] for solve in solves), seconds, seconds * solving / elapsed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES, help="those to run; left out, all")
    parser.add_argument("--sanm", type=Path, required=True, help="its program 'fea'")
    parser.add_argument("--configurations", type=Path, required=True, help="its folder 'config'")
    options = parser.parse_args()
    if (folder := os.environ.get("HPCINV_SCENES")) is None:
        sys.exit("set HPCINV_SCENES to the folder of the scenes (benchmarks/published/sanm)")
    print("| scene | SANM: factorizations | whole, s | solving, s | hpcinv: factorizations | whole, s | solving, s |")
    print("|---|---|---|---|---|---|---|")
    compiled = tempfile.TemporaryDirectory()
    os.environ["PYTHONPYCACHEPREFIX"] = compiled.name
    with tempfile.TemporaryDirectory() as name:
        hpcinv(Path(folder), options.scenes[0], "forward", Path(name))  # compiles modules
    for scene in options.scenes:
        for direction in ("forward", "inverse"):
            runs = []
            with tempfile.TemporaryDirectory() as name:
                runs.append(sanm(options.sanm, options.configurations, scene, direction, Path(name)))
            with tempfile.TemporaryDirectory() as name:
                runs.append(hpcinv(Path(folder), scene, direction, Path(name)))
            print(f"| {scene}, {direction} | {runs[0]} | {runs[1]} |", flush=True)
    compiled.cleanup()


if __name__ == "__main__":
    main()
