"""Evaluation of contact sets in memory: every method on every grasp and wrench."""

import warnings
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.batch.chunk_statistics import rank
from jaxgrasp.batch.contact_sets import ContactSets, as_sets
from jaxgrasp.batch.engine import ANSWERED, Engine, MethodResult, Times, blocks
from jaxgrasp.batch.qualities import (
    clip_to_one,
    least_friction_of,
    margins,
    measure_all,
    normal_force_ratio,
    summarise_qualities,
    total_squeeze,
    with_little_squeeze,
)
from jaxgrasp.batch.reasons import judge, reasons
from jaxgrasp.batch.result_table import table_columns
from jaxgrasp.batch.shards import arrays_of
from jaxgrasp.batch.summary import Summary, summarise
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import GraspError
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import METHODS, ComparedMethod, Verdict, methods_named
from jaxgrasp.quality.measures import Columns, Measure, measures_named
from jaxgrasp.quality.task_demands import TaskDemands
from jaxgrasp.validation.checked import checked


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Results of every method on N grasps of M contacts in all, with W wrenches each; ``print`` shows a summary.

    ``results[name]`` holds arrays ``(N, W)``, with ``forces`` as ``(M, W, 3)`` in the order of
    ``sets.points``, ``moments`` and ``normal_multiplier`` likewise as ``(M, W)``, ``certificate`` as ``(N, W, 6)`` and
    what belongs to joints as ``(N, W, j)``. ``quality`` holds arrays ``(N,)``, by MEASURE.COLUMN.
    """

    sets: ContactSets
    results: dict[str, MethodResult]
    why: np.ndarray
    """Codes of [`Reason`][jaxgrasp.batch.reasons.Reason], ``(N, W)``: 0 where a grasp holds, else why not."""
    summary: Summary
    times: Times
    quality: dict[str, np.ndarray]
    numbers: np.ndarray
    """``(N,)``: numbers of the grasps in the input, since grasps with faults may have been left out."""
    least_friction: np.ndarray | None = None
    """``(N, W)``: the least factor on its friction with which each grasp holds, where asked for."""
    squeeze_factor: np.ndarray | None = None
    """``(N, W)``: the factor on its squeezing forces with which each grasp holds: 1 where it does as it squeezes, NaN
    where it does not hold, or where its squeezing forces are zero."""

    def __repr__(self) -> str:
        methods = ", ".join(self.results)
        wrenches = f" x {self.sets.wrenches} wrenches" if self.sets.wrenches > 1 else ""
        ranked = self.summary.ranked
        holds = f", {ranked.holds:,} hold" if ranked else ""
        holds += f", {ranked.harder:,} if they squeeze harder" if ranked and ranked.harder else ""
        return f"Evaluation({len(self.sets):,} grasps{wrenches} by {methods}{holds}; print it for more)"

    def table(self) -> dict[str, np.ndarray]:
        """Return columns with a row for each grasp and wrench, as ``jaxgrasp evaluate`` writes to ``results.csv``.

        ``pandas.DataFrame(found.table())`` makes a data frame of it.
        """
        arrays = arrays_of(
            self.sets, self.results, self.why, self.numbers, self.quality, self.least_friction, self.squeeze_factor
        )
        return table_columns(arrays)

    def __str__(self) -> str:
        """Format the summary as text."""
        return summary_text(self.summary, self.times, self.times.compiling + sum(self.times.solving.values()))


@checked
def evaluate(
    grasps: ContactSets | Grasp,
    wrenches: AnyArray | None = None,
    *,
    limits: Limits | None = None,
    methods: tuple[str, ...] = tuple(METHODS),
    quality: tuple[str, ...] = (),
    task: TaskDemands | None = None,
    least_friction: bool = False,
    progress: Progress | None = None,
    dtype: str | np.dtype | None = None,
    skip_bad: bool = False,
    normalize: bool = False,
    devices: int | None = None,
) -> Evaluation:
    """Compute closed forms and constrained optima of many grasps, and compare them.

    Args:
        grasps: contact sets of any sizes, or one batch of grasps ``(N, n)``.
        wrenches: ``(N, 6)``, ``(N, W, 6)`` or ``(6,)`` [N, N.m]; not needed for contact sets, which hold theirs.
        limits: of a batch of grasps, of its shape; contact sets hold theirs. They bind the optima alone.
        methods: any of ``"A"``, ``"B"``, ``"A-optimum"``, ``"B-optimum"``; what is not asked for is not computed.
        quality: measures of the grasps, some of ``jaxgrasp.quality.measures.MEASURES`` and, of a task,
            ``TASK_MEASURES``, likewise.
        task: what the measures of a task ask for, as [`jaxgrasp.quality.load_demands`][] reads it.
        least_friction: whether to find the least friction with which each grasp holds, about half a
            millisecond a grasp.
        progress: is told how many more grasps are measured, every few hundred; what it raises ends the evaluation.
        dtype: ``"float64"`` or ``"float32"``; the data's own where not given. float64 needs JAX's 64-bit mode.
        skip_bad: leave out grasps with faults instead of raising; ``summary.set_aside`` counts them.
        normalize: make every normal length 1, as those of tables with few digits are not.
        devices: how many of JAX's local devices to use; all where not given.

    Warns:
        UserWarning: naming grasps whose normals point away from the middle of their contacts.

    Raises:
        GraspError: for the first fault of the data, before anything is computed.
        ValueError: for an unknown method or measure, or float64 asked for while JAX's 64-bit mode is off.
    """
    sets = as_sets(grasps, wrenches, limits)
    sets = sets.normalized() if normalize else sets
    engine, measures = Engine(methods_named(methods), devices), measures_named(quality, task)
    answers = evaluate_sets(
        engine,
        sets.astype(_precision(sets, dtype)),
        measures,
        least_friction=least_friction,
        progress=progress,
        skip_bad=skip_bad,
    )
    summary = answers.summary(measures)
    if warning := summary.outward.warning("expected normals into the object"):
        # Past the wrapper that checks arguments, to the user's own line.
        warnings.warn(warning, stacklevel=3)
    return Evaluation(
        answers.sets,
        answers.results,
        answers.why,
        summary,
        engine.times,
        answers.quality,
        answers.numbers,
        answers.least_friction,
        answers.squeeze_factor,
    )


class Answers(NamedTuple):
    """Results of contact sets, as an Evaluation holds them."""

    sets: ContactSets
    results: dict[str, MethodResult]
    why: np.ndarray
    quality: Columns
    numbers: np.ndarray
    least_friction: np.ndarray | None
    squeeze_factor: np.ndarray
    set_aside: int
    """Number of grasps with faults, which ``sets`` does not contain."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return these results as the arrays of a shard."""
        return arrays_of(
            self.sets, self.results, self.why, self.numbers, self.quality, self.least_friction, self.squeeze_factor
        )

    def summary(self, measures: tuple[Measure, ...]) -> Summary:
        """Summarise these results: counts, distributions, qualities and rankings."""
        return replace(
            summarise(self.sets, self.results, numbers=self.numbers, set_aside=self.set_aside),
            qualities=summarise_qualities(measures, self.quality),
            ranked=rank(
                self.sets,
                self.results,
                self.why,
                self.quality,
                self.least_friction,
                self.numbers,
                self.squeeze_factor,
            ),
        )


