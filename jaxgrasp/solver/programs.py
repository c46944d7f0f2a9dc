"""Programs of plain calls: a batch in chunks of a few sizes, each solved phase by phase.

Outside of other programs a batch is cut into chunks of few sizes, so that a new size seldom compiles. Only the last
chunk is padded, and its tiles stop at the true count: so padding costs neither time nor, in large batches, memory.
Where the kernel solves, a size that comes again has a program of its own, which takes 0.02 s to compile.

A solver with ``Stages`` is compiled stage by stage: whether a batch needs the next stage is read from the result of the
last, which the call waits for. An answer is the same to the last bit as when all stages are one program.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import Verdict
from jaxgrasp.numerics.compiled_code import padded_size
from jaxgrasp.numerics.kept_programs import Program, key_of
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import FlatInput, flatten
from jaxgrasp.solver.in_kernel import has_room_for
from jaxgrasp.solver.phases import Stages
from jaxgrasp.solver.result import PhaseResult

SIZES = (1, 10, 100, 1000, 3000, 10000)
"""What programs are compiled for: round numbers, since users like them. Larger pieces would not be faster: a call is
dear beside some hundred problems alone."""
LEAST_WHOLE = 1000
"""From this size on a piece is worth a call of its own; what is left after such pieces is padded instead."""
MAX_ASSEMBLERS = 16
"""Sizes of batches: one that comes again meanwhile gets a small program that puts its answers together. Programs hold
memory, so of these too there are no more."""
LARGEST_ASSEMBLED = 30000
"""Up to this size: of larger batches it would save nothing that counts, and hold all pieces at once."""
LARGEST_UNCUT = 300_000
"""Up to this size a batch that comes again is one call of the kernel; larger ones are cut to save memory."""
ALIGNMENT = 64
"""Bytes; what begins at a multiple of them JAX takes over without a copy."""

Solve = Callable[..., Any]
"""From a flat batch of problems, and one array for each of them by name, to a tree of arrays ``(B, ...)``."""


MOST_FOR_NEWTON = 32
"""Open problems up to which the Newton phases are compiled alone first. Of more problems, some nearly always need a
phase behind them, and then two programs would be compiled in place of one."""


class Inputs(NamedTuple):
    """A user's arguments beside the sharing."""

    grasp: Grasp
    wrench: AnyArray
    weights: AnyArray | None
    free: AnyArray | None
    limits: Limits | None
    safety: float | AnyArray | None
    per_problem: Mapping[str, AnyArray | float]


class UserInputs(NamedTuple):
    """How programs read a user's arguments; the hashable part of a call."""

    sharing: str
    trailing_shapes: tuple[tuple[str, tuple[int, ...]], ...]

    def flat(self, inputs: Inputs, numpy: Any = jnp) -> FlatInput:
        """Return the arguments as one flat batch, in arrays of ``numpy``."""
        last = dict(self.trailing_shapes)
        per_problem = {name: (array, last.get(name, (6,))) for name, array in inputs.per_problem.items()}
        return flatten(
            inputs.grasp,
            inputs.wrench,
            inputs.weights,
            self.sharing,
            free=inputs.free,
            limits=inputs.limits,
            safety=inputs.safety,
            per_problem=per_problem,
            numpy=numpy,
        )


class FlatArrays(NamedTuple):
    """How programs read a batch that NumPy has flattened: the problem, and one array for each by name."""

    @staticmethod
    def flat(arrays: tuple[ProblemBatch, dict[str, Array]]) -> FlatInput:
        problem, per_problem = arrays
        return FlatInput(problem, per_problem, (problem.size,))


Reader = UserInputs | FlatArrays


def solve_on_processor(solve: Solve, inputs: Inputs, reader: UserInputs, progress: Progress | None = None) -> Any:
    """Return the answers of ``solve``, computed on this machine's processor, with the leading axes of ``inputs``."""
    size = _size(inputs, reader.trailing_shapes)
    if size in SIZES and (progress is None or size <= LEAST_WHOLE):
        return _after_progress(progress, size, _solve_chunk(solve, reader, inputs))
    is_repeated = size is not None and size <= LARGEST_UNCUT and _is_repeated_size(size)
    if is_repeated and progress is None and _compiles_quickly(solve, inputs):
        return _solve_chunk(solve, reader, inputs)
    return _in_chunks(solve, inputs, reader, progress, is_repeated)


def _compiles_quickly(solve: Solve, inputs: Inputs) -> bool:
    """Return whether a program for one more size costs less than its padding: the kernel is compiled already."""
    return getattr(solve, "is_by_kernel", False) and has_room_for(np.shape(inputs.grasp.points)[-2])


