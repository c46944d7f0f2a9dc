"""Evaluations larger than memory: a chunk on each core, while the next is read and the last one written."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from threading import Event

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import Engine, Times
from jaxgrasp.batch.evaluation import Answers, evaluate_sets
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import Adjustments, GraspSource, numbered_chunks
from jaxgrasp.batch.summary import Summary, from_json, to_json
from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.faults import GraspError
from jaxgrasp.model.solution import METHODS, methods_named
from jaxgrasp.quality.measures import Measure, measures_named
from jaxgrasp.quality.task_demands import TaskDemands

CHUNK = 16_384


@dataclass(frozen=True)
class StreamPlan:
    """Options of a streamed evaluation: methods, measures, precision and size of chunks."""

    methods: tuple[str, ...] = tuple(METHODS)
    chunk: int = CHUNK
    """Grasps at a time."""
    dtype: str = "float64"
    skip_bad: bool = False
    adjustments: Adjustments = field(default_factory=Adjustments)
    quality: tuple[str, ...] = ()
    """Measures of quality, by name."""
    least_friction: bool = False
    """True to find the least factor on the friction with which each grasp holds."""
    task: TaskDemands | None = None
    """Demands of the measures of a task."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return measures_named(self.quality, self.task)

    def identity(self, name: str, source: GraspSource) -> dict:
        """Return the fields that must be equal for results to belong to the same evaluation."""
        return {"input": name, "fingerprint": source.fingerprint, "grasps": len(source), **self.options}

    @property
    def options(self) -> dict:
        """The plan, as a manifest has it."""
        adjusted = {"outward_normals": self.adjustments.outward_normals, **self.adjustments.fill}
        if self.adjustments.torsion is not None:
            adjusted["torsion"] = self.adjustments.torsion
        if self.adjustments.normalize:
            adjusted["normalize"] = True
        return {
            "methods": list(self.methods),
            "quality": list(self.quality),
            "least_friction": self.least_friction,
            **({} if self.task is None else {"task": self.task.to_json()}),
            "chunk": self.chunk,
            "dtype": self.dtype,
            "skip_bad": self.skip_bad,
            "adjustments": adjusted,
        }

    def evaluate_chunk(
        self,
        engine: Engine,
        raw: ContactSets,
        measures: tuple[Measure, ...],
        *,
        first: int,
        chunk: int,
        checked: bool = False,
        progress: Progress | None = None,
    ) -> Answers:
        """Adjust grasps as they were read and evaluate them by the plan; the first grasp has the number ``first``."""
        return evaluate_sets(
            engine,
            self.adjustments.apply(raw).astype(np.dtype(self.dtype)),
            measures,
            least_friction=self.least_friction,
            progress=progress,
            skip_bad=self.skip_bad,
            checked=checked,
            first=first,
            chunk=chunk,
        )


@dataclass(frozen=True)
class StreamResult:
    """Summary and times of a streamed evaluation, whose results are on disk."""

    summary: Summary
    times: Times
    seconds: float
    """Wall time of this run: reading, computing, writing, compiling."""
    resumed: int
    """Grasps whose results were on disk already."""


def check_all(source: GraspSource, adjustments: Adjustments, chunk: int) -> None:
    """Raise for the first fault of a whole source, before anything is computed."""
    for first, sets in numbered_chunks(source, chunk, 0):
        for fault in adjustments.apply(sets).faults(first):
            raise GraspError(fault)