def evaluate_sets(
    engine: Engine,
    sets: ContactSets,
    measures: tuple[Measure, ...] = (),
    *,
    least_friction: bool = False,
    progress: Progress | None = None,
    skip_bad: bool = False,
    checked: bool = False,
    first: int = 0,
    chunk: int = 1,
    buckets: tuple[int, ...] | None = None,
) -> Answers:
    """Compute results, qualities and factors of sets whose first grasp has the number ``first`` in the input.

    ``progress`` is told of grasps that are measured; ``checked`` sets have no faults; ``chunk`` and ``buckets`` are
    those of ``run``.

    Raises:
        GraspError: for the first fault, unless told to skip what is bad.
    """
    valid, indices = (sets, np.arange(len(sets))) if checked else usable(sets, skip_bad, first)
    if buckets is not None:
        _check_fit(valid.sizes, first + indices, buckets[-1])
    results = run(engine, valid, chunk, buckets)
    factor = squeeze_factors(engine, valid, results, chunk, buckets)
    return Answers(
        valid,
        results,
        reasons(valid, results, factor),
        measure_all(measures, valid, progress),
        first + indices,
        least_friction_of(valid) if least_friction else None,
        factor,
        len(sets) - len(valid),
    )


def _check_fit(sizes: np.ndarray, numbers: np.ndarray, largest: int) -> None:
    """Raise ValueError for grasps, by their numbers in the input, that no bucket holds."""
    too_large = np.flatnonzero(sizes > largest)
    if len(too_large):
        at = too_large[0]
        raise ValueError(
            f"grasp {numbers[at]} has {sizes[at]} contacts: expected at most {largest}, the largest of contacts"
        )


