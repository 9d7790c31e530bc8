"""Say of each file of FEBio what it needs that has no counterpart here; write mesh and job of the others."""

from __future__ import annotations

import argparse
from pathlib import Path

from hpcinv.formats.cards.card import CardError

from .conversion import Unsupported, convert
from .feb_reader import FebError, read_feb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with .feb files, such as a clone of febiosoftware/TestSuite")
    parser.add_argument("--write", type=Path, help="folder for meshes and jobs, one folder in it for each file")
    options = parser.parse_args()
    for path in sorted(options.folder.rglob("*.feb")):
        try:
            conversion = convert(read_feb(path), path.stem)
            reason = "has a counterpart"
            if options.write:
                reason = f"is {conversion.write(options.write / path.stem)}"
        except FebError as error:
            reason = str(error).removeprefix(f"{path}: ")
        except (Unsupported, CardError) as error:
            reason = str(error)
        print(f"{path.stem}: {reason}", flush=True)


if __name__ == "__main__":
    main()
