"""Say of each file of FEBio what it needs that has no counterpart here."""

from __future__ import annotations

import argparse
from pathlib import Path

from hpcinv.cards.card import CardError

from .conversion import Unsupported, convert
from .feb_reader import FebError, read_feb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with .feb files, such as a clone of febiosoftware/TestSuite")
    for path in sorted(parser.parse_args().folder.rglob("*.feb")):
        try:
            convert(read_feb(path), path.stem)
            reason = "has a counterpart"
        except FebError as error:
            reason = str(error).removeprefix(f"{path}: ")
        except (Unsupported, CardError) as error:
            reason = str(error)
        print(f"{path.stem}: {reason}", flush=True)


if __name__ == "__main__":
    main()
