"""Rows of a table in, results out: the callable that Ray, Dask or Spark hand a batch at a time to their workers."""

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxgrasp.batch.arrow_columns import ArrayColumn, FlatColumn, arrow_library, check_sizes, flat_column, grasp_columns
from jaxgrasp.batch.columnar import BY_CONTACT, LABELS, ColumnarGrasps, ColumnOfRows
from jaxgrasp.batch.engine import WIDTHS, Engine
from jaxgrasp.batch.evaluation import Answers, evaluate_sets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.result_table import contact_columns, table_columns
from jaxgrasp.batch.sources import Adjustments
from jaxgrasp.model.solution import METHODS, methods_named
from jaxgrasp.quality.measures import measures_named
from jaxgrasp.quality.task_demands import TaskDemands

BATCH = Path("batch")
"""Name of the rows in messages."""


@dataclass(frozen=True)
class BatchEvaluator:
    """Callable that evaluates batches of rows as [`jaxgrasp.evaluate`][] does, and that can be sent to workers.

    A grasp's answer is the same to the last bit whatever the batch, the order or the worker, on processors of one kind
    and by one version of JAX, and the same as ``evaluate``'s. Measures of quality and the least friction may differ in
    their last digits. Programs are compiled once for each of ``contacts``, in each process.

    Raises:
        ValueError: for unknown names, and numbers that cannot be.
    """

    methods: tuple[str, ...] = tuple(METHODS)
    """Any of ``"A"``, ``"B"``, ``"A-optimum"``, ``"B-optimum"``."""
    _: KW_ONLY
    quality: tuple[str, ...] = ()
    """Measures of quality by their names, as for ``evaluate``."""
    task: TaskDemands | None = None
    """Demands of the measures of a task, as for ``evaluate``."""
    least_friction: bool = False
    """True to find the least friction with which each grasp holds, about half a millisecond a grasp."""
    contacts: tuple[int, ...] = WIDTHS
    """Numbers of contacts, ascending, to the next of which each grasp is filled up; larger grasps are refused."""
    rows: int = 4096
    """Grasps that are computed at a time; fewer cost little less."""
    dtype: str = "float64"
    """Precision of the arithmetic; JAX's 64-bit mode is as it asks for while a batch is computed."""
    skip_bad: bool = False
    """True to leave out grasps with faults instead of raising an error."""
    adjustments: Adjustments = field(default_factory=Adjustments)
    """Corrections of data that differ from the conventions."""

    def __post_init__(self) -> None:
        methods_named(self.methods)
        measures_named(self.quality, self.task)
        if self.dtype not in ("float32", "float64"):
            raise ValueError(f"dtype is {self.dtype!r}: expected 'float32' or 'float64'")
        if self.rows < 1:
            raise ValueError(f"rows is {self.rows}: expected a number of grasps, 1 or more")
        if not self.contacts or list(self.contacts) != sorted({n for n in self.contacts if n > 0}):
            raise ValueError(f"contacts is {self.contacts}: expected numbers, 1 or more, in ascending order")

    def __call__(self, batch: Any) -> dict[str, np.ndarray]:
        """Evaluate a batch; return the rows of ``evaluate``'s table, ``(N * W,)`` by column, with forces and moments.

        Args:
            batch: columns of a grasp file, as a dict of arrays or an Arrow table: ``points`` and ``normals``
                ``(N, n, 3)``, ``friction`` and ``squeeze`` ``(N, n)``, or arrays of N arrays where grasps differ in
                size; ``wrench (N, 6)`` or ``(N, W, 6)``. Optional ones likewise; others are left alone.

        Returns:
            The texts of each grasp that there are (``name``, ``source``, ``object``, ``hand``), and the columns of
            ``results.csv`` without ``grasp``, which a batch cannot know; ``METHOD.forces (N * W, n, 3)`` [N] and, of
            soft fingers, ``METHOD.moments (N * W, n)``, as arrays of arrays where grasps differ in size.

        Raises:
            GraspFileError: for columns that are missing or do not fit.
            GraspError: for the first fault, unless told to skip what is bad.
        """
        with jax.enable_x64(self.dtype == "float64"):
            answers = self._evaluate(batch)
        arrays = answers.arrays()
        columns = table_columns(arrays)
        del columns["grasp"], columns["name"]
        labels = {name: np.repeat(values, answers.sets.wrenches) for name, values in answers.sets.labels.items()}
        return labels | columns | contact_columns(arrays)

    def _evaluate(self, batch: Any) -> Answers:
        with ColumnarGrasps(_BatchArchive(batch), self.adjustments.fill) as source:
            sets = self.adjustments.apply(source.read()).astype(np.dtype(self.dtype))
        return evaluate_sets(
            Engine(methods_named(self.methods)),
            sets,
            measures_named(self.quality, self.task),
            least_friction=self.least_friction,
            skip_bad=self.skip_bad,
            chunk=self.rows,
            buckets=self.contacts,
        )


class _BatchArchive:
    """Archive of the columns of a batch, as flat arrays."""

    path = BATCH

    def __init__(self, batch: Any):
        self._arrays: dict[str, np.ndarray] = {}
        sizes: np.ndarray | None = None
        for name, column in _columns(batch):
            self._arrays[name] = column.array
            if column.sizes is not None:
                sizes = column.sizes if sizes is None else sizes
                check_sizes(BATCH, name, column.sizes, sizes)
        if sizes is not None:
            self._arrays["offsets"] = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self.names = list(self._arrays)

    def checksum(self) -> int:
        """Compute the CRC-32 of the bytes of all columns."""
        return zlib.crc32(b"".join(np.ascontiguousarray(array).tobytes() for array in self._arrays.values()))

    def column(self, name: str) -> ColumnOfRows:
        return ArrayColumn(self._arrays[name])

    def close(self) -> None: ...


def _columns(batch: Any) -> Iterator[tuple[str, FlatColumn]]:
    if isinstance(batch, Mapping):
        for name in grasp_columns(BATCH, list(batch)):
            yield name, _of_array(name, np.asarray(batch[name]))
        return
    arrow = arrow_library()
    if not isinstance(batch, arrow.Table | arrow.RecordBatch):
        raise TypeError(f"batch is a {type(batch).__name__}: expected a dict of arrays or an Arrow table")
    table = batch if isinstance(batch, arrow.Table) else arrow.Table.from_batches([batch])
    for name in grasp_columns(BATCH, table.column_names):
        yield name, flat_column(arrow, BATCH, name, table[name].combine_chunks())


def _of_array(name: str, array: np.ndarray) -> FlatColumn:
    """Flatten a column of any shape; each row of an object column is an array, or an array of arrays."""
    by_contact = name in BY_CONTACT
    if array.dtype.kind != "O":
        if not by_contact or array.ndim < 2:
            return FlatColumn(array, None)
        return FlatColumn(array.reshape(-1, *array.shape[2:]), np.full(len(array), array.shape[1]))
    if name in LABELS:
        return FlatColumn(array.astype(str), None)
    try:
        rows = [np.array(row.tolist() if isinstance(row, np.ndarray) else row) for row in array]
        flat = np.concatenate(rows) if by_contact else np.stack(rows)
    except ValueError as error:
        raise GraspFileError(BATCH, f"{name} holds rows that do not fit together ({error})") from error
    return FlatColumn(flat, np.array([len(row) for row in rows]) if by_contact else None)
