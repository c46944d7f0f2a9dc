"""Small sets as CSV: one line a contact, the wrench repeated on each line of its grasp.

Columns, in any order: grasp (an integer or a name; equal on consecutive lines of one grasp),
px py pz [m], ax ay az, friction, squeeze [N], fx fy fz [N], tx ty tz [N.m], and optionally
torsion [m], normal_min, normal_max [N], name, source, object, hand. Limits of torques need an ``.npz`` file.
"""

import csv
import os
from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import OPTIONAL_NUMBERS, ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_file import LABELS, LONGEST_LABEL
from jaxgrasp.files.decimal_number import decimal_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file

POINT, NORMAL = ("px", "py", "pz"), ("ax", "ay", "az")
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


def read_csv(path: str | os.PathLike, fill: dict[str, float] | None = None) -> ContactSets:
    """Read a small set; errors name the line and the column."""
    path, fill = Path(path), fill or {}
    try:
        header, numbered = _read_lines(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise GraspFileError(path, f"it is not CSV in UTF-8 ({error})") from error
    needed = ["grasp", *POINT, *NORMAL, *WRENCH, *(c for c in ("friction", "squeeze") if c not in fill)]
    torques = [column for column in ("torque_map", "torque_max") if column in header]
    if torques:
        raise GraspFileError(path, f"it has the column {torques[0]}: limits of torques need an .npz file")
    missing = [column for column in needed if column not in header]
    if missing:
        raise GraspFileError(path, f"it lacks the columns {', '.join(missing)}")
    doubled = {column for column in header if header.count(column) > 1}
    if doubled:
        raise GraspFileError(path, f"it has the column {min(doubled)} twice")
    if not numbered:
        raise GraspFileError(path, "it holds no grasps")
    lines, rows = zip(*numbered, strict=True)
    for line, row in numbered:
        if None in row or None in row.values():
            raise GraspFileError(path, f"line {line} has {'more' if None in row else 'fewer'} cells than the header")
        for name in LABELS:
            if len(row.get(name, "")) > LONGEST_LABEL:
                raise GraspFileError(
                    path,
                    f"line {line}, column {name} is text of {len(row[name]):,} characters: "
                    f"expected at most {LONGEST_LABEL:,}",
                )

    def numbers(columns: tuple[str, ...]) -> np.ndarray:
        return np.array([[_number(path, line, c, row[c]) for c in columns] for line, row in numbered])

    keys = [row["grasp"] for row in rows]
    starts = [i for i, key in enumerate(keys) if i == 0 or key != keys[i - 1]]
    _check_runs(path, keys, starts, lines)
    wrench = numbers(WRENCH)
    offsets = np.array([*starts, len(rows)])
    for i, start in enumerate(starts):
        differs = np.flatnonzero(
            (wrench[start : offsets[i + 1]] != wrench[start]).any(1) & np.isfinite(wrench[start]).all()
        )
        if len(differs):
            raise GraspFileError(path, f"line {lines[start + differs[0]]} has another wrench than its grasp's first")
    contacts = {
        column: np.full(len(rows), fill[column])
        if column in fill and column not in header
        else numbers((column,))[:, 0]
        for column in ("friction", "squeeze", *(name for name in OPTIONAL_NUMBERS if name in header))
    }
    labels = {name: np.array([rows[start][name] for start in starts]) for name in LABELS if name in header}
    return ContactSets(
        numbers(POINT), numbers(NORMAL), **contacts, offsets=offsets, wrench=wrench[starts][:, None], labels=labels
    )


def _read_lines(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """The header, and each row with the number of its (last) line."""
    with open(path, newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream)
        return list(reader.fieldnames or []), [(reader.line_num, row) for row in reader]


def write_csv(path: str | os.PathLike, sets: ContactSets) -> None:
    """Write a small set, whole or not at all; digits enough to read the same numbers back."""
    if sets.wrenches != 1:
        raise ValueError(f"wrench has {sets.wrenches} wrenches a grasp: a CSV file holds one; write an .npz file")
    if sets.torque_map is not None:
        raise ValueError("torque_map is given: a CSV file holds no limits of torques; write an .npz file")
    single = {name: array for name, array in sets.columns.items() if array.ndim == 1}
    header = ["grasp", *POINT, *NORMAL, *single, *WRENCH, *sets.labels]
    rows = [header]
    owner = np.repeat(np.arange(len(sets)), sets.sizes)
    for contact, grasp in enumerate(owner):
        values = [*sets.points[contact], *sets.normals[contact], *(array[contact] for array in single.values())]
        numbers = [repr(float(v)) for v in (*values, *sets.wrench[grasp, 0])]
        rows.append([str(grasp), *numbers, *(str(values[grasp]) for values in sets.labels.values())])

    def write(stream) -> None:
        text = "".join(",".join(_quoted(cell) for cell in row) + "\n" for row in rows)
        stream.write(text.encode())

    replace_file(Path(path), write)


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if any(c in cell for c in ',"\n\r') else cell


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        return decimal_number(text)
    except ValueError as error:
        raise GraspFileError(path, f"line {line}, column {column} {error}") from None


def _check_runs(path: Path, keys: list[str], starts: list[int], lines: tuple[int, ...]) -> None:
    seen: set[str] = set()
    for start in starts:
        if keys[start] in seen:
            raise GraspFileError(
                path, f"line {lines[start]} returns to grasp {shortened(keys[start])}: expected its lines together"
            )
        seen.add(keys[start])
