"""Folder of results of many files: a file of results for each, by its name, and a manifest of the complete ones."""

import json
import re
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from jaxgrasp.batch.arrow import arrow_library
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.manifest import Manifest
from jaxgrasp.batch.name_checksum import MODULUS
from jaxgrasp.batch.shard_evaluator import METADATA
from jaxgrasp.batch.summary import Summary
from jaxgrasp.batch.summary_json import from_json

RESULT_NAMES = re.compile(r"[^./\\][^/\\]*\.parquet")
PARTIAL = re.compile(r"\.([^/\\]+\.parquet|manifest\.json)\.\d+\.partial")
SIDE_FILES = ("summary.json", "report.html")
SECONDS = 5.0
"""Time between two writes of the manifest [s]; after an interrupt, files that it does not name are computed again."""
COUNTED = ("grasps", "rows", "set_aside")
CHECKSUMS = ("names_in", "names_aside", "names_out")


class ShardFolder:
    """The output folder of an evaluation of many files, to be held (``held_folder``) while it is open."""

    def __init__(
        self,
        folder: Path,
        options: dict,
        versions: str,
        files: Iterable[str],
        resume: bool,
        overwrite: bool = False,
    ):
        """Open ``folder`` for results of these names, by these options; see ``Manifest``.

        Raises:
            GraspFileError: as for ``Manifest``, and where it holds results of files that are no longer asked for.
        """
        self.folder, self._files = folder, dict.fromkeys(files)
        identity = {"kind": "a file of results for each file", **options, "versions": versions}
        self._file = Manifest(folder, identity, RESULT_NAMES, resume, overwrite, self._files.__contains__)
        self._entries = {entry["file"]: entry for entry in self._file.content["shards"]}
        self._written = 0.0
        stale = next((name for name in self._entries if name not in self._files), None)
        if stale is not None:
            raise GraspFileError(
                folder, f"it holds results of {stale}, which is not among the inputs: choose another --out"
            )

    def entry(self, file: str) -> dict | None:
        """Return the manifest entry of a file of results; None if there is no complete file."""
        return self._entries.get(file)

    def begin(self) -> None:
        """Make room: remove an earlier, finished evaluation and leftovers of an interrupt, and nothing else."""
        self._file.drop_earlier(SIDE_FILES)
        self._drop_partial()
        self._file.content["complete"] = False
        self.write()

    def _drop_partial(self) -> None:
        """Remove partial files of processes that have ended."""
        for path in self.folder.iterdir():
            if PARTIAL.fullmatch(path.name):
                path.unlink(missing_ok=True)

    def add(self, entry: dict) -> None:
        """Add the entry of a complete file, and write the manifest if the last write is ``SECONDS`` ago."""
        self._entries[entry["file"]] = entry
        if time.monotonic() - self._written > SECONDS:
            self.write()

    def drop(self, file: str) -> None:
        """Remove the entry of earlier results of a file that cannot be read now."""
        self._entries.pop(file, None)

    def write(self) -> None:
        """Write the manifest, its files in the order of the input."""
        self._file.content["shards"] = [self._entries[name] for name in self._files if name in self._entries]
        self._file.write()
        self._written = time.monotonic()

    def finish(self, skipped: list[dict], grasps: dict[str, int]) -> Summary:
        """Check that nothing is lost and nothing doubled, mark the evaluation complete, and return the whole summary.

        ``skipped`` are the files that could not be read, ``grasps`` how many each of the others has.

        Raises:
            GraspFileError: where what was written is not what was read.
        """
        entries = [self._entries[name] for name in self._files if name in self._entries]
        totals = {name: sum(entry[name] for entry in entries) for name in COUNTED}
        totals |= {name: sum(entry[name] for entry in entries) % MODULUS for name in CHECKSUMS}
        expected = sum(grasps[entry["file"]] for entry in entries)
        names = (totals["names_out"] + totals["names_aside"]) % MODULUS
        if {entry["file"] for entry in entries} != set(grasps) or totals["grasps"] != expected:
            raise GraspFileError(self.folder, f"it has {totals['grasps']:,} grasps: expected {expected:,}")
        if names != totals["names_in"]:
            raise GraspFileError(self.folder, "the names of its grasps are not those of the input")
        summary = None
        for entry in entries:
            part = from_json(self._metadata(entry["file"])["summary"])
            summary = part if summary is None else summary.merged(part)
        if summary is None:
            raise GraspFileError(self.folder, "there are no grasps to evaluate")
        self._drop_partial()
        self._file.content |= {"complete": True, "totals": totals, "skipped": skipped}
        self.write()
        return summary

    def _metadata(self, file: str) -> dict:
        return json.loads(arrow_library().parquet.read_metadata(self.folder / file).metadata[METADATA])

    def first_rows(self, most: int) -> dict[str, np.ndarray]:
        """Read the first rows of all results, at most ``most``, without forces and moments; return them by column."""
        arrow, tables, count = arrow_library(), [], 0
        for name in self._files:
            if name in self._entries and count < most:
                with arrow.parquet.ParquetFile(self.folder / name) as file:
                    columns = [c for c in file.schema_arrow.names if not c.endswith((".forces", ".moments"))]
                    batch = next(file.iter_batches(most, columns=columns), None)
                if batch is not None:
                    tables.append(batch.slice(0, most - count))
                    count += len(tables[-1])
        table = arrow.Table.from_batches(tables)
        return {name: _as_array(table[name].to_numpy()) for name in table.column_names}


def _as_array(column: np.ndarray) -> np.ndarray:
    return column.astype(str) if column.dtype == object else column
