"""Evaluations larger than memory: chunk after chunk, while the next is read and the last one written."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import Engine, Times
from jaxgrasp.batch.evaluation import run, usable
from jaxgrasp.batch.methods import METHODS, methods_named
from jaxgrasp.batch.shards import ResultFolder, arrays_of
from jaxgrasp.batch.sources import Adjustments, GraspSource
from jaxgrasp.batch.summary import Summary, summarise
from jaxgrasp.batch.summary_json import from_json, to_json
from jaxgrasp.model.faults import GraspError

CHUNK = 65_536


@dataclass(frozen=True)
class Plan:
    """What to compute, and how."""

    methods: tuple[str, ...] = tuple(METHODS)
    chunk: int = CHUNK
    """Grasps at a time."""
    dtype: str = "float64"
    skip_bad: bool = False
    adjustments: Adjustments = field(default_factory=Adjustments)

    def identity(self, name: str, source: GraspSource) -> dict:
        """What must be equal for results to belong to the same evaluation."""
        adjusted = {"outward_normals": self.adjustments.outward_normals, **self.adjustments.fill}
        return {
            "input": name,
            "fingerprint": source.fingerprint,
            "grasps": len(source),
            "methods": list(self.methods),
            "chunk": self.chunk,
            "dtype": self.dtype,
            "skip_bad": self.skip_bad,
            "adjustments": adjusted,
        }


@dataclass(frozen=True)
class Outcome:
    """What is left in memory of a streamed evaluation."""

    summary: Summary
    times: Times
    seconds: float
    """Wall time of this run: reading, computing, writing, compiling."""
    resumed: int
    """Grasps whose results were on disk already."""


def check_all(source: GraspSource, adjustments: Adjustments, chunk: int) -> None:
    """Raise for the first fault of a whole source, before anything is computed."""
    for first, sets in _numbered(source, chunk, 0):
        for fault in adjustments.apply(sets).faults(first):
            raise GraspError(fault)


def evaluate_stream(
    source: GraspSource,
    plan: Plan,
    folder: ResultFolder | None = None,
    progress: Callable[[int], None] = lambda grasps: None,
) -> Outcome:
    """Evaluate every grasp of ``source`` and write the results to ``folder``, if there is one.

    Memory holds a few chunks, whatever the source's size. ``progress`` is told of every finished chunk.
    """
    begun = time.perf_counter()
    methods = methods_named(plan.methods)
    engine = Engine(methods)
    resumed = folder.done if folder else 0
    summary = _summary_so_far(folder) if resumed and folder else None
    if not plan.skip_bad and not resumed:
        check_all(source, plan.adjustments, plan.chunk)
    if folder:
        folder.begin()
    constrained = {method.name for method in methods if method.constrained}
    with ThreadPoolExecutor(1) as writer:
        pending: Future | None = None
        for first, raw in _ahead(_numbered(source, plan.chunk, resumed)):
            sets, kept = usable(plan.adjustments.apply(raw), plan.skip_bad, first)
            sets = sets.astype(np.dtype(plan.dtype))
            results = run(engine, sets, _rows_per_shape(source, plan))
            part = summarise(sets, results, numbers=first + kept, set_aside=len(raw) - len(kept))
            summary = part if summary is None else summary.merged(part)
            if pending:
                pending.result()
            if folder:
                arrays = arrays_of(results, sets.offsets, first + kept, constrained)
                pending = writer.submit(folder.add, arrays, first, first + len(raw), to_json(part))
            progress(len(raw))
        if pending:
            pending.result()
    if summary is None:
        raise ValueError("there are no grasps to evaluate")
    if folder:
        folder.finish(to_json(summary))
    return Outcome(summary, engine.times, time.perf_counter() - begun, resumed)


def _rows_per_shape(source: GraspSource, plan: Plan) -> int:
    """Chunks of a stream are filled up to one size, so that its short last one needs no compiling of its own."""
    return plan.chunk if len(source) > plan.chunk else 1


def _numbered(source: GraspSource, chunk: int, start: int) -> Iterator[tuple[int, ContactSets]]:
    for sets in source.chunks(chunk, start):
        yield start, sets
        start += len(sets)


def _ahead(items: Iterator) -> Iterator:
    """The same items, each read while the one before it is worked on."""
    with ThreadPoolExecutor(1) as reader:
        following = reader.submit(next, items, None)
        while (item := following.result()) is not None:
            following = reader.submit(next, items, None)
            yield item


def _summary_so_far(folder: ResultFolder) -> Summary:
    parts = [from_json(entry["summary"]) for entry in folder.manifest["shards"]]
    whole = parts[0]
    for part in parts[1:]:
        whole = whole.merged(part)
    return whole
