"""The first rows of an evaluation's table in the order of any of its columns, read shard by shard."""

import json
from pathlib import Path

import numpy as np

from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.manifest import MANIFEST
from jaxgrasp.batch.result_table import table_columns

IDENTITY_COLUMNS = ("grasp", "name", "wrench", "contacts", "holds", "why")


def ranked_rows(folder: Path, by: str, top: int, smallest: bool = False) -> dict[str, np.ndarray]:
    """Read the ``top`` rows in the order of the column ``by``: the columns ``IDENTITY_COLUMNS`` and that column.

    Rows without a number in that column are left out. Of equal numbers the earlier grasp comes first. Memory holds one
    shard.

    Args:
        folder: the results of an evaluation.
        by: a column with numbers, or the name of a measure of quality, which stands for its first column.
        top: how many rows, at least 1.
        smallest: True to put the smallest number first instead of the largest.

    Raises:
        GraspFileError: for a folder that holds no results, or a column that is not there or holds no numbers.
    """
    if top < 1:
        raise ValueError(f"top is {top}: expected 1 or more")
    best: dict[str, np.ndarray] = {}
    for file in _files(folder):
        with np.load(file, allow_pickle=False) as arrays:
            columns = table_columns(dict(arrays))
        column = _named(folder, by, columns)
        chosen = {name: columns[name] for name in (*IDENTITY_COLUMNS, column) if name in columns}
        rows = {name: np.concatenate([best[name], part]) if best else part for name, part in chosen.items()}
        values = np.asarray(rows[column], float)
        order = np.argsort(values if smallest else -values, kind="stable")
        order = order[~np.isnan(values[order])][:top]
        best = {name: part[order] for name, part in rows.items()}
    return best


def _files(folder: Path) -> list[Path]:
    """Read the manifest of a folder and return its files of results, in the order of the input."""
    path = folder / MANIFEST
    try:
        files = [folder / entry["file"] for entry in json.loads(path.read_text())["shards"]]
    except FileNotFoundError:
        raise GraspFileError(folder, f"it has no {MANIFEST}: expected a folder that jaxgrasp evaluate wrote") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise GraspFileError(path, f"it was not written by jaxgrasp evaluate ({error})") from error
    if not files:
        raise GraspFileError(folder, "its evaluation has no results yet")
    return files


def _named(folder: Path, by: str, columns: dict[str, np.ndarray]) -> str:
    numbers = [name for name, values in columns.items() if values.dtype.kind in "iuf" and name not in IDENTITY_COLUMNS]
    for name in numbers:
        if name == by or name.startswith(f"{by}."):
            return name
    raise GraspFileError(folder, f"by is {by!r}: expected one of {', '.join(numbers)}")