def _solve_chunk(solve: Solve, reader: Reader, arrays: Any, count: np.int32 | None = None) -> Any:
    """Return the answers to problems of a size that is compiled, of which the first ``count`` are the user's."""
    stages: Stages | None = getattr(solve, "stages", None)
    # What limits of torques change is not known before the last phase.
    if stages is None or _limits_torques(arrays):
        return _program(solve, reader)(arrays, (), count)
    first, state = _program(stages.begin, reader)(arrays, (), count)

    def run(stage: Callable, state: PhaseResult) -> PhaseResult:
        arguments = (arrays, (state,), None)
        return _program(stage, reader).compiled(arguments)[0](*arguments)

    def is_compiled(stage: Callable, state: PhaseResult) -> bool:
        return _program(stage, reader).is_compiled_for((arrays, (state,), None))

    return solve.answer(first, run_stages(stages, state, run, is_compiled))  # type: ignore[attr-defined]


def run_stages(
    stages: Stages,
    state: PhaseResult,
    run: Callable[[Callable, PhaseResult], PhaseResult],
    is_compiled: Callable[[Callable, PhaseResult], bool],
) -> PhaseResult:
    """Return the state after those stages that the problems need.

    Args:
        stages: of the solver.
        state: of ``start_phases``.
        run: calls a stage as a program with a state.
        is_compiled: says whether a stage's program is compiled for a state of these shapes.
    """
    is_open = np.atleast_1d(state.undecided)
    if not np.any(is_open):
        return state
    is_for_newton = np.atleast_1d(state.verdict) == Verdict.OUTSIDE_CONES
    if _may_need_newton_alone(is_open, is_for_newton) and not is_compiled(stages.finish, state):
        state = run(stages.newton, state)
        if not np.any(np.asarray(state.undecided)):
            return state
    return run(stages.finish, state)


def _may_need_newton_alone(is_open: np.ndarray, is_for_newton: np.ndarray) -> bool:
    """Return whether the Newton phases are worth a program of their own, from masks of a batch's problems."""
    return bool(np.count_nonzero(is_open) <= MOST_FOR_NEWTON and not np.any(is_open & ~is_for_newton))


def _limits_torques(arrays: Any) -> bool:
    if isinstance(arrays, Inputs):
        return arrays.limits is not None and arrays.limits.torque_max is not None
    return arrays[0].torque_bounds is not None


@cache
def _program(function: Callable, reader: Reader) -> Program:
    """Return a program of the arrays that a reader reads, from a function of a flat batch."""

    def run(arrays: Any, state: tuple, count: Array | None) -> Any:
        flat = reader.flat(arrays)
        size = math.prod(flat.batch)
        problem = flat.problem if count is None else replace(flat.problem, count=count)
        flat_state = jax.tree.map(lambda x: x.reshape(size, *x.shape[len(flat.batch) :]), state)
        result = function(problem, *flat_state, **flat.per_problem)
        return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), result)

    # The name by which JAX reports that it compiles.
    run.__name__ = getattr(function, "__name__", type(function).__name__)
    return Program(run, key_of(function, reader))


def _size(inputs: Inputs, trailing_shapes: tuple) -> int | None:
    """Count the problems by grasp, wrench and ``per_problem``; None where their axes do not broadcast."""
    grasp, last = inputs.grasp, dict(trailing_shapes)
    shapes = [np.shape(grasp.points)[:-2], np.shape(grasp.friction)[:-1], np.shape(inputs.wrench)[:-1]]
    for name, array in inputs.per_problem.items():
        shape = np.shape(array)
        shapes.append(shape[: len(shape) - len(last.get(name, (6,)))])
    try:
        return math.prod(np.broadcast_shapes(*shapes))
    except ValueError:
        return None  # whoever reads the arrays says what is wrong


def _in_chunks(solve: Solve, inputs: Inputs, reader: UserInputs, progress: Progress | None, is_repeated: bool) -> Any:
    arrays: Any = inputs
    chunk_reader: Reader = reader
    batch = _plain_batch(inputs, reader.trailing_shapes)
    if batch is None:
        flat = reader.flat(inputs, np)
        arrays, batch = (flat.problem, flat.per_problem), flat.batch
        chunk_reader = FlatArrays()
    size = math.prod(batch)
    arrays = jax.tree.map(np.asarray, arrays)

    def solve_chunk(first: int, padded_size: int) -> Any:
        part = jax.tree.map(lambda array: _chunk(array, first, padded_size, size), arrays)
        count = min(padded_size, size - first)
        return _after_progress(progress, count, _solve_chunk(solve, chunk_reader, part, np.int32(count)))

    chunk_starts = chunks(size) if progress is None else chunks(size, LEAST_WHOLE)
    answers = (solve_chunk(*chunk) for chunk in chunk_starts)
    if is_repeated and size <= LARGEST_ASSEMBLED:
        return _assembler(batch)(tuple(answers))
    return _assembled_by_numpy(answers, batch)