def usable(sets: ContactSets, skip_bad: bool, first_grasp: int = 0) -> tuple[ContactSets, np.ndarray]:
    """Return the grasps without faults and their indices; raise GraspError for the first fault unless ``skip_bad``."""
    faulty = set()
    for fault in sets.faults(first_grasp):
        if not skip_bad:
            raise GraspError(fault)
        faulty.add(fault.index[0] - first_grasp)
    indices = np.setdiff1d(np.arange(len(sets)), np.fromiter(faulty, int))
    return (sets.rows(indices) if faulty else sets), indices


def squeeze_factors(
    engine: Engine,
    sets: ContactSets,
    results: dict[str, MethodResult],
    chunk: int = 1,
    buckets: tuple[int, ...] | None = None,
) -> np.ndarray:
    """Return the factor on its squeezing forces with which each grasp holds, ``(N, W)``, as far as an optimum shows.

    It is 1 where a closed form lies inside every cone, or where allowed forces press no harder in all than the
    squeezing forces: the grasp holds as it squeezes. Otherwise it is the sum of normal forces over the sum of squeezing
    forces. Optima stay close to the squeezing forces, so those that need more are found once more with next to no
    squeeze, where they are as small as they can be: mostly within 1 %, and at most a third, of what
    `jaxgrasp.least_squeeze` finds at more cost. NaN where no answer holds, and where the hand squeezes with nothing.
    """
    if not len(sets):
        return np.zeros((0, sets.wrenches))
    squeezed, factor = total_squeeze(sets), np.full((len(sets), sets.wrenches), np.nan)
    for result in results.values():
        needed = normal_force_ratio(sets, result.forces, result.verdict, squeezed)
        factor = np.fmin(factor, np.where(result.verdict == Verdict.CLOSED_FORM_OPTIMAL, 1, needed))
    factor = clip_to_one(sets, factor)
    method, harder = METHODS[judge(results)], factor > 1
    if harder.any() and method.constrained:
        little = with_little_squeeze(sets, harder)
        again = run_shaped(engine, little, chunk, buckets, (method,))[method.name]
        needed = normal_force_ratio(little, again["forces"], again["verdict"], squeezed)
        factor = np.where(harder, np.fmin(factor, needed), factor)
    return clip_to_one(sets, factor)


def run(
    engine: Engine, sets: ContactSets, chunk: int = 1, buckets: tuple[int, ...] | None = None
) -> dict[str, MethodResult]:
    """Run every method of the engine on every problem; answers are in the order of ``sets``.

    ``chunk`` is the number of grasps in a full chunk, for a stream of them; see ``blocks``.
    """
    shaped = run_shaped(engine, sets, chunk, buckets)
    return {name: _with_margins(arrays, sets) for name, arrays in shaped.items()}


