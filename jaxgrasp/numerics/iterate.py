"""The loop of every iterative method that improves many problems in step; used by the solver's methods.

Loops inside ``jax.shard_map``, whose carries must say along which axes of the mesh they vary.
"""

from typing import Any, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array, lax

Tree = TypeVar("Tree")


def varying_like(tree: Tree, *data: Any) -> Tree:
    """Return the tree with its arrays varying along every axis of a mesh along which any of the data varies.

    A loop's carry that begins as a constant needs it where data enter later. Elsewhere it changes nothing.
    """
    axes = frozenset().union(*(_axes(leaf) for leaf in jax.tree.leaves(data)))
    if not axes:
        return tree

    def vary(array: Array) -> Array:
        missing = tuple(sorted(axes - _axes(array)))
        return lax.pcast(array, missing, to="varying") if missing else array

    return jax.tree.map(vary, tree)


def _axes(array: Any) -> frozenset:
    kind = jax.typeof(array)
    manual = getattr(kind, "manual_axis_type", None)
    # As versions of JAX before 0.10 have it.
    return getattr(kind, "vma", frozenset()) if manual is None else manual.varying


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
