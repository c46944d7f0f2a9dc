"""Engine that runs the methods on blocks of equal shape: compiled once a shape, timed by method, on all devices.

Grouping of contact sets of all sizes into blocks of a few shapes, since each shape takes seconds to compile.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from threading import Lock
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp import kernel
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import ComparedMethod
from jaxgrasp.numerics.compiled_code import padded_size
from jaxgrasp.numerics.kept_programs import Program, key_of
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import flatten, named_weights
from jaxgrasp.solver import in_kernel, phases, transforms
from jaxgrasp.solver.programs import run_stages
from jaxgrasp.solver.result import PhaseResult

WIDTHS = (2, 4, 6, 8, 12, 16, 20, 24, 32, 48, 64)
LARGEST_BLOCK = 1 << 17
"""Problems that are computed at a time: enough to keep every device busy, and few beside what memory holds."""
WORTH_A_SHAPE = 30_000
"""Problems that a shape of its own must serve; below, padding costs less time than compiling."""
LEAST_BLOCK = 128
"""Problems in a block of a device, at least: from here on the solver's tiles have one size, and a problem's answer is
the same to the last bit whatever stands beside it."""


def widths(sizes: np.ndarray, wrenches: int) -> np.ndarray:
    """Compute the padded width of each grasp ``(N,)``: few widths, each for many problems or the largest grasps."""
    if len(sizes) == 0 or np.all(sizes == sizes[0]):
        return sizes.astype(int)
    largest = int(sizes.max())
    steps = [w for w in WIDTHS if w < largest]
    steps += [padded_size(largest, WIDTHS) if largest <= WIDTHS[-1] else largest]
    step = np.searchsorted(steps, sizes)
    for i in range(len(steps) - 1):
        if np.count_nonzero(step == i) * wrenches < WORTH_A_SHAPE:
            step[step == i] = i + 1
    return np.asarray(steps)[step]


def _in_buckets(sizes: np.ndarray, buckets: tuple[int, ...]) -> np.ndarray:
    """Return the smallest of the ascending ``buckets`` that holds each grasp ``(N,)``; the last must hold them all."""
    return np.asarray(buckets)[np.searchsorted(buckets, sizes)]


class Block(NamedTuple):
    """Padded problems of equal shape."""

    rows: np.ndarray
    """Their grasps' indices."""
    grasp: Grasp
    limits: Limits | None
    wrench: np.ndarray


