"""Vectors in three components, each an array of its own.

A vector field over contacts and problems is a tuple of three arrays with the problems along the last
axis, so that the compiler vectorises over problems; see ``problem/batch_last.py``.
"""

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

FEW = 8
"""Problems in a batch for which the number of operations counts, not their size."""


BLOCK = 5
"""Contacts that one loop sums: the compiler unrolls so short a loop, and then computes several problems at once. Over
a longer one it goes problem by problem, which at twenty contacts made a batch half as slow again."""


class Vec3(NamedTuple):
    """Three components that broadcast against each other."""

    x: Array
    y: Array
    z: Array


def from_axis(array: Array, axis: int) -> Vec3:
    """Return the components of ``array`` along ``axis``, which has length 3."""
    return Vec3(*(jnp.take(array, i, axis) for i in range(3)))


def add(a: Vec3, b: Vec3) -> Vec3:
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


def sub(a: Vec3, b: Vec3) -> Vec3:
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


def scale(factor: Array, a: Vec3) -> Vec3:
    return Vec3(factor * a.x, factor * a.y, factor * a.z)


def times(a: Vec3, b: Vec3) -> Vec3:
    """Componentwise product."""
    return Vec3(a.x * b.x, a.y * b.y, a.z * b.z)


def dot(a: Vec3, b: Vec3) -> Array:
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec3, b: Vec3) -> Vec3:
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def totals(*terms: Array) -> list[Array]:
    """Sum over contacts, the first axis, which stays with length 1.

    Few problems take one reduction over a stack, since each reduction costs three allocations; many take separate
    reductions, since the stack would be written to memory first.
    """
    if max(term.shape[-1] for term in terms) > FEW:
        return [reduce(jnp.add, _by_blocks(jnp.sum, term, 0)) for term in terms]
    return stacked_totals(*terms)


def stacked_totals(*terms: Array) -> list[Array]:
    """Sum over contacts by one reduction, for terms that share so much work that none should compute it alone."""
    sums = reduce(jnp.add, _by_blocks(jnp.sum, jnp.stack(jnp.broadcast_arrays(*terms)), 1))
    return [sums[i] for i in range(len(terms))]


def all_contacts(condition: Array) -> Array:
    """Return whether a condition holds at every contact; the first axis stays with length 1."""
    return reduce(jnp.logical_and, _by_blocks(jnp.all, condition, 0))


def _by_blocks(reduction: Callable[..., Array], array: Array, axis: int) -> list[Array]:
    """Reductions of a few contacts each along ``axis``; of few problems, where each operation counts, of all."""
    count = array.shape[axis]
    size = BLOCK if array.shape[-1] > FEW else count
    if count <= size:
        return [reduction(array, axis, keepdims=True)]
    ends = [(first, min(first + size, count)) for first in range(0, count, size)]
    return [reduction(lax.slice_in_dim(array, *part, axis=axis), axis, keepdims=True) for part in ends]


def where(condition: Array, a: Vec3, b: Vec3) -> Vec3:
    return Vec3(*(jnp.where(condition, p, q) for p, q in zip(a, b, strict=True)))


def rotate(rows: tuple[Vec3, Vec3, Vec3], a: Vec3) -> Vec3:
    """Components of ``a`` along three axes."""
    return Vec3(dot(rows[0], a), dot(rows[1], a), dot(rows[2], a))


def rotate_back(rows: tuple[Vec3, Vec3, Vec3], a: Vec3) -> Vec3:
    """Return the vector whose components along three orthonormal axes are ``a``."""
    return add(add(scale(a.x, rows[0]), scale(a.y, rows[1])), scale(a.z, rows[2]))


def taxicab(a: Vec3) -> Array:
    """Sum of the components' sizes, which neither overflows nor underflows where squares would."""
    return abs(a.x) + abs(a.y) + abs(a.z)


def norm(a: Vec3) -> Array:
    """Length; zero has derivative zero instead of NaN."""
    return safe_sqrt(dot(a, a))


def unit(a: Vec3) -> Vec3:
    """Return the vector at length 1; x for a vector of length 0."""
    length = norm(a)
    x, y, z = (safe_divide(c, length) for c in a)
    return Vec3(jnp.where(length > 0, x, 1), y, z)


def safe_sqrt(square: Array) -> Array:
    """Square root whose derivative at zero is zero: both branches of the ``where`` must be finite."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0)


def safe_divide(a: Array, b: Array) -> Array:
    """Return a / b, and 0 where b is 0, with finite derivatives there."""
    nonzero = b != 0
    return jnp.where(nonzero, a / jnp.where(nonzero, b, 1), 0)
