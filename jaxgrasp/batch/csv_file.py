"""Contact sets as CSV: a line for each contact, the wrench repeated on each line of its grasp.

Columns, in any order: grasp (an integer or a name; equal on consecutive lines of one grasp, and the grasp's name where
there is no column name), px py pz [m], ax ay az, friction, squeeze [N], fx fy fz [N], tx ty tz [N.m], and optionally
torsion [m], normal_min, normal_max [N], name, source, object, hand. Limits of torques need a file of another kind.
Lines above that of the columns' names that begin with # are comments. Commas, semicolons or tabs separate columns, as
the line of their names shows; columns of other names are not used, and a warning names them; spaces around names and
numbers do not count, nor do lines without any entry. Where semicolons or tabs separate, numbers may have decimal
commas, all of a file or none.
"""

import csv
import io
import os
import re
from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from jaxgrasp.batch.columnar import LABELS, LONGEST_LABEL
from jaxgrasp.batch.contact_sets import OPTIONAL_NUMBERS, ContactSets
from jaxgrasp.batch.file_error import GraspFileError, describe_unknown, warn_unused_columns
from jaxgrasp.files.csv_rows import formula_as_text, text_of_formula
from jaxgrasp.files.file_values import decimal_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file

POINT, NORMAL = ("px", "py", "pz"), ("ax", "ay", "az")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
VECTORS = {"points": POINT, "normals": NORMAL}
GRASPS_AT_A_TIME = 1_000
"""Grasps whose lines are made at a time: as text they take ten times the memory."""
NUMBERS = (*POINT, *NORMAL, *WRENCH, "friction", "squeeze", *OPTIONAL_NUMBERS)
COLUMNS = {"grasp", *NUMBERS, *LABELS}
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
SEPARATOR_LINE = re.compile(r"sep=(.)", re.IGNORECASE)
"""The first line of files in which Excel is told the separator."""


