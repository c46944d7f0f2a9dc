"""Loops inside ``jax.shard_map``, whose carries must say along which axes of the mesh they vary."""

from typing import Any, TypeVar

import jax
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
