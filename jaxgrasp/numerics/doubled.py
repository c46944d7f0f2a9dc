"""Sums of products with an error of one rounding of the result, not of the terms (Dekker 1971, Knuth's two-sum).

A sum or product in floating point comes with its own rounding error, computed exactly; carrying those errors along
doubles the precision. Compilers may contract a product and a sum into one rounding, which would belie the errors:
barriers keep them apart.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.vec import Vec


def minus_cross(t: Vec, a: Vec, b: Vec) -> Vec:
    """t - a x b, where the difference may be far smaller than its terms."""
    return Vec(
        _minus_difference(t.x, (a.y, b.z), (a.z, b.y)),
        _minus_difference(t.y, (a.z, b.x), (a.x, b.z)),
        _minus_difference(t.z, (a.x, b.y), (a.y, b.x)),
    )


def _minus_difference(t: Array, plus: tuple[Array, Array], minus: tuple[Array, Array]) -> Array:
    """t - (plus[0] plus[1] - minus[0] minus[1])."""
    (p, p_error), (m, m_error) = _product(*plus), _product(*minus)
    first, first_error = _sum(t, -p)
    second, second_error = _sum(first, m)
    return second + (first_error + second_error + (m_error - p_error))


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    total = a + b
    of_b = total - a
    return total, (a - (total - of_b)) + (b - of_b)


def _product(a: Array, b: Array) -> tuple[Array, Array]:
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    product = lax.optimization_barrier(a * b)
    rest = a_high * b_high - product
    return product, ((rest + a_high * b_low) + a_low * b_high) + a_low * b_low


def _halves(a: Array) -> tuple[Array, Array]:
    """The leading half of the digits, and the others: products of halves are exact."""
    digits, bits = jnp.finfo(a.dtype).nmant + 1, jnp.finfo(a.dtype).bits
    integer = jnp.dtype(f"int{bits}")
    low_digits = jnp.array(-(1 << ((digits + 1) // 2)), integer)
    high = lax.bitcast_convert_type(lax.bitcast_convert_type(a, integer) & low_digits, a.dtype)
    return high, a - high
