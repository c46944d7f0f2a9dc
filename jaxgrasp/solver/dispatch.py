"""Calls of a flat solver for batches of any leading axes and size.

Outside of other programs a call runs the programs of ``programs.py``. Inside another program it is part of what is
traced; where a call's derivatives are taken, its answer comes from the same programs, and only the derivative is
compiled besides.

A flat batch over the devices of this machine, a part of it on each; they never talk to one another.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any

import jax
import numpy as np
from jax import Array, lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.numerics.compiled_code import is_tracing, jit_here, padded_size
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import Sharing, named_weights, read_sharing
from jaxgrasp.solver.programs import SIZES, Inputs, Solve, UserInputs, solve_on_processor

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
    """Return ``solve(inputs)`` for ``size`` problems, the leading axis of whose arrays is spread over the devices.

    Args:
        solve: from a tree of arrays to one, all with a leading axis of problems.
        inputs: NumPy arrays of ``size`` problems; those of another leading size are shared by all of them.
        size: of the batch.
        padded_size: problems for each device, for which its program is compiled; zeros stand where there are no more.
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
    reader = UserInputs(name, trailing_shapes)
    if devices is not None:
        return _on_devices(solve, inputs, reader, devices)
    if progress is not None and not _is_single_cpu(inputs):
        raise ValueError(
            "progress is given inside jit, vmap or grad, or with data on another device: leave progress out"
        )
    if _is_single_cpu(inputs):
        return _solve(solve, inputs, reader, progress)
    numbers = _numbers(inputs) if hasattr(solve, "with_derivative") and not is_tracing() else None
    if numbers is not None and _is_single_cpu(numbers):
        return _with_derivative(inputs, _solve(solve, numbers, reader), solve=solve, reader=reader)
    # Where a program takes derivatives, a nested one would be traced for the answer alone first, for nothing.
    traced = _traced if is_tracing() and _is_differentiated(inputs) else _nested_program
    return _on_mesh(inputs, partial(traced, solve=solve, reader=reader))


def _is_differentiated(inputs: Inputs) -> bool:
    """Return whether derivatives by one of the arguments are taken, with no other transformation in between."""
    tracers = (leaf for leaf in jax.tree.leaves(inputs) if isinstance(leaf, jax.core.Tracer))
    return any(type(lax.stop_gradient(tracer)) is not type(tracer) for tracer in tracers)


def with_derivative(
    solve: Solve,
    grasp: Grasp,
    wrench: AnyArray,
    sharing: Sharing,
    answer: Any,
    *,
    free: AnyArray | None = None,
) -> Any:
    """Return the known ``answer`` of ``solve`` to these arguments as a differentiable function of them."""
    name, weights = read_sharing(sharing)
    inputs = Inputs(grasp, wrench, weights, free, None, None, {})
    return _with_derivative(inputs, answer, solve=solve, reader=UserInputs(name, ()))


def _solve(solve: Solve, inputs: Inputs, reader: UserInputs, progress: Progress | None = None) -> Any:
    """Return the answers to numbers on this machine's processor."""
    if inputs.weights is None:
        # As arrays, so that every sharing is one piece of compiled code.
        weights = named_weights(inputs.grasp, reader.sharing, np)
        inputs, reader = inputs._replace(weights=weights), reader._replace(sharing="given")
    try:
        return solve_on_processor(solve, inputs, reader, progress)
    except ValueError:
        # Constants inside another program: it has its own compiler options, and no other program's are allowed.
        if not is_tracing():
            raise
        return _nested_program(inputs, solve=solve, reader=reader)


def _traced(inputs: Inputs, *, solve: Solve, reader: UserInputs) -> Any:
    flat = reader.flat(inputs)
    return _with_axes(solve(flat.problem, **flat.per_problem), flat.batch)


_nested_program = jax.jit(_traced, static_argnames=("solve", "reader"))


def _with_axes(answer: Any, batch: tuple[int, ...]) -> Any:
    """Return a flat batch's answer with the leading axes ``batch``."""
    return jax.tree.map(lambda x: x.reshape(batch + x.shape[1:]), answer)


def _numbers(inputs: Inputs) -> Inputs | None:
    """Return the arguments of a call whose derivatives are taken, without their tangents; None if they are traced."""
    # Outside of other programs, JAX gives the number itself where a derivative is to stop.
    numbers = jax.tree.map(lax.stop_gradient, inputs)
    return None if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(numbers)) else numbers


@partial(jax.jit, static_argnames=("solve", "reader"))
def _with_derivative(inputs: Inputs, answer: Any, *, solve: Any, reader: UserInputs) -> Any:
    """Return the answer as a differentiable function of the arguments."""
    flat = reader.flat(inputs)
    n_axes = len(flat.batch)
    flat_answer = jax.tree.map(lambda x: x.reshape(math.prod(flat.batch), *x.shape[n_axes:]), answer)
    return _with_axes(solve.with_derivative(flat.problem, flat_answer), flat.batch)


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


def _on_devices(solve: Solve, inputs: Inputs, reader: UserInputs, devices: int) -> Any:
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs)):
        raise ValueError(
            "devices is given inside jit, vmap or grad, where the outer program places the data: leave devices out"
        )
    mesh = local_mesh(devices)
    flat = reader.flat(inputs, np)
    size = math.prod(flat.batch)
    padded = padded_size(max(1, -(-size // devices)), SIZES)
    arrays = jax.tree.map(np.asarray, (flat.problem, flat.per_problem))
    answer = over_devices(_of_flat(solve), arrays, size, padded, mesh)
    return _with_axes(answer, flat.batch)


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
