"""The methods that run in JAX: all problems of a batch in one call, and their answers in the user's units."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.method_answer import MethodAnswer
from jaxgrasp.literature.method_input import MethodInput
from jaxgrasp.literature.scaled_batch import ScaledBatch, scale


class BatchResult(NamedTuple):
    """What a method finds, forces in units of the load."""

    forces: Array
    status: Array
    objective: Array
    iterations: Array


def solve_all(given: MethodInput, solve: Callable[[ScaledBatch, Array], BatchResult], unit: int) -> MethodAnswer:
    """All problems in one call, in double precision whatever JAX's mode.

    Args:
        given: the problems.
        solve: takes them scaled, and their loads [N] ``(B,)``.
        unit: power of the load by which the objective scales.
    """
    count, n = given.friction.shape
    if count == 0:
        return given.answer(np.zeros((0, n, 3)), np.zeros(0), np.zeros(0), np.zeros(0, int))
    with jax.enable_x64(True):
        problem, load = scale(given)
        found = jax.device_get(solve(ScaledBatch(*map(jnp.asarray, problem)), jnp.asarray(load)))
    forces = load[:, None, None] * found.forces
    return given.answer(forces, found.status, load**unit * found.objective, found.iterations)
