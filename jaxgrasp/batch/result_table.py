"""Results as a table for spreadsheets and data frames, with a row for each grasp and wrench.

Columns, in this order:

    grasp, name        number in the input, from 0; its own name, or the number again
    wrench             number of the wrench, only where grasps have several
    contacts           how many
    holds, why         yes, harder (if it squeezes harder), no or unknown by the best judge among the methods; the title
                       of a Reason
    METHOD.verdict     the name of a [`jaxgrasp.Verdict`][]
    METHOD.margin_deg  smallest friction margin of the loaded contacts; empty where the forces balance nothing
    METHOD.largest_force_N   likewise
    A.price, B.price   price of friction, a share; empty where there is no optimum to compare with
    squeeze_factor     by which factor on its squeezing forces it holds: 1 as it squeezes; empty where it does not hold
    least_friction     with --least-friction: the least factor on the friction with which it holds, perhaps inf
    MEASURE.COLUMN     measures of quality that were asked for
    METHOD.forces      in Parquet alone: a list of [x, y, z] for each contact [N]
    METHOD.moments     likewise, of soft fingers: a number for each contact [N.m]

The first rows of an evaluation's table in the order of any of its columns, read shard by shard.
"""

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from jaxgrasp.batch.arrow_columns import arrow_library, parquet_writer
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.qualities import objective_gap
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.shards import MANIFEST
from jaxgrasp.files.csv_rows import safe_cell
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.solution import METHODS, is_balanced, is_optimum, verdict_names

SMALL_TABLE = 100_000
"""Largest number of rows of a table that is written without being asked for."""
UNKNOWN = (Reason.SLIPS, Reason.NOT_DECIDED, Reason.INVALID_DATA)
Shard = Mapping[str, np.ndarray]
"""Arrays as ``shards.arrays_of`` names them."""


def table_columns(shard: Shard) -> dict[str, np.ndarray]:
    """Return the columns of the table of a shard without forces, each ``(N * W,)``; text as arrays of str."""
    why = shard["why"]
    count, wrenches = why.shape
    number = np.repeat(shard["grasp"], wrenches)
    columns: dict[str, np.ndarray] = {
        "grasp": number,
        "name": np.repeat(shard["name"], wrenches) if "name" in shard else number.astype(str),
    }
    if wrenches > 1:
        columns["wrench"] = np.tile(np.arange(wrenches), count)
    columns["contacts"] = np.repeat(np.diff(shard["offsets"]), wrenches)
    unknown = np.isin(why, UNKNOWN)
    answer = np.where(why == Reason.HOLDS, "yes", np.where(why == Reason.HARDER, "harder", "no"))
    columns["holds"] = np.where(unknown, "unknown", answer).ravel()
    columns["why"] = np.array([reason.title for reason in Reason])[why.ravel()]
    methods = [name for name in METHODS if f"{name}.verdict" in shard]
    for name in methods:
        columns |= {f"{name}.{column}": values for column, values in _method_columns(shard, name).items()}
    for name in methods:
        optimum = f"{name}-optimum"
        if optimum in methods:
            verdict = shard[f"{optimum}.verdict"]
            price = objective_gap(shard[f"{name}.objective"], shard[f"{optimum}.objective"], verdict)
            columns[f"{name}.price"] = np.where(is_optimum(verdict), np.maximum(price, 0), np.nan).ravel()
    if "squeeze_factor" in shard:
        columns["squeeze_factor"] = shard["squeeze_factor"].ravel()
    if "least_friction" in shard:
        columns["least_friction"] = shard["least_friction"].ravel()
    for name, values in shard.items():
        if name.startswith("quality."):
            columns[name.removeprefix("quality.")] = np.repeat(values, wrenches)
    return columns


def first_rows(shards: Iterable[Shard], count: int) -> dict[str, np.ndarray]:
    """Return the columns of the first shards until they have ``count`` rows or more."""
    parts: list[dict[str, np.ndarray]] = []
    for shard in shards:
        parts.append(table_columns(shard))
        if sum(len(part["grasp"]) for part in parts) >= count:
            break
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}


def _method_columns(shard: Shard, name: str) -> dict[str, np.ndarray]:
    verdict = shard[f"{name}.verdict"].ravel()
    balanced = is_balanced(verdict)
    sizes = np.linalg.norm(shard[f"{name}.forces"], axis=-1)
    largest = np.maximum.reduceat(sizes, shard["offsets"][:-1], axis=0).ravel() if len(sizes) else np.zeros(0)
    return {
        "verdict": verdict_names(verdict),
        "margin_deg": np.where(balanced, np.degrees(shard[f"{name}.margin"].ravel()), np.nan),
        "largest_force_N": np.where(balanced, largest, np.nan),
    }