def _plain_batch(inputs: Inputs, trailing_shapes: tuple) -> tuple[int, ...] | None:
    """Return the leading axis, where all arrays have the same and no other: programs then read their own chunk."""
    grasp, last = inputs.grasp, dict(trailing_shapes)
    contacts = np.shape(grasp.points)[:-1]
    has_scalar_safety = inputs.safety is None or np.ndim(inputs.safety) == 0
    if len(contacts) != 2 or inputs.free is not None or inputs.limits is not None or not has_scalar_safety:
        return None
    batch = contacts[:1]
    shapes: list[tuple[Any, tuple[int, ...]]]
    shapes = [(grasp.normals, (*contacts, 3)), (inputs.wrench, (*batch, 6))]
    per_contact = (grasp.friction, grasp.squeeze, grasp.present, grasp.torsion, inputs.weights)
    shapes += [(array, contacts) for array in per_contact if array is not None]
    shapes += [(array, batch + last.get(name, (6,))) for name, array in inputs.per_problem.items()]
    # A weak type would be lost with NumPy.
    has_one_axis = all(np.shape(array) == shape and not getattr(array, "weak_type", False) for array, shape in shapes)
    return batch if has_one_axis and not getattr(grasp.points, "weak_type", False) else None


def _after_progress(progress: Progress | None, count: int, answer: Any) -> Any:
    """Return the answer; with a ``progress``, wait for it and report its count."""
    if progress is not None:
        jax.block_until_ready(answer)
        progress(count)
    return answer


def chunks(size: int, largest: int = SIZES[-1]) -> list[tuple[int, int]]:
    """Return the start and the compiled size of each chunk of a batch; the last one is padded."""
    starts, first = [], 0
    for whole in reversed([size for size in SIZES if LEAST_WHOLE <= size <= largest]):
        while size - first >= whole:
            starts.append((first, whole))
            first += whole
    return starts if 0 < size == first else [*starts, (first, padded_size(size - first, SIZES))]


def _chunk(array: np.ndarray, first: int, padded_size: int, size: int) -> np.ndarray:
    """Return ``padded_size`` problems from the first on, zeros behind the last; a shared array is unchanged."""
    if array.ndim == 0 or len(array) != size:
        return array
    part = array[first : first + padded_size]
    if len(part) == padded_size:
        return part
    padded = _aligned((padded_size, *array.shape[1:]), array.dtype)
    padded[: len(part)] = part
    return padded


@cache
def _recent_sizes() -> deque[int]:
    return deque(maxlen=MAX_ASSEMBLERS)


def _is_repeated_size(size: int) -> bool:
    """Return whether a batch of this size was solved recently, so that a program for it is worth its compilation."""
    recent = _recent_sizes()
    if size in recent:
        return True
    recent.append(size)
    return False


@lru_cache(MAX_ASSEMBLERS)
def _assembler(batch: tuple[int, ...]) -> Callable[[tuple[Any, ...]], Any]:
    """From the answers of all pieces to one of all problems, without what was padded."""
    size = math.prod(batch)

    def join(*parts: Array) -> Array:
        return jnp.concatenate(parts)[:size].reshape(batch + parts[0].shape[1:])

    def assemble(answers: tuple[Any, ...]) -> Any:
        return jax.tree.map(join, *answers)

    return jax.jit(assemble)


def _assembled_by_numpy(answers: Iterable[Any], batch: tuple[int, ...]) -> Any:
    """Join the answers of all chunks without a program for this size; each is copied as soon as it is computed."""
    size, first = math.prod(batch), 0
    buffers: list[np.ndarray] = []
    for answer in answers:
        leaves, structure = jax.tree.flatten(answer)
        buffers = buffers or [_aligned((size, *leaf.shape[1:]), leaf.dtype) for leaf in leaves]
        for buffer, leaf in zip(buffers, leaves, strict=True):
            buffer[first : first + len(leaf)] = np.asarray(leaf)[: size - first]
        first += len(leaves[0])
    return jax.tree.unflatten(structure, jax.device_put([x.reshape(batch + x.shape[1:]) for x in buffers]))


def _aligned(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Zeros that JAX takes over without a copy; what is not written to is never touched at all."""
    length = math.prod(shape) * dtype.itemsize
    padded_size = np.zeros(length + ALIGNMENT, np.uint8)
    first = -padded_size.ctypes.data % ALIGNMENT
    return padded_size[first : first + length].view(dtype).reshape(shape)
