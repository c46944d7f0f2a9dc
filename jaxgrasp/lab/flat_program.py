"""Compiled programs that answer trees as tuples of their leaves, which are put together only where somebody asks.

A tick is short: to take trees of modules apart and to put them together would cost as much as what it computes.
"""

from collections.abc import Callable
from typing import Any

import jax

from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.numerics.compiled_code import jit_here

Leaves = tuple[AnyArray, ...]


class FlatProgram:
    """A function of arrays, and of tuples of them, that answers several trees; made as fast as it can be."""

    def __init__(self, function: Callable[..., tuple[Any, ...]]):
        """It is compiled at its first call."""
        self._structures: tuple[Any, ...] = ()

        def flat(*args: Any) -> tuple[Leaves, ...]:
            parts = [jax.tree.flatten(part) for part in function(*args)]
            self._structures = tuple(structure for _, structure in parts)
            return tuple(tuple(leaves) for leaves, _ in parts)

        self._program = jit_here(flat)

    def __call__(self, *args: Any) -> tuple[Leaves, ...]:
        """The leaves of each tree."""
        return self._program(*args)

    def tree(self, part: int, leaves: Leaves) -> Any:
        """That tree of the answer, from its leaves."""
        return jax.tree.unflatten(self._structures[part], leaves)
