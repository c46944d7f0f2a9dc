"""Sets as CSV: one line a contact, the wrench repeated on each line of its grasp.

Columns, in any order: grasp (an integer or a name; equal on consecutive lines of one grasp, and the grasp's name where
there is no column name), px py pz [m], ax ay az, friction, squeeze [N], fx fy fz [N], tx ty tz [N.m], and optionally
torsion [m], normal_min, normal_max [N], name, source, object, hand. Limits of torques need a file of another kind.
Lines above that of the columns' names that begin with # are comments.
"""

import csv
import io
import os
from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from jaxgrasp.batch.columnar import LABELS, LONGEST_LABEL
from jaxgrasp.batch.contact_sets import OPTIONAL_NUMBERS, ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.files.csv_rows import formula_as_text, text_of_formula
from jaxgrasp.files.file_numbers import decimal_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file

POINT, NORMAL = ("px", "py", "pz"), ("ax", "ay", "az")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
TOGETHER = {"points": POINT, "normals": NORMAL}
GRASPS_AT_A_TIME = 1_000
"""Grasps whose lines are made at a time: as text they take ten times the memory."""
NUMBERS = (*POINT, *NORMAL, *WRENCH, "friction", "squeeze", *OPTIONAL_NUMBERS)


def read_csv(path: str | os.PathLike, fill: dict[str, float] | None = None) -> ContactSets:
    """Read a set; errors name the line and the column."""
    path, fill = Path(path), fill or {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = next((row for row in reader if not (row and row[0].startswith("#"))), [])
            _check_header(path, header, fill)
            table = _read_rows(path, header, reader)
    except (UnicodeDecodeError, csv.Error) as error:
        raise GraspFileError(path, f"it is not CSV in UTF-8 ({error})") from error
    if not table.starts:
        raise GraspFileError(path, "it holds no grasps")
    column = dict(zip(table.columns, table.numbers.T, strict=True))
    together = {name: np.stack([column[one] for one in some], 1) for name, some in TOGETHER.items()}
    offsets = np.array([*table.starts, len(table.numbers)])
    wrench = np.stack([column[one][offsets[:-1]] for one in WRENCH], 1)
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
        together["points"], together["normals"], **contacts, offsets=offsets, wrench=wrench[:, None], labels=labels
    )


def _differing(column: dict[str, np.ndarray], wrench: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Lines whose wrench is not that of their grasp's first; a component at a time, for the sake of memory."""
    unlike = np.zeros(int(sizes.sum()), bool)
    for k, name in enumerate(WRENCH):
        unlike |= column[name] != np.repeat(wrench[:, k], sizes)
    return np.flatnonzero(unlike & np.repeat(np.isfinite(wrench).all(1), sizes))


class _Table(NamedTuple):
    """What the lines of a file hold, one row each."""

    columns: list[str]
    """Those of numbers, in the order of the file."""
    numbers: np.ndarray
    """``(rows, columns)``."""
    lines: array
    """Number of each row's (last) line."""
    starts: list[int]
    """The first row of each grasp."""
    grasps: list[str]
    """What the column ``grasp`` calls each."""
    labels: dict[str, list[str]]
    """What each grasp is called, by the label's name."""


def _check_header(path: Path, header: list[str], fill: dict[str, float]) -> None:
    needed = ["grasp", *POINT, *NORMAL, *WRENCH, *(c for c in ("friction", "squeeze") if c not in fill)]
    torques = [column for column in ("torque_map", "torque_max") if column in header]
    if torques:
        raise GraspFileError(path, f"it has the column {torques[0]}: limits of torques need an .npz file")
    missing = [column for column in needed if column not in header]
    if missing:
        raise GraspFileError(path, f"it lacks the columns {', '.join(missing)}")
    doubled = [column for column, times in Counter(header).items() if times > 1]
    if doubled:
        raise GraspFileError(path, f"it has the column {shortened(min(doubled))} twice")


def _read_rows(path: Path, header: list[str], reader: Any) -> _Table:
    """Every row as numbers at once: the text of a large file takes ten times the memory."""
    places = [k for k, name in enumerate(header) if name in NUMBERS]
    labels = {name: (header.index(name), list[str]()) for name in LABELS if name in header}
    numbers, lines, starts, of_grasp = array("d"), array("q"), [], header.index("grasp")
    seen: dict[str, None] = {}
    last = None
    for row in reader:
        if not row:
            continue
        line = reader.line_num
        if len(row) != len(header):
            raise GraspFileError(
                path, f"line {line} has {'more' if len(row) > len(header) else 'fewer'} cells than the header"
            )
        if row[of_grasp] != last:
            last = row[of_grasp]
            if last in seen:
                raise GraspFileError(
                    path, f"line {line} returns to grasp {shortened(last)}: expected its lines together"
                )
            seen[_label(path, line, "grasp", last)] = None
            starts.append(len(lines))
            for name, (place, values) in labels.items():
                values.append(text_of_formula(_label(path, line, name, row[place])))
        for place in places:
            numbers.append(_number(path, line, header[place], row[place]))
        lines.append(line)
    columns = [header[place] for place in places]
    shaped = np.frombuffer(numbers).reshape(len(lines), len(columns)) if lines else np.zeros((0, len(columns)))
    return _Table(
        columns,
        shaped,
        lines,
        starts,
        [text_of_formula(cell) for cell in seen],
        {name: values for name, (_, values) in labels.items()},
    )


def _label(path: Path, line: int, name: str, text: str) -> str:
    if len(text) > LONGEST_LABEL:
        raise GraspFileError(
            path, f"line {line}, column {name} is text of {len(text):,} characters: expected at most {LONGEST_LABEL:,}"
        )
    return text


def write_csv(path: str | os.PathLike, sets: ContactSets) -> None:
    """Write a set, whole or not at all; digits enough to read the same numbers back."""
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
    """The lines of some grasps, the first of which has this number."""
    single = [array for array in sets.columns.values() if array.ndim == 1]
    owner = np.repeat(np.arange(len(sets)), sets.sizes)
    numbers = np.column_stack([sets.points, sets.normals, *single, sets.wrench[owner, 0]]).astype(float)
    labels = [values.tolist() for values in sets.labels.values()]
    for grasp, line in zip(owner.tolist(), numbers.tolist(), strict=True):
        yield [first + grasp, *line, *(formula_as_text(values[grasp]) for values in labels)]


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        return decimal_number(text)
    except ValueError as error:
        raise GraspFileError(path, f"line {line}, column {column} {error}") from None