def run_shaped(
    engine: Engine,
    sets: ContactSets,
    chunk: int,
    buckets: tuple[int, ...] | None,
    methods: tuple[ComparedMethod, ...] | None = None,
) -> dict[str, dict[str, np.ndarray]]:
    """Run methods on every problem: fields of results but for margins, in the order of ``sets``.

    Problems solved by some of the engine's ``methods`` alone do not count as evaluated once more; their time does.
    """
    shaped: dict[str, dict[str, np.ndarray]] = {}
    for block in blocks(sets, chunk, engine.devices, buckets):
        counted = len(block.rows) * sets.wrenches if methods is None else 0
        for method, part in engine.run(block, counted, methods).items():
            arrays = shaped.setdefault(method, {name: _empty(name, sets) for name in part})
            _scatter_block(arrays, part, block.rows, sets)
    if not shaped:
        return {method.name: {name: _empty(name, sets) for name in ALWAYS} for method in methods or engine.methods}
    return shaped


def _with_margins(arrays: dict[str, np.ndarray], sets: ContactSets) -> MethodResult:
    margin, violation = margins(sets, arrays["forces"], arrays.get("moments"))
    return MethodResult(**arrays, margin=margin, violation=violation)


BY_CONTACT = ("forces", "moments", "normal_multiplier")
MOSTLY_ZERO = ("certificate", "force_bound")
ALWAYS = tuple(name for name in ANSWERED if name != "moments")
"""Fields that every method returns."""


def _empty(name: str, sets: ContactSets) -> np.ndarray:
    if name in BY_CONTACT:
        return np.empty((len(sets.points), sets.wrenches, *((3,) if name == "forces" else ())), sets.points.dtype)
    tail: tuple[int, ...] = (6,) if name == "certificate" else ()
    if name in ("torque_multiplier", "certificate_rates"):
        assert sets.torque_max is not None
        tail = sets.torque_max.shape[1:]
    integer_types = {"verdict": np.int8, "steps": np.int32, "route": np.int8}
    # Zeros that nobody writes to take no memory, though they are there.
    make = np.zeros if name in MOSTLY_ZERO else np.empty
    return make((len(sets), sets.wrenches, *tail), integer_types.get(name, sets.points.dtype))


def _scatter_block(
    shaped: dict[str, np.ndarray], part: dict[str, np.ndarray], rows: np.ndarray, sets: ContactSets
) -> None:
    """Copy a block's answers to the rows of its grasps in the arrays of all sets, without the padding."""
    used = len(rows) * sets.wrenches
    sizes = sets.sizes[rows]
    for name, target in shaped.items():
        values = part[name][:used]
        values = values.reshape(len(rows), sets.wrenches, *values.shape[1:])
        if name not in BY_CONTACT:
            if name not in MOSTLY_ZERO or values.any():
                target[rows] = values
            continue
        width = values.shape[2]
        by_contact = np.swapaxes(values, 1, 2)
        if len(rows) == len(sets) and np.all(sizes == width):
            target[:] = by_contact.reshape(target.shape)
        else:
            mask = np.arange(width) < sizes[:, None]
            target[_contacts_of(rows, sets)] = by_contact[mask]


def _contacts_of(rows: np.ndarray, sets: ContactSets) -> np.ndarray:
    sizes = sets.sizes[rows]
    ends = np.cumsum(sizes)
    return np.repeat(sets.offsets[:-1][rows] - (ends - sizes), sizes) + np.arange(ends[-1] if len(ends) else 0)


def _precision(sets: ContactSets, dtype: str | np.dtype | None) -> np.dtype:
    precision = np.dtype(dtype or np.result_type(*sets.columns.values(), sets.wrench, np.float32))
    if precision not in (np.float32, np.float64):
        raise ValueError(f"dtype is {precision}: expected float32 or float64")
    if precision == np.float64 and not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "dtype is float64 while JAX's 64-bit mode is off: call jax.config.update('jax_enable_x64', True) first, "
            "or pass dtype='float32'"
        )
    return precision
