"""Calls of a flat solver for batches of any leading axes and size, by few compiled programs.

Inside another program, or where derivatives are taken, a call is part of what is traced. Outside, it is cut into
pieces of few sizes, each compiled once. Only the last piece is padded, and its tiles stop at the true count: so padding
costs neither time nor, in large batches, memory.

A flat batch over the devices of this machine, a part of it on each; they never talk to one another.
"""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.numerics.compiled_code import is_tracing, jit_here
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import FlatInput, Sharing, flatten, named_weights, read_sharing

AXIS = "problem"


def local_mesh(devices: int) -> Mesh:
    """Return a mesh of JAX's first ``devices`` local devices.

    Raises:
        ValueError: where there are not so many, or none is asked for.
    """
    available = jax.local_devices()
    if isinstance(devices, bool) or not isinstance(devices, int) or not 1 <= devices <= len(available):
        raise ValueError(f"devices is {devices!r}: expected 1 to {len(available)}, the number of local devices")
    return Mesh(np.array(available[:devices]), (AXIS,))


def over_devices(solve: Callable[..., Any], inputs: Any, size: int, padded_size: int, mesh: Mesh) -> Any:
    """``solve(own)`` for ``size`` problems, the leading axis of whose arrays is spread over the devices.

    Args:
        solve: from a tree of arrays to one, all with a leading axis of problems.
        own: NumPy arrays of ``size`` problems; those of another leading size are shared by all of them.
        size: of the batch.
        room: problems for each device, for which its program is compiled; zeros stand where there are no more.
        mesh: the devices, from ``local_mesh``.

    Returns:
        Arrays ``(size, ...)``, spread as their problems are.
    """
    leaves, structure = jax.tree.flatten(inputs)
    spread = tuple(array.ndim > 0 and len(array) == size for array in leaves)
    put = [
        jax.device_put(
            _filled(array, padded_size * mesh.size) if is_split else array, NamedSharding(mesh, _spec(is_split))
        )
        for array, is_split in zip(leaves, spread, strict=True)
    ]
    answer = _sharded_program(solve, mesh, structure, spread)(put)
    return answer if size == padded_size * mesh.size else jax.tree.map(lambda array: array[:size], answer)


def _filled(array: np.ndarray, room: int) -> np.ndarray:
    filled = np.zeros((room, *array.shape[1:]), array.dtype)
    filled[: len(array)] = array
    return filled


def _spec(is_split: bool) -> PartitionSpec:
    return PartitionSpec(AXIS) if is_split else PartitionSpec()


@lru_cache(64)
def _sharded_program(
    solve: Callable[..., Any], mesh: Mesh, structure: Any, spread: tuple[bool, ...]
) -> Callable[..., Any]:
    def run(leaves: list[Array]) -> Any:
        return solve(jax.tree.unflatten(structure, leaves))

    # Nothing is said between the devices, so there is nothing for the checker to check.
    shared = jax.shard_map(run, mesh=mesh, in_specs=([*map(_spec, spread)],), out_specs=_spec(True), check_vma=False)
    return jit_here(shared)


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
ALIGNMENT = 64
"""Bytes; what begins at a multiple of them JAX takes over without a copy."""

Solve = Callable[..., Any]
"""From a flat batch of problems, and one array for each of them by name, to a tree of arrays ``(B, ...)``."""


class Inputs(NamedTuple):
    """A user's arguments beside the sharing."""

    grasp: Grasp
    wrench: AnyArray
    weights: AnyArray | None
    free: AnyArray | None
    limits: Limits | None
    safety: float | AnyArray | None
    per_problem: Mapping[str, AnyArray | float]


def dispatch(
    solve: Solve,
    grasp: Grasp,
    wrench: AnyArray,
    sharing: Sharing,
    *,
    free: AnyArray | None = None,
    limits: Limits | None = None,
    safety: float | AnyArray | None = None,
    trailing_shapes: tuple[tuple[str, tuple[int, ...]], ...] = (),
    devices: int | None = None,
    progress: Progress | None = None,
    **per_problem: AnyArray | float | None,
) -> Any:
    """Return the answers of ``solve`` with the arguments' leading axes, computed on ``devices`` where that is a number.

    ``per_problem`` are further arrays, one for each problem, whose last axes ``trailing_shapes`` name, or ``(6,)``;
    those that are None are left out. ``start``, multipliers to begin from, becomes a field of the problem.

    ``progress`` is called with the number of problems of each chunk that is done; between chunks the batch can be
    interrupted.
    """
    name, weights = read_sharing(sharing)
    named_arrays = {key: array for key, array in per_problem.items() if array is not None}
    inputs = Inputs(grasp, wrench, weights, free, limits, safety, named_arrays)
    if devices is not None:
        return _on_devices(solve, inputs, name, trailing_shapes, devices)
    if not _is_single_cpu(inputs):
        if progress is not None:
            raise ValueError(
                "progress is given inside jit, vmap or grad, or with data on another device: leave progress out"
            )
        return _on_mesh(inputs, partial(_nested_program, solve=solve, sharing=name, trailing_shapes=trailing_shapes))
    if weights is None:
        # As arrays, so that every sharing is one piece of compiled code.
        name, inputs = "given", inputs._replace(weights=named_weights(grasp, name, np))
    try:
        size = _size(inputs, trailing_shapes)
        if size in SIZES and (progress is None or size <= LEAST_WHOLE):
            return _after_progress(
                progress, size, _unpadded_program()(inputs, solve=solve, sharing=name, trailing_shapes=trailing_shapes)
            )
        return _in_chunks(solve, inputs, name, trailing_shapes, progress)
    except ValueError:
        # Constants inside another program: it has its own compiler options, and no other program's are allowed.
        if not is_tracing():
            raise
        return _nested_program(inputs, solve=solve, sharing=name, trailing_shapes=trailing_shapes)


