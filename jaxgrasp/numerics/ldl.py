"""Small symmetric matrices whose entries are arrays: L D L^T, its solves, and 3x3 principal axes.

A matrix is a list of rows of its lower triangle, ``a[i][j]`` with j <= i; everything is unrolled, so that
one call factors as many matrices as its entries have elements, whatever their shape.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.vec3 import Vec3

Lower = Sequence[Sequence[Array]]


def factor(a: Lower) -> tuple[list[list[Array]], list[Array]]:
    """Factor a = L D L^T, L a unit lower triangle (returned without its ones) and D diagonal; no pivoting.

    Exact scaling of rows and columns by powers of two changes no relative error, so matrices that are
    ill-conditioned only by the scales of their rows are factored as well as any.
    """
    lower: list[list[Array]] = []
    diagonal: list[Array] = []
    for i, row in enumerate(a):
        scaled: list[Array] = []  # entries of L times D
        for j in range(i):
            scaled.append(row[j] - sum(scaled[m] * lower[j][m] for m in range(j)))
        factors = [scaled[j] / diagonal[j] for j in range(i)]
        diagonal.append(row[i] - sum(scaled[m] * factors[m] for m in range(i)))
        lower.append(factors)
    return lower, diagonal


def solve(factors: tuple[list[list[Array]], list[Array]], right: Sequence[Array]) -> list[Array]:
    """x with a x = right, from ``factor(a)``."""
    lower, diagonal = factors
    size = len(diagonal)
    x: list[Array] = []
    for i in range(size):
        x.append(right[i] - sum(lower[i][j] * x[j] for j in range(i)))
    x = [x[i] / diagonal[i] for i in range(size)]
    for i in reversed(range(size)):
        x[i] = x[i] - sum(lower[j][i] * x[j] for j in range(i + 1, size))
    return x


def multiply(a: Lower, x: Sequence[Array]) -> list[Array]:
    """Return a x."""
    entry = lambda i, j: a[max(i, j)][min(i, j)]  # noqa: E731
    return [sum(entry(i, j) * x[j] for j in range(len(x))) for i in range(len(x))]


SWEEPS = 5
"""Sweeps of Jacobi's rotations that reach machine precision from any start; the last ones converge quadratically."""


def principal_axes(a: Lower, rotates: bool | Array = True) -> tuple[Vec3, Vec3, Vec3]:
    """Orthonormal eigenvectors of 3x3 matrices, by Jacobi's rotations; in no order.

    The coordinate axes as they are, at no cost, where the scalar ``wanted`` is false. Unlike what else stands here this
    is written over whole matrices: few kernels count for more than few operations where hardly any time is spent.
    """
    entries = jnp.stack([jnp.stack([a[max(i, j)][min(i, j)] for j in range(3)]) for i in range(3)])
    identity = jnp.zeros_like(entries) + jnp.eye(3, dtype=entries.dtype).reshape(3, 3, *[1] * (entries.ndim - 2))
    identity = varying_like(identity, entries)

    def mix(cosine: Array, sine: Array, rows: Array) -> Array:
        # The first two are turned, and then all move on by one, so that every pair has its turn.
        return jnp.stack([sine * rows[0] + cosine * rows[1], rows[2], cosine * rows[0] - sine * rows[1]])

    def turn(_, state):
        matrix, axes = state
        # One for each matrix, beside rows of three.
        cosine, sine = (x[None] for x in _rotation(matrix[0, 0], matrix[0, 1], matrix[1, 1]))
        halfway = mix(cosine, sine, matrix)
        return mix(cosine, sine, halfway.swapaxes(0, 1)), mix(cosine, sine, axes)

    _, axes = lax.fori_loop(0, jnp.where(rotates, 3 * SWEEPS, 0), turn, (entries, identity))
    return Vec3(*axes[0]), Vec3(*axes[1]), Vec3(*axes[2])


def _rotation(first: Array, off_diagonal: Array, second: Array) -> tuple[Array, Array]:
    """Return cosine and sine of the rotation that makes the entry beside two of the diagonal vanish."""
    half_gap = (second - first) / 2
    # tan of the smaller angle: off / (half_gap + sign(half_gap) sqrt(half_gap^2 + off^2)), 0 where off is 0.
    reach = jnp.abs(half_gap) + vec3.safe_sqrt(half_gap**2 + off_diagonal**2)
    tangent = vec3.safe_divide(jnp.where(half_gap < 0, -off_diagonal, off_diagonal), reach)
    cosine = 1 / jnp.sqrt(1 + tangent**2)
    return cosine, tangent * cosine
