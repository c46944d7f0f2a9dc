"""Sums of products with an error of one rounding of the result, not of the terms (Dekker 1971, Knuth's two-sum).

A sum or product in floating point comes with its own rounding error, computed exactly; carrying those errors along
doubles the precision. Compilers may contract a product and a sum into one rounding, which would belie the errors:
barriers keep them apart.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.vec3 import Vec3


def minus_cross(t: Vec3, a: Vec3, b: Vec3) -> Vec3:
    """t - a x b, where the difference may be far smaller than its terms."""
    start, left, right = (jnp.stack(jnp.broadcast_arrays(*component)) for component in (t, a, b))
    p, p_error = _product(_rolled(left, 1), _rolled(right, 2))
    m, m_error = _product(_rolled(left, 2), _rolled(right, 1))
    first, first_error = _sum(start, -p)
    second, second_error = _sum(first, m)
    return Vec3(*(second + (first_error + second_error + (m_error - p_error))))


def _rolled(array: Array, steps: int) -> Array:
    """Return the component ``steps`` after each."""
    return jnp.concatenate([array[steps:], array[:steps]])


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    total = a + b
    of_b = total - a
    return total, (a - (total - of_b)) + (b - of_b)


def _product(a: Array, b: Array) -> tuple[Array, Array]:
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    product = lax.optimization_barrier(a * b)
    error = a_high * b_high - product
    return product, ((error + a_high * b_low) + a_low * b_high) + a_low * b_low


def _halves(a: Array) -> tuple[Array, Array]:
    """Split each number into halves of its digits, whose products are exact (Dekker 1971)."""
    digits, bits = jnp.finfo(a.dtype).nmant + 1, jnp.finfo(a.dtype).bits
    integer = jnp.dtype(f"int{bits}")
    low_digits = jnp.array(-(1 << ((digits + 1) // 2)), integer)
    high = lax.bitcast_convert_type(lax.bitcast_convert_type(a, integer) & low_digits, a.dtype)
    return high, a - high