def _flat(inputs: Inputs, sharing: str, trailing_shapes: tuple, numpy: Any) -> FlatInput:
    last = dict(trailing_shapes)
    per_problem = {name: (array, last.get(name, (6,))) for name, array in inputs.per_problem.items()}
    return flatten(
        inputs.grasp,
        inputs.wrench,
        inputs.weights,
        sharing,
        free=inputs.free,
        limits=inputs.limits,
        safety=inputs.safety,
        per_problem=per_problem,
        numpy=numpy,
    )


def _traced(inputs: Inputs, *, solve: Solve, sharing: str, trailing_shapes: tuple) -> Any:
    flat = _flat(inputs, sharing, trailing_shapes, jnp)
    return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), solve(flat.problem, **flat.per_problem))


STATIC = ("solve", "sharing", "trailing_shapes")
_nested_program = jax.jit(_traced, static_argnames=STATIC)


@cache
def _unpadded_program() -> Callable[..., Any]:
    """Return the program for sizes that need no padding, called outside other programs: the least work around it."""
    return jit_here(_traced, static_argnames=STATIC)


def _on_mesh(inputs: Inputs, nested_program: Callable[[Inputs], Any]) -> Any:
    """Return the answers; explicit axes of a mesh become XLA's own inside, since tiles are cut across them."""
    types = [jax.typeof(leaf) for leaf in jax.tree.leaves(inputs) if isinstance(leaf, Array)]
    shardings = [array_type.sharding for array_type in types if array_type.sharding.mesh.explicit_axes]
    if not shardings:
        return nested_program(inputs)
    mesh = shardings[0].mesh
    # The answers are spread as the wrenches are, or else as the grasps.
    leading = jax.typeof(inputs.wrench).sharding.spec[:-1]
    if not any(leading):
        leading = jax.typeof(inputs.grasp.points).sharding.spec[:-2]
    answer_sharding = NamedSharding(mesh, PartitionSpec(*leading))
    return jax.sharding.auto_axes(nested_program, axes=mesh.explicit_axes, out_sharding=answer_sharding)(inputs)


def _on_devices(solve: Solve, inputs: Inputs, sharing: str, trailing_shapes: tuple, devices: int) -> Any:
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs)):
        raise ValueError(
            "devices is given inside jit, vmap or grad, where the outer program places the data: leave devices out"
        )
    mesh = local_mesh(devices)
    flat = _flat(inputs, sharing, trailing_shapes, np)
    size = math.prod(flat.batch)
    share = max(1, -(-size // devices))
    padded_size = next(
        (padded_size for padded_size in SIZES if padded_size >= share), -(-share // SIZES[-1]) * SIZES[-1]
    )
    arrays = jax.tree.map(np.asarray, (flat.problem, flat.per_problem))
    answer = over_devices(_of_flat(solve), arrays, size, padded_size, mesh)
    return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), answer)


@cache
def _of_flat(solve: Solve) -> Solve:
    """Return the solver of a batch that NumPy has flattened, of which ``count`` problems are solved."""

    def run(flat: tuple[ProblemBatch, dict[str, Array]], count: Array | None = None) -> Any:
        problem, per_problem = flat
        return solve(replace(problem, count=count), **per_problem)

    return run


def _is_single_cpu(inputs: Inputs) -> bool:
    """Return whether all data are on this machine's one processor: not traced, not sharded, not on another device."""
    if jax.default_backend() != "cpu":
        return False
    default_device = {jax.devices()[0]}
    for leaf in jax.tree.leaves(inputs):
        if isinstance(leaf, jax.core.Tracer) or (isinstance(leaf, Array) and leaf.devices() != default_device):
            return False
    return True


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


def _in_chunks(solve: Solve, inputs: Inputs, sharing: str, trailing_shapes: tuple, progress: Progress | None) -> Any:
    arrays: Any = inputs
    program: Callable
    batch = _plain_batch(inputs, trailing_shapes)
    if batch is None:
        flat = _flat(inputs, sharing, trailing_shapes, np)
        arrays, batch = (flat.problem, flat.per_problem), flat.batch
        program = _flat_program(solve)
    else:
        program = _program(solve, sharing, trailing_shapes)
    size = math.prod(batch)
    arrays = jax.tree.map(np.asarray, arrays)

    def solve_chunk(first: int, padded_size: int) -> Any:
        part = jax.tree.map(lambda array: _chunk(array, first, padded_size, size), arrays)
        count = min(padded_size, size - first)
        return _after_progress(progress, count, program(part, np.int32(count)))

    chunk_starts = chunks(size) if progress is None else chunks(size, LEAST_WHOLE)
    answers = (solve_chunk(*chunk) for chunk in chunk_starts)
    if size <= LARGEST_ASSEMBLED and _is_repeated_size(size):
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
    for padded_size in reversed([padded_size for padded_size in SIZES if padded_size <= largest]):
        while padded_size >= LEAST_WHOLE and size - first >= padded_size:
            starts.append((first, padded_size))
            first += padded_size
    return starts if 0 < size == first else [*starts, (first, SIZES[bisect_left(SIZES, size - first)])]


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


@cache
def _program(solve: Solve, sharing: str, trailing_shapes: tuple) -> Callable:
    """Return the program for chunks of the user's arrays."""

    def run(inputs: Inputs, count: Array) -> Any:
        flat = _flat(inputs, sharing, trailing_shapes, jnp)
        return solve(replace(flat.problem, count=count), **flat.per_problem)

    return jit_here(run)


@cache
def _flat_program(solve: Solve) -> Callable:
    """Return the program for chunks of a batch that NumPy has flattened."""
    return jit_here(_of_flat(solve))
