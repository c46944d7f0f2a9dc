"""Evaluation of a file of grasps by a worker of a cluster: its task, its file of results and its report.

Folder of results of many files: a file of results for each, by its name, and a manifest of the complete ones.
"""

import json
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

import jax
import numpy as np

from jaxgrasp.batch.arrow_columns import arrow_library
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import Engine
from jaxgrasp.batch.evaluation import Answers
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.result_table import write_parquet_rows
from jaxgrasp.batch.shards import MODULUS, Manifest, hashed, is_whole, names_checksum
from jaxgrasp.batch.sources import open_source
from jaxgrasp.batch.stream import StreamPlan
from jaxgrasp.batch.summary import Summary, from_json, to_json
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.faults import GraspError
from jaxgrasp.model.solution import Verdict, methods_named
from jaxgrasp.numerics.compiled_code import use_cache
from jaxgrasp.quality.measures import Measure

METADATA = b"jaxgrasp"
"""Metadata key of a file of results that holds the file's summary."""


@dataclass(frozen=True)
class ShardTask:
    """A file to evaluate."""

    path: str
    file: str
    """Name of the file of its results."""
    first: int
    """Number of its first grasp among those of all files."""
    earlier: dict | None = None
    """The file's entry in the manifest of an interrupted evaluation."""


@dataclass(frozen=True)
class ShardReport:
    """Outcome of the evaluation of a file."""

    task: ShardTask
    entry: dict | None = None
    """The file's manifest entry; None if there is an error."""
    kept: bool = False
    """True if its results existed already."""
    error: str | None = None
    damaged: bool = False
    """True if the error concerns this file alone, so that the others can go on."""
    times: dict = field(default_factory=dict)


class ShardEvaluator:
    """A worker, which keeps its compiled programs from one file to the next.

    It owns its process: compiled code is kept on disk, as the command line does.
    """

    def __init__(self, plan: StreamPlan, out: str):
        # Without it compiling takes longer, and nothing else.
        with suppress(OSError):
            use_cache()
        self._plan, self._out = plan, Path(out)
        self._methods, self._measures = methods_named(plan.methods), plan.measures

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Evaluate the files of a batch of Ray: the column ``task`` in, the column ``report`` out, both in JSON."""
        tasks = [ShardTask(**json.loads(text)) for text in batch["task"]]
        return {"report": [json.dumps(asdict(self.report(task))) for task in tasks]}

    def report(self, task: ShardTask) -> ShardReport:
        """Evaluate a file, unless its results are there; errors of files are reported, not raised."""
        try:
            with jax.enable_x64(self._plan.dtype == "float64"):
                return self._evaluated(task)
        except GraspFileError as error:
            return ShardReport(task, error=str(error), damaged=True)
        except GraspError as error:
            return ShardReport(task, error=f"{task.path}: {error}", damaged=True)
        except OSError as error:
            path = self._out / task.file
            return ShardReport(task, error=f"{path} cannot be written ({error.strerror or error}): --resume goes on")

    def _evaluated(self, task: ShardTask) -> ShardReport:
        try:
            source = open_source(task.path, self._plan.adjustments)
        except OSError as error:
            raise GraspFileError(task.path, f"it cannot be read ({error.strerror or error})") from error
        path = self._out / task.file
        with source:
            fingerprint, earlier = source.fingerprint, task.earlier
            is_same = earlier is not None and (earlier["fingerprint"], earlier["first"]) == (fingerprint, task.first)
            if earlier is not None and is_same and is_whole(path, earlier):
                return ShardReport(task, earlier, kept=True)
            account = _Account(task, fingerprint)
            engine = Engine(self._methods)

            def results() -> Iterator[dict[str, np.ndarray]]:
                for raw in source.chunks(self._plan.chunk):
                    yield account.enter(self._evaluate_chunk(engine, raw, task, account.grasps), raw, self._measures)

            def write(stream: IO[bytes]) -> None:
                write_parquet_rows(stream, results(), lambda: account.metadata(self._plan))
                stream.flush()
                account.read_back(Path(stream.name))

            replace_file(path, write)
        return ShardReport(task, account.entry(hashed(path)), times=asdict(engine.times))

    def _evaluate_chunk(self, engine: Engine, raw: ContactSets, task: ShardTask, first: int) -> Answers:
        """Evaluate a chunk; a fault names the grasp's number in the file, results are numbered through all files."""
        answers = self._plan.evaluate_chunk(engine, raw, self._measures, first=first, chunk=self._plan.chunk)
        return answers._replace(numbers=answers.numbers + task.first)


@dataclass
class _Account:
    """Counts and checksums of a file while it is evaluated."""

    task: ShardTask
    fingerprint: int
    grasps: int = 0
    names_in: int = 0
    names_aside: int = 0
    names_out: int = 0
    rows: int = 0
    summary: Summary | None = None

    def enter(self, answers: Answers, raw: ContactSets, measures: tuple[Measure, ...]) -> dict[str, np.ndarray]:
        """Count a chunk, and return the arrays of its results."""
        numbers = self.task.first + self.grasps + np.arange(len(raw))
        names = raw.labels.get("name", numbers.astype(str))
        self.names_in = (self.names_in + names_checksum(names)) % MODULUS
        aside = names[~np.isin(numbers, answers.numbers)]
        self.names_aside = (self.names_aside + names_checksum(aside)) % MODULUS
        self.grasps += len(raw)
        chunk_summary = answers.summary(measures)
        self.summary = chunk_summary if self.summary is None else self.summary.merged(chunk_summary)
        return answers.arrays()

    def metadata(self, plan: StreamPlan) -> dict[bytes, bytes]:
        """Return the metadata of the file of results: options, fingerprint and summary, in JSON."""
        assert self.summary is not None
        content = {"options": plan.options, "fingerprint": self.fingerprint, "summary": to_json(self.summary)}
        return {METADATA: json.dumps(content).encode()}

    def read_back(self, path: Path) -> None:
        """Read the written file back, and count its rows and the checksum of its names.

        Raises:
            OSError: if its names differ from those that were evaluated.
        """
        with arrow_library().parquet.ParquetFile(path) as file:
            columns = [name for name in ("name", "wrench") if name in file.schema_arrow.names]
            for batch in file.iter_batches(columns=columns):
                names = batch["name"].to_numpy(zero_copy_only=False)
                if "wrench" in columns:
                    names = names[batch["wrench"].to_numpy() == 0]
                self.names_out = (self.names_out + names_checksum(names)) % MODULUS
                self.rows += len(batch)
        if (self.names_out + self.names_aside) % MODULUS != self.names_in:
            raise OSError("the written file reads back with other content")

    def entry(self, sha256: str) -> dict:
        """Return the manifest entry of the file: counts, checksums of names, verdicts and SHA-256."""
        assert self.summary is not None
        verdicts = {
            name: {verdict.name: count for verdict in Verdict if (count := method.count(verdict))}
            for name, method in self.summary.methods.items()
        }
        return {
            "file": self.task.file,
            "input": self.task.path,
            "fingerprint": self.fingerprint,
            "first": self.task.first,
            "grasps": self.grasps,
            "rows": self.rows,
            "set_aside": self.summary.set_aside,
            "names_in": self.names_in,
            "names_aside": self.names_aside,
            "names_out": self.names_out,
            "verdicts": verdicts,
            "sha256": sha256,
        }


RESULT_NAMES = re.compile(r"[^./\\][^/\\]*\.parquet")
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
        self._file.drop_partial()
        self._file.content["complete"] = False
        self.write()

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
        self._file.drop_partial()
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