def write_table(path: Path, shards: Iterable[Shard]) -> None:
    """Write the table of these shards, as CSV or Parquet by the file's name, whole or not at all.

    Raises:
        ImportError: for Parquet without the extra `table`.
    """
    writer = write_parquet_rows if path.suffix == ".parquet" else _write_csv
    if path.suffix == ".parquet":
        arrow_library()
    replace_file(path, lambda stream: writer(stream, shards))


def _write_csv(stream: IO[bytes], shards: Iterable[Shard]) -> None:
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
    writer = csv.writer(text, lineterminator="\n")
    for number, shard in enumerate(shards):
        columns = table_columns(shard)
        if number == 0:
            writer.writerow(columns)
        writer.writerows(zip(*(_cells(values) for values in columns.values()), strict=True))
    text.detach()


def _cells(values: np.ndarray) -> Iterator[Any]:
    """Yield the cells of a column: numbers with all digits, empty text for NaN, text safe in spreadsheets."""
    for value in values.tolist():
        yield "" if isinstance(value, float) and value != value else safe_cell(value)


def write_parquet_rows(
    stream: IO[bytes], shards: Iterable[Shard], metadata: Callable[[], dict[bytes, bytes]] = dict
) -> None:
    """Write the table of these shards as Parquet; ``metadata`` is asked for at the end, when all have come."""
    arrow = arrow_library()
    writer = None
    try:
        for shard in shards:
            columns: dict[str, Any] = {name: arrow.array(values) for name, values in table_columns(shard).items()}
            columns |= _contact_lists(arrow, shard)
            table = arrow.table(columns)
            writer = writer or parquet_writer(arrow, stream, table.schema)
            writer.write_table(table)
        if writer is not None:
            writer.add_key_value_metadata(metadata())
    finally:
        if writer is not None:
            writer.close()


def _contact_lists(arrow: Any, shard: Shard) -> dict[str, Any]:
    """Convert ``METHOD.forces`` and ``METHOD.moments`` to Arrow lists, a list for each grasp and wrench."""
    order = _by_row(shard)
    offsets = arrow.array(np.concatenate([[0], np.cumsum(order.sizes)]).astype(np.int32))
    columns = {}
    for name in _contact_fields(shard):
        values = arrow.array(shard[name][order.contact, order.wrench].ravel())
        if shard[name].ndim == 3:
            values = arrow.FixedSizeListArray.from_arrays(values, 3)
        columns[name] = arrow.ListArray.from_arrays(offsets, values)
    return columns


def _contact_fields(shard: Shard) -> list[str]:
    return [
        name for method in METHODS for quantity in ("forces", "moments") if (name := f"{method}.{quantity}") in shard
    ]


class _RowOrder(NamedTuple):
    """Indices of the contacts of all rows of a table, in the order of the rows."""

    sizes: np.ndarray
    """Contacts of each row ``(N * W,)``."""
    contact: np.ndarray
    wrench: np.ndarray


def _by_row(shard: Shard) -> _RowOrder:
    wrenches = shard["why"].shape[1]
    sizes = np.repeat(np.diff(shard["offsets"]), wrenches)
    ends = np.cumsum(sizes)
    first = np.repeat(shard["offsets"][:-1], wrenches)
    contact = np.repeat(first - (ends - sizes), sizes) + np.arange(ends[-1] if len(ends) else 0)
    return _RowOrder(sizes, contact, np.repeat(np.tile(np.arange(wrenches), len(shard["why"])), sizes))


def contact_columns(shard: Shard) -> dict[str, np.ndarray]:
    """Return ``METHOD.forces`` and ``METHOD.moments`` by row: ``(N * W, n, ...)``, or object arrays if sizes differ."""
    order = _by_row(shard)
    columns, uniform = {}, len(np.unique(order.sizes)) == 1
    for name in _contact_fields(shard):
        flat = shard[name][order.contact, order.wrench]
        if uniform:
            columns[name] = flat.reshape(len(order.sizes), -1, *flat.shape[1:])
        else:
            columns[name] = np.empty(len(order.sizes), object)
            columns[name][:] = np.split(flat, np.cumsum(order.sizes)[:-1])
    return columns


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
