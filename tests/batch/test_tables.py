"""CSV tables as spreadsheets and people write them are read to the same numbers, or refused by line and grasp."""

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.cli.main import main

NAMES = ["grasp", "px", "py", "pz", "ax", "ay", "az", "friction", "squeeze", "fx", "fy", "fz", "tx", "ty", "tz"]
ROWS = [
    ["left", "0.03", "0", "0", "-1", "0", "0", "0.5", "5", "0", "0", "2.25", "0", "0", "0"],
    ["left", "-0.03", "0", "0", "1", "0", "0", "0.5", "5e0", "0", "0", "2.25", "0", "0", "0"],
    ["right", ".02", "0", "0", "-1", "0", "0", "0.5", "5", "0", "0", "1e-3", "0", "0", "0"],
    ["right", "-.02", "0", "0", "1", "0", "0", "0.5", "5", "0", "0", "1e-3", "0", "0", "0"],
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def table(separator=",", end="\n", names=NAMES, rows=ROWS):
    return end.join(separator.join(row) for row in [names, *rows]) + end


def decimal_commas(rows=ROWS):
    return [[row[0], *(cell.replace(".", ",") for cell in row[1:])] for row in rows]


PLAIN = table()
WRITTEN = {
    "semicolons": table(";"),
    "tabs": table("\t"),
    "a space after each comma": table(", "),
    "spaces on both sides": table(" ; "),
    "aligned by tabs and spaces": table("\t "),
    "decimal commas": table(";", rows=decimal_commas()),
    "decimal commas and tabs": table("\t", rows=decimal_commas()),
    "Windows lines": table(";", "\r\n"),
    "a byte order mark": "\ufeff" + table(";"),
    "Excel's line of the separator": "sep=;\n" + table(";"),
    "comments above": "# of Monday; by hand\n# two grasps\n" + table(";"),
    "quoted cells": table(", ", rows=[[f'"{cell}"' for cell in row] for row in ROWS]),
    "empty lines at the end": PLAIN + "," * (len(NAMES) - 1) + "\n\n",
    "an empty column": table(",", names=[*NAMES, ""], rows=[[*row, ""] for row in ROWS]),
}


@pytest.mark.parametrize("text", WRITTEN.values(), ids=WRITTEN)
def test_however_a_table_is_written_it_reads_as_the_same_grasps(folder, text):
    (folder / "plain.csv").write_text(PLAIN)
    (folder / "other.csv").write_text(text, encoding="utf-8")
    plain, rewritten = jaxgrasp.load_grasps("plain.csv"), jaxgrasp.load_grasps("other.csv")
    for name in ("points", "normals", "friction", "squeeze", "wrench", "offsets"):
        np.testing.assert_array_equal(getattr(rewritten, name), getattr(plain, name))
    assert rewritten.labels["name"].tolist() == ["left", "right"]


def test_spaces_in_names_that_we_write_read_back(folder):
    (folder / "plain.csv").write_text(PLAIN)
    plain = jaxgrasp.load_grasps("plain.csv")
    jaxgrasp.save_grasps("named.csv", plain, name=[" a", "b "])
    assert jaxgrasp.load_grasps("named.csv").labels["name"].tolist() == [" a", "b "]


def changed(row, column, cell, separator=",", rows=ROWS):
    rows = [list(row) for row in rows]
    rows[row][NAMES.index(column)] = cell
    return table(separator, rows=rows)


REFUSED = {
    "two decimal marks": (
        changed(1, "squeeze", "5.5", ";", decimal_commas()),
        "line 3, column squeeze is '5.5', with a point, where line 2, column px has a comma: expected one decimal mark",
    ),
    "marks of thousands": (changed(1, "squeeze", "1.234,5", ";", decimal_commas()), "line 3, column squeeze is '1.23"),
    "thousands by commas": (changed(1, "squeeze", "1,234.5", ";"), "line 3, column squeeze is '1,234.5'"),
    "decimal commas between commas": (
        table(",", rows=decimal_commas()),
        "line 2 has more cells than the header: wh",
    ),
    "other separators": (table("|"), "expected names with commas, semicolons or tabs between"),
    "a number that cannot be": (changed(3, "squeeze", "-5"), r"^line 5, grasp 'right': squeeze\[1, 1\] is -5.0"),
    "a normal of four digits": (
        changed(3, "ax", "0.995"),
        r"^line 5, grasp 'right': normals\[1, 1\] .* of length 0.995: expected a vector of length 1.*--normalize",
    ),
    "a wrench that is no number": (
        table(rows=[*ROWS[:2], *([*row[:-1], "nan"] for row in ROWS[2:])]),
        r"^line 4, grasp 'right': wrench\[1\]",
    ),
}


@pytest.mark.parametrize("text, message", REFUSED.values(), ids=REFUSED)
def test_errors_name_the_line_and_the_grasp(folder, text, message):
    (folder / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        jaxgrasp.load_grasps("bad.csv")


def test_lines_are_those_of_the_file_with_its_comments(folder, capsys):
    (folder / "bad.csv").write_text("# one\n# two\n" + changed(2, "friction", "-1").replace("left,-", "\nleft,-"))
    assert main(["validate", "bad.csv"]) == 1
    assert capsys.readouterr().out.startswith("line 7, grasp 'right': friction[1, 0] is -1.0")


@pytest.mark.parametrize("length", [0.995, 0.7071, 2e-3])
def test_normals_are_made_length_1_where_that_is_asked_for(folder, capsys, length):
    rows = [[*row[:4], str(length * float(row[4])), *row[5:]] for row in ROWS]
    (folder / "plain.csv").write_text(PLAIN)
    (folder / "short.csv").write_text(table(rows=rows))
    plain, made = jaxgrasp.load_grasps("plain.csv"), jaxgrasp.load_grasps("short.csv", normalize=True)
    np.testing.assert_allclose(made.normals, plain.normals, rtol=0, atol=1e-15)
    assert main(["validate", "short.csv"]) == 1
    assert main(["validate", "short.csv", "--normalize"]) == 0
    assert main(["convert", "short.csv", "long.npz", "--normalize"]) == 0
    np.testing.assert_allclose(jaxgrasp.load_grasps("long.npz").normals, plain.normals, rtol=0, atol=1e-15)


def test_a_normal_of_no_length_stays_a_fault(folder):
    (folder / "zero.csv").write_text(changed(0, "ax", "0"))
    with pytest.raises(ValueError, match=r"line 2, grasp 'left': normals\[0, 0\]"):
        jaxgrasp.load_grasps("zero.csv", normalize=True)


def test_validate_warns_of_millimetres(folder, capsys):
    (folder / "mm.csv").write_text(table(rows=[[row[0], str(1000 * float(row[1])), *row[2:]] for row in ROWS]))
    assert main(["validate", "mm.csv"]) == 0
    assert capsys.readouterr().out.startswith("warning: contacts lie metres apart: are the lengths in millimetres?")


def test_a_grasp_without_a_name_is_called_by_its_number(folder):
    rows = [[str(k // 2), *row[1:]] for k, row in enumerate(ROWS)]
    (folder / "bad.csv").write_text(changed(3, "squeeze", "-5", rows=rows))
    with pytest.raises(ValueError, match=r"^line 5, grasp 1: squeeze\[1, 1\] is -5.0"):
        jaxgrasp.load_grasps("bad.csv")
