"""What is not taken from a deck is said with its lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpcinv.cli.deck_lines import lines_of
from hpcinv.studies.second_opinion.program_run import installed

DECKS = {
    ".inp": "*NODE\n1, 0., 0., 0.\n** *FLUX\n*Heat Flux, OP=NEW\n*heat flux\n*HEAT FLUXES\n*SHELL SECTION, OFFSET=1\n",
    ".feb": "<febio_spec>\n<Discrete>\n</Discrete>\n<DiscreteSet/>\n</febio_spec>\n",
    ".cdb": "/PREP7\nSLOAD,1\nSLOADS,1\nsload,2\nSLOAD,3\nSLOAD,4\n",
}


@pytest.mark.parametrize(
    ("suffix", "entry", "lines"),
    [
        (".inp", "*HEAT FLUX", ", line 4, 5"),
        (".inp", "*SHELL SECTION, OFFSET", ", line 7"),
        (".inp", "*FLUX", ""),
        (".inp", "*NODE, which a job cannot say: leave it out", ", line 1"),
        (".inp", "*CLOAD on 2 single nodes, which span no facet", ""),
        (".feb", "<Discrete>", ", line 2"),
        (".feb", "<bc type='linear constraint'>", ""),
        (".cdb", "SLOAD", ", line 2, 4, 5 and 1 more"),
        (".cdb", "D,ROTX (2)", ""),
    ],
)
def test_names_have_the_lines_on_which_they_are(suffix: str, entry: str, lines: str, tmp_path: Path) -> None:
    path = tmp_path / f"deck{suffix}"
    path.write_text(DECKS[suffix])
    assert lines_of(entry, path) == lines


def test_a_relative_command_is_found_from_another_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    assert installed("Program", ["./program"], "Install it.") == str(program)
