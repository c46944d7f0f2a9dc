"""Calls of a flat solver for batches of any leading axes and size, by few compiled programs.

Inside another program, or where derivatives are taken, a call is part of what is traced. Outside, it is cut into
pieces of few sizes, each compiled once. Only the last piece is padded, and its tiles stop at the true count: so padding
costs neither time nor, in large batches, memory.
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
from jax.sharding import NamedSharding, PartitionSpec

from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.model.progress import Progress
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import FlatInput, Sharing, flatten, named_weights, read_sharing
from jaxgrasp.solver.over_devices import local_mesh, over_devices

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
    """The answers of ``solve`` with the leading axes of what was given, on so many ``devices`` where that is asked for.

    ``per_problem`` are further arrays, one for each problem, whose last axes ``trailing_shapes`` name, or ``(6,)``;
    those that are None are left out. ``start``, multipliers to begin from, becomes a field of the problem.

    ``progress`` is told how many problems are done, piece by piece, between which the batch can be interrupted.
    """
    name, weights = read_sharing(sharing)
    there = {key: array for key, array in per_problem.items() if array is not None}
    given = Inputs(grasp, wrench, weights, free, limits, safety, there)
    if devices is not None:
        return _on_devices(solve, given, name, trailing_shapes, devices)
    if not _is_local_cpu_data(given):
        if progress is not None:
            raise ValueError("progress is given inside another program, or where data lie elsewhere: leave it out")
        return _on_mesh(given, partial(_within, solve=solve, sharing=name, trailing_shapes=trailing_shapes))
    if weights is None:
        # As arrays, so that every sharing is one piece of compiled code.
        name, given = "given", given._replace(weights=named_weights(grasp, name, np))
    try:
        size = _size(given, trailing_shapes)
        if size in SIZES and (progress is None or size <= LEAST_WHOLE):
            return _after_progress(
                progress, size, _unpadded_program()(given, solve=solve, sharing=name, trailing_shapes=trailing_shapes)
            )
        return _in_pieces(solve, given, name, trailing_shapes, progress)
    except ValueError as error:
        if "compiler_options" not in str(error):
            raise
        # Constants inside another program, which has its own options.
        return _within(given, solve=solve, sharing=name, trailing_shapes=trailing_shapes)


def _flat(given: Inputs, sharing: str, trailing_shapes: tuple, numpy: Any) -> FlatInput:
    last = dict(trailing_shapes)
    per_problem = {name: (array, last.get(name, (6,))) for name, array in given.per_problem.items()}
    return flatten(
        given.grasp,
        given.wrench,
        given.weights,
        sharing,
        free=given.free,
        limits=given.limits,
        safety=given.safety,
        per_problem=per_problem,
        numpy=numpy,
    )


def _traced(given: Inputs, *, solve: Solve, sharing: str, trailing_shapes: tuple) -> Any:
    flat = _flat(given, sharing, trailing_shapes, jnp)
    return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), solve(flat.problem, **flat.per_problem))


STATIC = ("solve", "sharing", "trailing_shapes")
_within = jax.jit(_traced, static_argnames=STATIC)


@cache
def _unpadded_program() -> Callable[..., Any]:
    """The program for sizes that need no padding, called outside any other: the least work before and after."""
    return jit_here(_traced, static_argnames=STATIC)


def _on_mesh(given: Inputs, within: Callable[[Inputs], Any]) -> Any:
    """The answers; where axes of a mesh are explicit they are XLA's own inside, since tiles are cut across them."""
    types = [jax.typeof(leaf) for leaf in jax.tree.leaves(given) if isinstance(leaf, Array)]
    spread = [kind.sharding for kind in types if kind.sharding.mesh.explicit_axes]
    if not spread:
        return within(given)
    mesh = spread[0].mesh
    # The answers are spread as the wrenches are, or else as the grasps.
    leading = jax.typeof(given.wrench).sharding.spec[:-1]
    if not any(leading):
        leading = jax.typeof(given.grasp.points).sharding.spec[:-2]
    out = NamedSharding(mesh, PartitionSpec(*leading))
    return jax.sharding.auto_axes(within, axes=mesh.explicit_axes, out_sharding=out)(given)


