"""A flat batch over the devices of this machine, a part of it on each; they never talk to one another."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp.numerics.compiled_code import jit_here

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
    answer = _program(solve, mesh, structure, spread)(put)
    return answer if size == padded_size * mesh.size else jax.tree.map(lambda array: array[:size], answer)


def _filled(array: np.ndarray, room: int) -> np.ndarray:
    filled = np.zeros((room, *array.shape[1:]), array.dtype)
    filled[: len(array)] = array
    return filled


def _spec(is_split: bool) -> PartitionSpec:
    return PartitionSpec(AXIS) if is_split else PartitionSpec()


@lru_cache(64)
def _program(solve: Callable[..., Any], mesh: Mesh, structure: Any, spread: tuple[bool, ...]) -> Callable[..., Any]:
    def run(leaves: list[Array]) -> Any:
        return solve(jax.tree.unflatten(structure, leaves))

    # Nothing is said between the devices, so there is nothing for the checker to check.
    shared = jax.shard_map(run, mesh=mesh, in_specs=([*map(_spec, spread)],), out_specs=_spec(True), check_vma=False)
    return jit_here(shared)
