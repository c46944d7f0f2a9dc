"""The loop of every iterative method that improves many problems in step; used by the solver's methods."""

from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array, lax


@runtime_checkable
class Method(Protocol):
    """A method that improves a state step by step, as optimistix's ``step`` and ``terminate``.

    Each method also has its own ``init``, which makes the first state.
    """

    def step(self, state: Any) -> Any:
        """Return the state after one more step; problems that ``terminate`` names stay as they are."""
        ...

    def terminate(self, state: Any) -> Array:
        """Return a mask of the problems that need no further step."""
        ...


def iterate(method: Method, state: Any, max_steps: int | Array) -> Any:
    """Return the state after at most ``max_steps`` steps, fewer where all problems have terminated."""

    def is_unfinished(carry: tuple[Array, Any]) -> Array:
        count, state = carry
        return (count < max_steps) & ~jnp.all(method.terminate(state))

    def step(carry: tuple[Array, Any]) -> tuple[Array, Any]:
        count, state = carry
        return count + 1, method.step(state)

    return lax.while_loop(is_unfinished, step, (jnp.int32(0), state))[1]