def read_csv(path: str | os.PathLike, fill: dict[str, float] | None = None) -> ContactSets:
    """Read contact sets from a CSV file; errors name the line and the column, a warning the columns not used."""
    path, fill = Path(path), fill or {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            table = _read_table(path, stream, fill)
    except (UnicodeDecodeError, csv.Error) as error:
        raise GraspFileError(path, f"it is not CSV in UTF-8 ({error})") from error
    if not table.starts:
        raise GraspFileError(path, "it holds no grasps")
    column = dict(zip(table.columns, table.numbers.T, strict=True))
    vectors = {
        name: np.stack([column[component] for component in components], 1) for name, components in VECTORS.items()
    }
    offsets = np.array([*table.starts, len(table.numbers)])
    wrench = np.stack([column[component][offsets[:-1]] for component in WRENCH], 1)
    differs = _differing(column, wrench, np.diff(offsets))
    if len(differs):
        raise GraspFileError(path, f"line {table.lines[differs[0]]} has another wrench than its grasp's first")
    contacts = {
        name: column[name].copy() if name in column else np.full(len(table.numbers), fill[name])
        for name in ("friction", "squeeze", *(name for name in OPTIONAL_NUMBERS if name in column))
    }
    labels = {name: np.array(values) for name, values in table.labels.items()}
    if "name" not in labels and table.grasps != list(map(str, range(len(table.grasps)))):
        labels["name"] = np.array(table.grasps)
    return ContactSets(
        vectors["points"],
        vectors["normals"],
        **contacts,
        offsets=offsets,
        wrench=wrench[:, None],
        labels=labels,
        lines=np.array(table.lines),
    )


def _read_table(path: Path, stream: IO[str], fill: dict[str, float]) -> "_Table":
    """Read the line of names, which says how columns are separated, and every row below it."""
    above, separator = 0, None
    for line in stream:
        above += 1
        if (match := SEPARATOR_LINE.fullmatch(line.strip("\r\n "))) and above == 1:
            separator = match[1]
        elif not line.startswith("#"):
            break
    else:
        line = ""
    layout = _layout(line, separator)
    _check_header(path, layout, fill)
    reader = csv.reader(stream, delimiter=layout.separator, skipinitialspace=layout.spaced)
    return _read_rows(path, layout, above, reader)


class _Layout(NamedTuple):
    """Layout of a file's lines: names of the columns and their separator."""

    header: list[str]
    """Names of the columns, without the spaces around them."""
    separator: str
    spaced: bool
    """True if names have spaces around them, so that spaces around texts do not belong to the texts either."""


def _layout(line: str, separator: str | None = None) -> _Layout:
    """Return the layout that a line of names shows: of the separator with which most of the names are known."""
    layouts = []
    for candidate in [separator] if separator else SEPARATORS:
        names = next(csv.reader([line], delimiter=candidate, skipinitialspace=True), [])
        raw = next(csv.reader([line], delimiter=candidate), [])
        stripped = [name.strip() for name in names]
        layouts.append(_Layout(stripped, candidate, stripped != raw))
    return max(layouts, key=lambda layout: len(COLUMNS.intersection(layout.header)))


def _differing(column: dict[str, np.ndarray], wrench: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Find the lines whose wrench differs from the first line of their grasp; a component at a time, to save memory."""
    unlike = np.zeros(int(sizes.sum()), bool)
    for k, name in enumerate(WRENCH):
        unlike |= column[name] != np.repeat(wrench[:, k], sizes)
    return np.flatnonzero(unlike & np.repeat(np.isfinite(wrench).all(1), sizes))


class _Table(NamedTuple):
    """Contents of a file's lines, a row for each line."""

    columns: list[str]
    """Names of the columns of numbers, in the order of the file."""
    numbers: np.ndarray
    """``(rows, columns)``."""
    lines: array
    """Number of each row's (last) line."""
    starts: list[int]
    """The first row of each grasp."""
    grasps: list[str]
    """Text of each grasp in the column ``grasp``."""
    labels: dict[str, list[str]]
    """Text of each grasp, by the label's name."""


def _check_header(path: Path, layout: _Layout, fill: dict[str, float]) -> None:
    header = layout.header
    needed = ["grasp", *POINT, *NORMAL, *WRENCH, *(c for c in ("friction", "squeeze") if c not in fill)]
    torques = [column for column in ("torque_map", "torque_max") if column in header]
    if torques:
        raise GraspFileError(path, f"it has the column {torques[0]}: limits of torques need an .npz file")
    missing = [column for column in needed if column not in header]
    if missing:
        separated = "" if COLUMNS.intersection(header) else ": expected names with commas, semicolons or tabs between"
        if similar := describe_unknown(header, COLUMNS, only_close=True):
            separated += f"; it has {', '.join(similar)}"
        raise GraspFileError(path, f"it lacks the columns {', '.join(missing)}{separated}")
    doubled = [column for column, times in Counter(filter(None, header)).items() if times > 1]
    if doubled:
        raise GraspFileError(path, f"it has the column {shortened(min(doubled))} twice")
    warn_unused_columns(path, header, COLUMNS)


def _read_rows(path: Path, layout: _Layout, above: int, reader: Any) -> _Table:
    """Read every row as numbers at once: the text of a large file takes ten times the memory."""
    header = layout.header
    number_columns = [k for k, name in enumerate(header) if name in NUMBERS]
    labels = {name: (header.index(name), list[str]()) for name in LABELS if name in header}
    numbers, lines, starts, of_grasp = array("d"), array("q"), [], header.index("grasp")
    read_number = _NumberReader(path, layout.separator)
    grasps: dict[str, None] = {}
    current = None
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        line = above + reader.line_num
        if layout.spaced:
            row = [cell.strip() for cell in row]
        if len(row) != len(header):
            raise GraspFileError(path, _other_cells(line, len(row) > len(header), layout.separator))
        if row[of_grasp] != current:
            current = row[of_grasp]
            if current in grasps:
                raise GraspFileError(
                    path, f"line {line} returns to grasp {shortened(current)}: expected its lines together"
                )
            grasps[_label(path, line, "grasp", current)] = None
            starts.append(len(lines))
            for name, (index, values) in labels.items():
                values.append(text_of_formula(_label(path, line, name, row[index])))
        for index in number_columns:
            numbers.append(read_number(line, header[index], row[index]))
        lines.append(line)
    columns = [header[index] for index in number_columns]
    shaped = np.frombuffer(numbers).reshape(len(lines), len(columns)) if lines else np.zeros((0, len(columns)))
    return _Table(
        columns,
        shaped,
        lines,
        starts,
        [text_of_formula(cell) for cell in grasps],
        {name: values for name, (_, values) in labels.items()},
    )


def _other_cells(line: int, is_longer: bool, separator: str) -> str:
    text = f"line {line} has {'more' if is_longer else 'fewer'} cells than the header"
    if is_longer and separator == ",":
        text += ": where numbers have decimal commas, semicolons must separate the columns"
    return text


def _label(path: Path, line: int, name: str, text: str) -> str:
    if len(text) > LONGEST_LABEL:
        raise GraspFileError(
            path, f"line {line}, column {name} is text of {len(text):,} characters: expected at most {LONGEST_LABEL:,}"
        )
    return text


def write_csv(path: str | os.PathLike, sets: ContactSets) -> None:
    """Write contact sets, whole or not at all, with digits enough to read the same numbers back."""
    if sets.wrenches != 1:
        raise ValueError(f"wrench has {sets.wrenches} wrenches a grasp: a CSV file holds one; write an .npz file")
    if sets.torque_map is not None:
        raise ValueError("torque_map is given: a CSV file holds no limits of torques; write an .npz file")
    single = {name: array for name, array in sets.columns.items() if array.ndim == 1}
    header = ["grasp", *POINT, *NORMAL, *single, *WRENCH, *sets.labels]

    def write(stream: IO[bytes]) -> None:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(header)
        for first in range(0, len(sets), GRASPS_AT_A_TIME):
            writer.writerows(_rows(sets.rows(slice(first, first + GRASPS_AT_A_TIME)), first))
        text.flush()
        text.detach()

    replace_file(Path(path), write)


def _rows(sets: ContactSets, first: int) -> Iterator[list]:
    """Yield the lines of these grasps as lists of cells; ``first`` is the number of the first grasp."""
    single = [array for array in sets.columns.values() if array.ndim == 1]
    owner = np.repeat(np.arange(len(sets)), sets.sizes)
    numbers = np.column_stack([sets.points, sets.normals, *single, sets.wrench[owner, 0]]).astype(float)
    labels = [values.tolist() for values in sets.labels.values()]
    for grasp, line in zip(owner.tolist(), numbers.tolist(), strict=True):
        yield [first + grasp, *line, *(formula_as_text(values[grasp]) for values in labels)]


DECIMAL_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


class _NumberReader:
    """Reader of the numbers of a file, whose decimal marks are all points or all commas."""

    def __init__(self, path: Path, separator: str) -> None:
        self._path = path
        self._may_have_commas = separator != ","
        self._mark = ""
        """Decimal mark of the first number that has a mark."""
        self._marked_at = ""

    def __call__(self, line: int, column: str, text: str) -> float:
        """Return the number in a cell.

        Raises:
            GraspFileError: for a text that is no number, and for a decimal mark that differs from the others'.
        """
        mark = "," if "," in text else "." if "." in text else ""
        if mark and self._may_have_commas:
            self._check_mark(mark, line, column, text)
            if mark == "," and DECIMAL_COMMA.fullmatch(text.strip(" \t")):
                text = text.replace(",", ".")
        try:
            return decimal_number(text)
        except ValueError as error:
            raise GraspFileError(self._path, f"line {line}, column {column} {error}") from None

    def _check_mark(self, mark: str, line: int, column: str, text: str) -> None:
        if not self._mark:
            self._mark, self._marked_at = mark, f"line {line}, column {column}"
        elif mark != self._mark:
            names = {",": "a comma", ".": "a point"}
            raise GraspFileError(
                self._path,
                f"line {line}, column {column} is {shortened(text)}, with {names[mark]}, where {self._marked_at} has "
                f"{names[self._mark]}: expected one decimal mark in the whole file, and no marks of thousands",
            )