def _on_devices(solve: Solve, given: Inputs, sharing: str, trailing_shapes: tuple, devices: int) -> Any:
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(given)):
        raise ValueError("devices is given inside another program, which says itself where its data are: leave it out")
    mesh = local_mesh(devices)
    flat = _flat(given, sharing, trailing_shapes, np)
    size = math.prod(flat.batch)
    share = max(1, -(-size // devices))
    room = next((room for room in SIZES if room >= share), -(-share // SIZES[-1]) * SIZES[-1])
    own = jax.tree.map(np.asarray, (flat.problem, flat.per_problem))
    answer = over_devices(_of_flat(solve), own, size, room, mesh)
    return jax.tree.map(lambda x: x.reshape(flat.batch + x.shape[1:]), answer)


@cache
def _of_flat(solve: Solve) -> Solve:
    """The solver of what NumPy has brought into one leading axis, perhaps with so many problems alone."""

    def run(flat: tuple[ProblemBatch, dict[str, Array]], count: Array | None = None) -> Any:
        problem, per_problem = flat
        return solve(replace(problem, count=count), **per_problem)

    return run


def _is_local_cpu_data(given: Inputs) -> bool:
    """Whether all is data on this machine's one processor: neither traced, nor spread, nor on another device."""
    if jax.default_backend() != "cpu":
        return False
    here = {jax.devices()[0]}
    for leaf in jax.tree.leaves(given):
        if isinstance(leaf, jax.core.Tracer) or (isinstance(leaf, Array) and leaf.devices() != here):
            return False
    return True


def _size(given: Inputs, trailing_shapes: tuple) -> int | None:
    """How many problems there are, as far as grasp, wrench and ``per_problem`` tell; None where that makes no sense."""
    grasp, last = given.grasp, dict(trailing_shapes)
    shapes = [np.shape(grasp.points)[:-2], np.shape(grasp.friction)[:-1], np.shape(given.wrench)[:-1]]
    for name, array in given.per_problem.items():
        shape = np.shape(array)
        shapes.append(shape[: len(shape) - len(last.get(name, (6,)))])
    try:
        return math.prod(np.broadcast_shapes(*shapes))
    except ValueError:
        return None  # whoever reads the arrays says what is wrong


def _in_pieces(solve: Solve, given: Inputs, sharing: str, trailing_shapes: tuple, progress: Progress | None) -> Any:
    own: Any = given
    program: Callable
    batch = _plain_batch(given, trailing_shapes)
    if batch is None:
        flat = _flat(given, sharing, trailing_shapes, np)
        own, batch = (flat.problem, flat.per_problem), flat.batch
        program = _flat_program(solve)
    else:
        program = _program(solve, sharing, trailing_shapes)
    size = math.prod(batch)
    own = jax.tree.map(np.asarray, own)

    def found(first: int, room: int) -> Any:
        part = jax.tree.map(lambda array: _piece(array, first, room, size), own)
        count = min(room, size - first)
        return _after_progress(progress, count, program(part, np.int32(count)))

    cut = pieces(size) if progress is None else pieces(size, LEAST_WHOLE)
    answers = (found(*piece) for piece in cut)
    if size <= LARGEST_ASSEMBLED and _is_repeated_size(size):
        return _assembler(batch)(tuple(answers))
    return _assembled_by_numpy(answers, batch)


def _plain_batch(given: Inputs, trailing_shapes: tuple) -> tuple[int, ...] | None:
    """The leading axis, where all arrays have the same one and no other: then each program reads its piece itself."""
    grasp, last = given.grasp, dict(trailing_shapes)
    contacts = np.shape(grasp.points)[:-1]
    one_safety = given.safety is None or np.ndim(given.safety) == 0
    if len(contacts) != 2 or given.free is not None or given.limits is not None or not one_safety:
        return None
    batch = contacts[:1]
    shapes: list[tuple[Any, tuple[int, ...]]]
    shapes = [(grasp.normals, (*contacts, 3)), (given.wrench, (*batch, 6))]
    each = (grasp.friction, grasp.squeeze, grasp.present, grasp.torsion, given.weights)
    shapes += [(array, contacts) for array in each if array is not None]
    shapes += [(array, batch + last.get(name, (6,))) for name, array in given.per_problem.items()]
    # A weak type would be lost with NumPy.
    same = all(np.shape(array) == shape and not getattr(array, "weak_type", False) for array, shape in shapes)
    return batch if same and not getattr(grasp.points, "weak_type", False) else None


def _after_progress(progress: Progress | None, count: int, answer: Any) -> Any:
    """The answer, once it is there if somebody waits to be told."""
    if progress is not None:
        jax.block_until_ready(answer)
        progress(count)
    return answer


def pieces(size: int, largest: int = SIZES[-1]) -> list[tuple[int, int]]:
    """Where each piece of a batch begins, and for how many problems its program is compiled; the last is padded."""
    cut, first = [], 0
    for room in reversed([room for room in SIZES if room <= largest]):
        while room >= LEAST_WHOLE and size - first >= room:
            cut.append((first, room))
            first += room
    return cut if 0 < size == first else [*cut, (first, SIZES[bisect_left(SIZES, size - first)])]


def _piece(array: np.ndarray, first: int, room: int, size: int) -> np.ndarray:
    """So many problems from the first on, behind the last one zeros; what all share is left as it is."""
    if array.ndim == 0 or len(array) != size:
        return array
    part = array[first : first + room]
    if len(part) == room:
        return part
    padded = _aligned((room, *array.shape[1:]), array.dtype)
    padded[: len(part)] = part
    return padded


@cache
def _sizes_met() -> deque[int]:
    return deque(maxlen=MAX_ASSEMBLERS)


def _is_repeated_size(size: int) -> bool:
    """Whether a batch of this size was asked for not long ago: then another program for it is worth its compilation."""
    met = _sizes_met()
    if size in met:
        return True
    met.append(size)
    return False


@lru_cache(MAX_ASSEMBLERS)
def _assembler(batch: tuple[int, ...]) -> Callable[[tuple[Any, ...]], Any]:
    """From the answers of all pieces to one of all problems, without what was padded."""
    size = math.prod(batch)

    def one(*parts: Array) -> Array:
        return jnp.concatenate(parts)[:size].reshape(batch + parts[0].shape[1:])

    def assemble(answers: tuple[Any, ...]) -> Any:
        return jax.tree.map(one, *answers)

    return jax.jit(assemble)


def _assembled_by_numpy(answers: Iterable[Any], batch: tuple[int, ...]) -> Any:
    """The answers of all pieces as one without a program for this size; each piece is copied as soon as it is there."""
    size, first = math.prod(batch), 0
    whole: list[np.ndarray] = []
    for answer in answers:
        leaves, structure = jax.tree.flatten(answer)
        whole = whole or [_aligned((size, *leaf.shape[1:]), leaf.dtype) for leaf in leaves]
        for all_of_it, leaf in zip(whole, leaves, strict=True):
            all_of_it[first : first + len(leaf)] = np.asarray(leaf)[: size - first]
        first += len(leaves[0])
    return jax.tree.unflatten(structure, jax.device_put([x.reshape(batch + x.shape[1:]) for x in whole]))


def _aligned(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Zeros that JAX takes over without a copy; what is not written to is never touched at all."""
    length = math.prod(shape) * dtype.itemsize
    room = np.zeros(length + ALIGNMENT, np.uint8)
    first = -room.ctypes.data % ALIGNMENT
    return room[first : first + length].view(dtype).reshape(shape)


@cache
def _program(solve: Solve, sharing: str, trailing_shapes: tuple) -> Callable:
    """The program for pieces of what the user gave."""

    def run(given: Inputs, count: Array) -> Any:
        flat = _flat(given, sharing, trailing_shapes, jnp)
        return solve(replace(flat.problem, count=count), **flat.per_problem)

    return jit_here(run)


@cache
def _flat_program(solve: Solve) -> Callable:
    """The program for pieces of what NumPy has brought into one leading axis."""
    return jit_here(_of_flat(solve))
