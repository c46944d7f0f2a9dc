"""Program as a function of the squeezing forces, which are method B's weights too: differentiated by layers.

The same program as ``program.py`` makes, but in JAX, with centre and units held fixed: any will do.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.rivals.program import Program, program
from jaxgrasp.testing.references import Problems


class Data(NamedTuple):
    """Data that vary with the squeeze: E, b and mu o of ``program.py``."""

    balance: jax.Array
    residual_wrench: jax.Array
    edges: jax.Array


class Squeezed(NamedTuple):
    """A batch of programs and how to differentiate through their data; the index says which."""

    programs: Program
    squeeze: np.ndarray
    data: Callable[[int], Data]
    slopes: Callable[[int], Data]
    """The data's Jacobian by the squeeze, which is the last axis."""
    finish: Callable[[int, np.ndarray, np.ndarray], np.ndarray]
    """Forces by squeeze ``(n, 3, n)`` from the program's solution and its Jacobian ``(3n, n)``."""


def squeezed(problem: Problems) -> Squeezed:
    programs = program(problem, problem.squeeze)
    # E without its weights, and the wrench that is left with no squeezing: both known from the program made once.
    columns = programs.balance / np.repeat(programs.roots, 3, -1)[:, None, :]
    normals = columns[:, :, ::3]
    wrench = programs.residual_wrench + np.einsum("bcn,bn->bc", normals, problem.squeeze / programs.load[:, None])
    fixed = (columns, wrench, programs.friction, programs.axes, programs.load, programs.unit)

    def at(index: int) -> tuple:
        return tuple(array[index] for array in fixed)

    return Squeezed(
        programs,
        problem.squeeze,
        lambda index: _data(problem.squeeze[index], at(index)),
        lambda index: _slopes(problem.squeeze[index], at(index)),
        lambda index, y, by_squeeze: np.asarray(_finish(problem.squeeze[index], y, by_squeeze, at(index))),
    )


def _pose(squeeze: jax.Array, fixed: tuple) -> Data:
    columns, wrench, friction, _, load, unit = fixed
    roots = jnp.sqrt(squeeze / unit)
    residual_wrench = wrench - columns[:, ::3] @ (squeeze / load)
    return Data(columns * jnp.repeat(roots, 3), residual_wrench, friction * squeeze / load / roots)


def _forces(squeeze: jax.Array, y: jax.Array, fixed: tuple) -> jax.Array:
    _, _, _, axes, load, unit = fixed
    local = jnp.sqrt(squeeze / unit)[:, None] * y.reshape(-1, 3)
    return squeeze[:, None] * axes[:, 0] + load * jnp.einsum("nj,njc->nc", local, axes)


_data = jax.jit(_pose)
_slopes = jax.jit(jax.jacfwd(_pose))


@jax.jit
def _finish(squeeze: jax.Array, y: jax.Array, by_squeeze: jax.Array, fixed: tuple) -> jax.Array:
    direct, through = jax.jacfwd(_forces, argnums=(0, 1))(squeeze, y, fixed)
    return direct + through @ by_squeeze
