"""Pictures of the gallery: ``python3 -m uv run python docs/gallery_pictures.py NAME…``, after the jobs have run.

Draws ``results/NAME`` (of an identification its ``run``) as ``hpcinv show`` does, and keeps it in
``docs/pictures/gallery``, at most 1,400 pixels wide and in 256 colours.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
WIDTH = 1400


def main() -> None:
    for name in sys.argv[1:]:
        results = ROOT / "results" / name
        results = results / "run" if (results / "run").is_dir() else results
        with tempfile.TemporaryDirectory() as directory:
            drawn = Path(directory) / "drawn.png"
            command = [sys.executable, "-m", "hpcinv", "show", str(results), "--output", str(drawn)]
            subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            shrink(drawn, ROOT / "docs" / "pictures" / "gallery" / f"{name}.png")


def shrink(drawn: Path, kept: Path, width: int = WIDTH, dither: Image.Dither = Image.Dither.FLOYDSTEINBERG) -> None:
    """Write a picture as a smaller file."""
    picture = Image.open(drawn).convert("RGB")
    scale = min(1.0, width / picture.width)
    size = round(picture.width * scale), round(picture.height * scale)
    smaller = picture.resize(size, Image.Resampling.LANCZOS)
    palette = smaller.quantize(
        256, method=Image.Quantize.MAXCOVERAGE
    )  # rare colours too, such as the colours of arrows
    smaller.quantize(palette=palette, dither=dither).save(kept, optimize=True)


if __name__ == "__main__":
    main()
