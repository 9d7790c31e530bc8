"""Tables as test machines write them: encodings, titles, rows of units, decimal commas, cycles, workbooks."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hpcinv.__main__ import main
from hpcinv.errors import JobError, SystemPartMissing
from hpcinv.studies.fitting.cycles import loading_branches
from hpcinv.studies.fitting.measurements import FileOptions, read_file

STRETCH = (1.0, 1.1, 1.25, 1.5)
FORCE = (0.0, 2.5, 5.75, 10.125)  # N
POINTS = list(zip(STRETCH, FORCE, strict=True))
SPECIMEN = FileOptions("uniaxial", area=25e-6, length=20e-3)

ZWICK = """Prüfprotokoll;Zugversuch
Prüfer;Müller
Fläche;25;mm²

Prüfzeit;Standardweg;Standardkraft;
s;mm;N;
""" + "".join(f"{i},5;{20 * (x - 1):.3f};{f:.4f};\n".replace(".", ",") for i, (x, f) in enumerate(POINTS))
INSTRON = '"Time","Extension","Load"\n"(s)","(mm)","(N)"\n' + "".join(
    f'"{i}","{20 * (x - 1):.3f}","{f:.4f}"\n' for i, (x, f) in enumerate(POINTS)
)
MTS = "MTS793\tTest\nStation: 3\nTime (s)\tCrosshead (cm)\tAxial Force (kN)\n" + "".join(
    f"{i}\t{2 * (x - 1):.4f}\t{f / 1000:.7f}\n" for i, (x, f) in enumerate(POINTS)
)


@pytest.mark.parametrize(
    ("text", "encoding", "understood"),
    [
        (
            ZWICK,
            "latin-1",
            ["Latin-1, columns between semicolons", "line 5 after 3 lines", "units in line 6", "Prüfzeit"],
        ),
        (ZWICK, "utf-16", ["UTF-16, columns between semicolons"]),
        (ZWICK, "utf-16-le", ["UTF-16, columns between semicolons"]),
        (INSTRON, "utf-8", ["UTF-8, columns between commas", "names of columns in line 1, their units in line 2"]),
        (INSTRON.replace("\n", "\r\n"), "utf-8-sig", ["not used: Time"]),
        (MTS, "ascii", ["columns between tabs", "'Crosshead (cm)': elongation in 0.01 m, over length 20 mm"]),
    ],
)
def test_files_of_machines_are_the_same_test(text: str, encoding: str, understood: list[str], tmp_path: Path) -> None:
    path = tmp_path / "machine.txt"
    path.write_bytes(text.encode(encoding))
    file = read_file(path, SPECIMEN)
    (test,) = file.tests
    assert test.measure == pytest.approx(STRETCH, rel=1e-12)
    assert test.stress == pytest.approx(np.array(FORCE) / 25e-6, rel=1e-12)
    notes = "\n".join(file.notes)
    assert all(part in notes for part in understood), notes
    assert "uniaxial test of 4 points: stretch 1 to 1.5, nominal stress 0 Pa to 405 kPa" in notes


def test_a_workbook_is_the_same_test(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    assert book.active is not None
    book.active.append(["Report of the machine"])
    sheet = book.create_sheet("Specimen 1")
    for row in (["Specimen 1", None], [], ["Time", "Extension", "Load"], ["s", "mm", "N"]):
        sheet.append(row)
    for i, (x, f) in enumerate(zip(STRETCH, FORCE, strict=True)):
        sheet.append([i, 20 * (x - 1), f])
    path = tmp_path / "machine.xlsx"
    book.save(path)
    with pytest.raises(JobError, match="unknown column 'Report of the machine'"):
        read_file(path, SPECIMEN)
    with pytest.raises(JobError, match=r"has no sheet 'Specimen 2'\. Did you mean 'Specimen 1'"):
        read_file(path, FileOptions("uniaxial", 25e-6, 20e-3, sheet="Specimen 2"))
    file = read_file(path, FileOptions("uniaxial", 25e-6, 20e-3, sheet="Specimen 1"))
    assert file.tests[0].stress == pytest.approx(np.array(FORCE) / 25e-6, rel=1e-12)
    assert "workbook, sheet 'Specimen 1' (others: Sheet)" in file.notes[0]


def test_titles_of_a_workbook_may_have_two_lines(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    assert book.active is not None
    for row in (["stretch [-]", "nominal\nstress [MPa]"], [1.1, 0.1], [1.2, 0.2]):
        book.active.append(row)
    path = tmp_path / "uniaxial.xlsx"
    book.save(path)
    assert read_file(path, FileOptions("uniaxial")).tests[0].stress == pytest.approx([1e5, 2e5])


def test_a_formatted_cell_far_below_takes_no_time(tmp_path: Path) -> None:
    import openpyxl
    from openpyxl.styles import Font

    book = openpyxl.Workbook()
    assert book.active is not None
    for row in (["stretch [-]", "nominal stress [MPa]"], [1.1, 0.1], [1.2, 0.2]):
        book.active.append(row)
    book.active.cell(100_000, 1).font = Font(bold=True)
    book.active.cell(100_001, 16_000).font = Font(bold=True)
    path = tmp_path / "uniaxial.xlsx"
    book.save(path)
    began = time.process_time()
    assert read_file(path, FileOptions("uniaxial")).tests[0].stress == pytest.approx([1e5, 2e5])
    assert time.process_time() - began < 4  # 9 s where each row had 1,000 entries


def test_workbooks_of_too_many_empty_cells_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    assert book.active is not None
    book.active.cell(5, 100, "far")
    path = tmp_path / "uniaxial.xlsx"
    book.save(path)
    monkeypatch.setattr("hpcinv.base.quantity.table_files._MOST_CELLS", 99)
    with pytest.raises(JobError, match=r"has more than 99 cells, many of them empty; save it as \.csv"):
        read_file(path, FileOptions("uniaxial"))


def test_workbooks_need_a_package_and_whole_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "machine.xlsx"
    path.write_bytes(b"PK\x03\x04 not a workbook")
    with pytest.raises(JobError, match="is a workbook that cannot be read"):
        read_file(path, SPECIMEN)
    path.write_bytes(b"\xd0\xcf\x11\xe0 old")
    with pytest.raises(JobError, match=r"save it as \.xlsx or \.csv"):
        read_file(path, SPECIMEN)
    path.write_bytes(b"PK\x03\x04")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(SystemPartMissing, match=r"pip install 'hpcinv\[tables\]'"):
        read_file(path, SPECIMEN)


def test_loading_branches_end_where_the_strain_returns() -> None:
    cycles = np.concatenate(
        [np.linspace(0, 0.5, 26), np.linspace(0.49, 0.1, 40), np.linspace(0.11, 0.5, 40), [0.4, 0.3]]
    )
    noise = 0.002 * np.sin(50 * np.arange(len(cycles)))
    assert loading_branches(1 + cycles, 1.0) == [(0, 25), (65, 105)]
    branches = loading_branches(1 + cycles + noise, 1.0)
    assert len(branches) == 2
    assert np.abs(np.array(branches) - [(0, 25), (65, 105)]).max() <= 2
    assert loading_branches(1 - cycles, 1.0) == [(0, 25), (65, 105)]  # compression
    assert loading_branches(np.linspace(1, 2, 5), 1.0) == [(0, 4)]


def test_a_cycle_is_its_loading_branch(tmp_path: Path) -> None:
    stretches = [*np.linspace(1, 1.5, 6), *np.linspace(1.4, 1.1, 4), *np.linspace(1.2, 1.5, 4)]
    rows = "".join(f"{x:.6g}, {1000 * i}\n" for i, x in enumerate(stretches))
    path = tmp_path / "cycles.csv"
    path.write_text(f"# mode: uniaxial\nstretch, nominal stress [Pa]\n{rows}")
    whole = read_file(path, FileOptions())
    assert len(whole.tests[0]) == 14
    assert "--cycle N takes the loading branch" in "\n".join(whole.notes)
    second = read_file(path, FileOptions(cycle=2))
    assert list(second.tests[0].stress) == [9000, 10000, 11000, 12000, 13000]
    assert "loading of cycle 2: 5 points, lines 12 to 16: stretch 1.1 to 1.5" in "\n".join(second.notes)
    with pytest.raises(JobError, match="has 2 cycles of loading, not 3"):
        read_file(path, FileOptions(cycle=3))


def test_titles_are_named_or_left_out_by_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "machine.csv"
    rows = "".join(f"{x - 1:.4f};{f};7\n".replace(".", ",") for x, f in zip(STRETCH, FORCE, strict=True))
    path.write_text(f"Dehnung;Spannung;Kanal 3\n;MPa;V\n{rows}", encoding="latin-1")
    command = ["fit", str(path), "--law", "isochoric-neo-hookean", "--mode", "uniaxial"]
    assert main(command) == 2
    errors = capsys.readouterr().err
    assert "column 'Spannung': is it a nominal stress or a Cauchy stress?" in errors
    assert "--column 'Kanal 3=ignore'" in errors
    options = ["--column", "Spannung=nominal stress", "--column", "Kanal 3=ignore"]
    assert main([*command, *options]) == 0
    printed = capsys.readouterr().out
    assert printed.index("'Spannung': nominal stress in MPa") < printed.index("isochoric-neo-hookean:")
    assert main([*command, "--column", "Spannung"]) == 2
    assert "is written TITLE=NAME" in capsys.readouterr().err
    assert main([*command, *options, "--area", "3 mm"]) == 2
    assert "--area: must be an area" in capsys.readouterr().err


def test_decimal_commas_between_quotation_marks_are_never_guessed(tmp_path: Path) -> None:
    path = tmp_path / "machine.csv"
    path.write_text('"stretch","nominal stress [kPa]"\n"1,1","2,5"\n"1,2","5"\n')
    with pytest.raises(JobError, match="'1,1' is not a number"):
        read_file(path, FileOptions("uniaxial"))
    (test,) = read_file(path, FileOptions("uniaxial", decimal_comma=True)).tests
    assert list(test.measure) == [1.1, 1.2]
    assert list(test.stress) == [2500, 5000]


REMARKS = "Specimen 1;;\n;;\nTime;Tensile strain (Extension);Tensile stress (machine)\n(s);(%);(MPa)\n" + "".join(
    f"{i};{100 * (x - 1):.4g};{f / 25:.4g}\n" for i, (x, f) in enumerate(POINTS)
)


@pytest.mark.parametrize("title", ["Tensile stress (machine)", "tensile  stress (Machine)", "Tensile stress"])
def test_titles_with_remarks_in_brackets_are_named(title: str, tmp_path: Path) -> None:
    path = tmp_path / "machine.csv"
    path.write_text(REMARKS)
    (test,) = read_file(path, FileOptions("uniaxial", columns={title: "nominal stress"})).tests
    assert test.measure == pytest.approx(STRETCH)
    assert test.stress == pytest.approx(np.array(FORCE) / 25e-6)
    path.write_text(REMARKS.replace("Tensile strain (Extension)", "Gauge (top)"))
    columns = {title: "nominal stress", "Gauge (top)": "strain"}
    assert read_file(path, FileOptions("uniaxial", columns=columns)).tests[0].measure == pytest.approx(STRETCH)


def test_the_row_with_most_known_names_is_blamed(tmp_path: Path) -> None:
    path = tmp_path / "machine.csv"
    path.write_text(ZWICK.replace("Standardweg", "Traversenweg"), "latin-1")
    assert len(read_file(path, SPECIMEN).tests[0]) == len(POINTS)
    path.write_text("Temperatur;23;°C\n" + ZWICK.replace("Standardweg", "Aufnehmer 7"), "latin-1")
    with pytest.raises(JobError, match="line 6: unknown column 'Aufnehmer 7'") as caught:
        read_file(path, SPECIMEN)
    assert len(caught.value.problems) == 1