def blocks(sets: ContactSets, chunk: int, devices: int, buckets: tuple[int, ...] | None = None) -> Iterator[Block]:
    """Yield the problems of ``sets`` in padded blocks, grouped by shape.

    The problems of grasp ``i`` of a block stand together, one for each wrench. In a stream of chunks, a
    block is brought to the size of a full ``chunk``, or an eighth of it where grasps of several widths
    share the chunk, by zeros, on which no solver spends time; so later chunks meet shapes that are
    compiled already. The extra answers come last. What is larger than ``LARGEST_BLOCK`` comes in blocks of that size.
    Where ``buckets`` are given, each grasp is brought to the least of these widths, and each block is of ``chunk``
    grasps: so there is one shape for each of them, whatever comes.
    """
    padded = widths(sets.sizes, sets.wrenches) if buckets is None else _in_buckets(sets.sizes, buckets)
    distinct_widths = np.unique(padded)
    step = chunk if len(distinct_widths) == 1 or buckets else max(1, chunk // 8)
    step = max(-(-step // devices), -(-LEAST_BLOCK // sets.wrenches)) * devices
    largest_size = step if buckets else max(devices, LARGEST_BLOCK // sets.wrenches // devices * devices)
    for width in distinct_widths:
        same_width = np.flatnonzero(padded == width)
        size = largest_size if len(same_width) > largest_size else -(-len(same_width) // step) * step
        for start in range(0, len(same_width), size):
            rows = same_width[start : start + size]
            selected = sets if len(rows) == len(sets) else sets.rows(rows)
            widen = partial(widened, missing=size - len(rows), repeats=sets.wrenches)
            grasp, limits = jax.tree.map(widen, (selected.padded(int(width)), selected.limits(int(width))))
            yield Block(rows, grasp, limits, widened(selected.wrench, size - len(rows)).reshape(-1, 6))


def widened(array: np.ndarray, missing: int, repeats: int = 1) -> np.ndarray:
    """Append ``missing`` zero rows to an array, and repeat each row ``repeats`` times."""
    if missing:
        array = np.concatenate([array, np.zeros((missing, *array.shape[1:]), array.dtype)])
    return np.repeat(array, repeats, 0) if repeats > 1 else array


ANSWERED = ("forces", "moments", "verdict", "residual", "objective", "steps", "route", "certificate", "force_bound")
OF_LIMITS = ("normal_multiplier", "torque_multiplier", "certificate_rates")


@dataclass(frozen=True)
class MethodResult:
    """Results of a method on a block of problems."""

    forces: np.ndarray
    """``(B, n, 3)`` [N]."""
    verdict: np.ndarray
    residual: np.ndarray
    objective: np.ndarray
    steps: np.ndarray
    route: np.ndarray
    """Codes of [`jaxgrasp.Route`][]."""
    certificate: np.ndarray
    """``(B, 6)``."""
    force_bound: np.ndarray
    """``(B,)`` [N], as in a Solution."""
    margin: np.ndarray
    """Smallest friction margin of the loaded contacts [rad]; +inf where none is loaded."""
    violation: np.ndarray
    """Largest tangential force beyond friction's limit, max(|t| - mu n) or 0 [N], moments counted as such."""
    moments: np.ndarray | None = None
    """``(B, n)``: of soft fingers [N.m]; this and the following None where there is nothing of the kind."""
    normal_multiplier: np.ndarray | None = None
    """``(B, n)``: multipliers of the bounds of normal forces, as in a Solution."""
    torque_multiplier: np.ndarray | None = None
    """``(B, j)``: multipliers of the bounds of torques."""
    certificate_rates: np.ndarray | None = None
    """``(B, j)``."""


@dataclass
class Times:
    """Seconds spent, compiling apart; those of threads that work side by side add up."""

    compiling: float = 0.0
    solving: dict[str, float] = field(default_factory=dict)
    problems: int = 0


class Engine:
    """Compiled solvers for the blocks of one evaluation, which several threads may run at a time."""

    def __init__(
        self,
        methods: tuple[ComparedMethod, ...],
        devices: int | None = None,
        announce: Callable[[str], None] = lambda text: None,
    ):
        """Create an engine; ``announce`` is told of each number of contacts before its first programs are compiled."""
        self.methods = methods
        self._announce = announce
        self._announced: set[int] = set()
        self.times = Times(solving={method.name: 0.0 for method in methods})
        available = jax.local_devices()
        self._mesh = Mesh(np.array(available[: devices or len(available)]), ("block",))
        self._counting = Lock()

    @property
    def devices(self) -> int:
        return self._mesh.size

    def run(
        self, block: Block, problems: int, methods: tuple[ComparedMethod, ...] | None = None
    ) -> dict[str, dict[str, np.ndarray]]:
        """Run methods on a block, whose size the number of devices divides: fields of results, but for margins.

        ``problems`` of them are the user's, the rest fill the block. ``methods`` are all of the engine's where not
        given.
        """
        methods = self.methods if methods is None else methods
        flat = flatten(block.grasp, block.wrench, None, "squeeze", limits=block.limits, numpy=np)
        problem = jax.tree.map(self._put, flat.problem)
        contacts = problem.points.shape[-2]
        with self._counting:
            self.times.problems += problems
            if contacts not in self._announced:
                self._announced.add(contacts)
                self._announce(f"compiling for grasps of {contacts} contacts ...")
        results: dict[str, dict[str, np.ndarray]] = {}
        for sharing in dict.fromkeys(method.sharing for method in methods):
            weights = named_weights(problem, sharing, jnp)
            results |= self._run_sharing(sharing, replace(problem, weights=weights), methods)
        return {method.name: results[method.name] for method in methods}

    def _run_sharing(
        self, sharing: str, problem: ProblemBatch, methods: tuple[ComparedMethod, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        selected = [method for method in methods if method.sharing == sharing]
        by_kernel = kernel.is_used() and in_kernel.supports(problem)
        closed, closed_s = (None, 0.0) if by_kernel else self._timed(phases.solve_closed, problem)
        results = {}
        for method in selected:
            answer, finish_s = closed, 0.0
            if by_kernel:
                solver = transforms.optimum if method.constrained else transforms.closed_form
                answer, finish_s = self._timed(solver.by_kernel, problem)
            elif method.constrained:
                answer, finish_s = self._optimum(problem, closed)
            with self._counting:
                self.times.solving[method.name] += closed_s + finish_s
            fields = {name: getattr(answer, name) for name in (*ANSWERED, *(OF_LIMITS if method.constrained else ()))}
            results[method.name] = {name: np.asarray(array) for name, array in fields.items() if array is not None}
        return results

    def _optimum(self, problem: ProblemBatch, closed: PhaseResult) -> tuple[PhaseResult, float]:
        """Return the optimum, and the seconds that it took, by the least code that the problems need."""
        state, spent_s = self._timed(phases.start_phases, problem, closed)

        def run(stage: Callable, state: PhaseResult) -> PhaseResult:
            nonlocal spent_s
            result, stage_s = self._timed(stage, problem, state)
            spent_s += stage_s
            return result

        def is_compiled(stage: Callable, state: PhaseResult) -> bool:
            return _program(stage, self._mesh).is_compiled_for((problem, state))

        stages = phases.OPTIMUM_STAGES
        # What limits of torques change is not known before the last phase.
        if problem.torque_bounds is not None:
            return run(stages.finish, state), spent_s
        return run_stages(stages, state, run, is_compiled), spent_s

    def _timed(self, function: Callable, *arguments) -> tuple:
        """Run a compiled function and return its results and the seconds that the run took, without compiling."""
        program = _program(function, self._mesh)
        compiled, compiling = program.compiled(arguments)
        start = time.perf_counter()
        result = jax.block_until_ready(compiled(*arguments))
        spent = time.perf_counter() - start
        with self._counting:
            self.times.compiling += compiling
        return (*result, spent) if type(result) is tuple else (result, spent)

    def _put(self, array: np.ndarray) -> Array:
        return jax.device_put(array, NamedSharding(self._mesh, PartitionSpec("block")))


@cache
def _program(function: Callable, mesh: Mesh) -> Program:
    """Return a program of a function of blocks, on the devices of a mesh."""
    if mesh.size == 1:
        return Program(function, key_of(function))
    rows = PartitionSpec("block")
    # The blocks never talk to each other, so there is nothing for the checker to check.
    return Program(jax.shard_map(function, mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False))
