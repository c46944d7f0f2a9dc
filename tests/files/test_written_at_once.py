"""Several threads that write one path at a time: every reader meets one of their files, whole."""

import os
import threading

import pytest

from jaxgrasp.files.csv_rows import safe_cell, write_rows
from jaxgrasp.files.replace import partial_target, replace_file

BYTES = 200_000
WRITERS, TURNS = 4, 25


def test_threads_that_write_one_path_leave_whole_files(tmp_path):
    path, problems, done = tmp_path / "out.bin", [], threading.Event()
    replace_file(path, lambda stream: stream.write(b"0" * BYTES))

    def write(digit):
        try:
            for _ in range(TURNS):
                replace_file(path, lambda stream: [stream.write(digit) for _ in range(BYTES // 1000)])
        except OSError as error:
            problems.append(error)

    def read():
        while not done.is_set():
            content = path.read_bytes()
            if len(content) != BYTES or len(set(content)) != 1:
                problems.append(f"{len(content)} bytes of {set(content)}")

    writers = [threading.Thread(target=write, args=(bytes([48 + i]) * 1000,)) for i in range(WRITERS)]
    reader = threading.Thread(target=read)
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    done.set()
    reader.join()
    assert problems == []
    assert [path.name for path in tmp_path.iterdir()] == ["out.bin"]


@pytest.mark.parametrize(
    "name, written",
    [
        ('=HYPERLINK("http://example.org")', """'=HYPERLINK("http://example.org")"""),
        ("+1+cmd", "'+1+cmd"),
        ("-2+3", "'-2+3"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\x1b[2Jcup", "\\x1b[2Jcup"),
        ("a\nb", "a\\nb"),
        ("cup 3", "cup 3"),
        ("-1.5", "-1.5"),
        (-1.5, -1.5),
        ("", ""),
    ],
)
def test_text_in_a_table_is_neither_a_formula_nor_control_characters(name, written, tmp_path):
    assert safe_cell(name) == written
    write_rows(tmp_path / "t.csv", [["name"], [name]])
    cell = (tmp_path / "t.csv").read_text().splitlines()[1]
    assert not cell.strip('"').startswith(("=", "+", "@")) and cell.isprintable()


def test_a_partial_file_names_the_file_that_it_was_to_replace(tmp_path):
    """A process that is killed leaves it behind, and whoever tidies up finds it by its name."""
    path, names = tmp_path / "manifest.json", []
    replace_file(path, lambda stream: names.extend(os.listdir(tmp_path)))
    assert [partial_target(name) for name in names] == [path.name]
    assert partial_target(path.name) is None and partial_target(".notes.partial") is None