def evaluate_stream(
    source: GraspSource,
    plan: StreamPlan,
    folder: ResultFolder | None = None,
    progress: Callable[[int], None] = lambda grasps: None,
    announce: Callable[[str], None] = lambda text: None,
    measured: Callable[[int], None] = lambda grasps: None,
) -> StreamResult:
    """Evaluate every grasp of ``source`` and write the results to ``folder``, if there is one.

    Memory holds a few chunks, whatever the source's size. ``progress`` is told of every finished chunk, ``announce``
    what is about to be compiled, and ``measured`` of some hundred grasps of a chunk at a time whose quality is known,
    by any thread. What ends it ends the chunks at work too, and leaves the finished ones in the folder.
    """
    started = time.perf_counter()
    methods, measures = methods_named(plan.methods), plan.measures
    engine = Engine(methods, announce=announce)
    damaged = _damaged(folder, plan, announce) if folder else []
    resumed = folder.done if folder else 0
    summary = from_json(folder.summary) if folder and folder.summary else None
    if plan.least_friction:
        announce("compiling the search for the least friction, which takes up to a minute ...")
    checked = not plan.skip_bad and not resumed
    if checked:
        check_all(source, plan.adjustments, plan.chunk)
    if folder:
        folder.begin()
    stop = Event()
    report_progress = partial(_report_progress, stop, measured)
    task = partial(_evaluate_chunk, plan, engine, measures, _rows_per_shape(source, plan), checked, report_progress)
    for entry in damaged:
        assert folder is not None
        recomputed = task(entry["start"], next(iter(source.chunks(plan.chunk, entry["start"]))))
        folder.replace(entry, recomputed.arrays)
    for chunk in _in_order(task, numbered_chunks(source, plan.chunk, resumed), _workers(engine), stop):
        summary = chunk.summary if summary is None else summary.merged(chunk.summary)
        if folder:
            folder.add(chunk.arrays, chunk.start, chunk.stop, to_json(summary))
        progress(chunk.stop - chunk.start)
    if summary is None:
        raise ValueError("there are no grasps to evaluate")
    if folder:
        folder.finish()
    return StreamResult(summary, engine.times, time.perf_counter() - started, resumed)


def _damaged(folder: ResultFolder, plan: StreamPlan, announce: Callable[[str], None]) -> list[dict]:
    """Return the shards to compute again; if a damaged file holds more than a chunk, forget all shards."""
    damaged = folder.damaged()
    for entry in damaged:
        announce(f"{folder.folder / entry['file']} is missing or damaged: computed again")
    if any(entry["stop"] - entry["start"] > plan.chunk or entry["file"] == "results.npz" for entry in damaged):
        folder.start_over()
        return []
    return damaged


@dataclass(frozen=True)
class _Chunk:
    """Results of the grasps ``start`` to ``stop`` of the input."""

    start: int
    stop: int
    arrays: dict[str, np.ndarray]
    """The arrays of its shard."""
    summary: Summary


def _evaluate_chunk(
    plan: StreamPlan,
    engine: Engine,
    measures: tuple[Measure, ...],
    rows_per_shape: int,
    checked: bool,
    progress: Progress,
    start: int,
    raw: ContactSets,
) -> _Chunk:
    answers = plan.evaluate_chunk(
        engine, raw, measures, first=start, chunk=rows_per_shape, checked=checked, progress=progress
    )
    return _Chunk(start, start + len(raw), answers.arrays(), answers.summary(measures))


def _report_progress(stop: Event, measured: Callable[[int], None], grasps: int) -> None:
    """Report the progress of a chunk, or raise CancelledError if the evaluation has stopped."""
    if stop.is_set():
        raise CancelledError
    measured(grasps)


def _workers(engine: Engine) -> int:
    """Return the number of chunks to compute at a time: each keeps a core busy, whatever the number of devices."""
    return 2


def _in_order(task: Callable[..., _Chunk], items: Iterable[tuple], workers: int, stop: Event) -> Iterator[_Chunk]:
    """Yield the task's results in the order of ``items``, computed by ``workers`` threads.

    A further item waits in the queue; ``stop`` is set once the results are no longer consumed.
    """
    pool = ThreadPoolExecutor(workers)
    running: deque[Future[_Chunk]] = deque()
    try:
        for item in items:
            running.append(pool.submit(task, *item))
            if len(running) > workers:
                yield running.popleft().result()
        while running:
            yield running.popleft().result()
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


def _rows_per_shape(source: GraspSource, plan: StreamPlan) -> int:
    """Return the size to which chunks of a stream are padded, so that the short last chunk needs no compiling."""
    return plan.chunk if len(source) > plan.chunk else 1
