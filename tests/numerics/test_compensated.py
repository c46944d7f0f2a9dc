"""A difference far smaller than its terms keeps all of its digits, judged by exact rational arithmetic."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics import vec3
from jaxgrasp.problem.scaling import minus_cross


def exact(t, a, b) -> list[Fraction]:
    t, a, b = ([Fraction(float(x)) for x in v] for v in (t, a, b))
    return [t[i] - (a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]) for i in range(3)]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("jitted", [False, True])
def test_cancellation_costs_no_digits(dtype, jitted):
    rng = np.random.default_rng(0)
    eps = float(np.finfo(dtype).eps)
    a, b = (rng.normal(size=(3, 200)).astype(dtype) * dtype(100) for _ in range(2))
    cross = np.cross(a.T.astype(np.longdouble), b.T.astype(np.longdouble)).T
    t = (cross * (1 + 1e-5 * rng.normal(size=cross.shape))).astype(dtype)
    call = jax.jit(minus_cross) if jitted else minus_cross
    products = np.stack(call(*(vec3.Vec3(*map(jnp.asarray, v)) for v in (t, a, b))))
    plain = t - np.cross(a.T, b.T).T.astype(dtype)
    lost = 0.0
    for k in range(200):
        truth = exact(t[:, k], a[:, k], b[:, k])
        for i in range(3):
            # One rounding of the result, and what two roundings squared leave of the terms.
            terms = abs(float(t[i, k])) + 1e4
            assert (
                abs(float(Fraction(float(products[i, k])) - truth[i]))
                <= 2 * eps * abs(float(truth[i])) + 8 * eps**2 * terms
            )
            lost = max(lost, abs(float(Fraction(float(plain[i, k])) - truth[i])) / max(abs(float(truth[i])), 1e-30))
    assert lost > 100 * eps  # as one writes it at first, digits go
