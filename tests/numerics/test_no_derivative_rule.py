"""The rule itself: NaN for what asks, zero for what does not, under every transformation and of every order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics.no_derivative import nondifferentiable_where

UNDEFINED = jnp.array([False, True])


def cubes(x, y):
    """Return x^3 plus row sums of y ``(2, 3)``, shape ``(2,)``, without a derivative at the second."""
    return nondifferentiable_where(UNDEFINED, x**3 + jnp.sum(y, -1), (x, y))


X, Y = jnp.array([2.0, 3.0]), jnp.arange(6.0).reshape(2, 3)


@pytest.mark.parametrize("derive", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_its_jacobian(derive):
    by_x, by_other = derive(cubes, (0, 1))(X, Y)
    np.testing.assert_array_equal(by_x, [[12, 0], [0, np.nan]])
    expected = np.zeros((2, 2, 3))
    expected[0, 0], expected[1, 1] = 1, np.nan
    np.testing.assert_array_equal(by_other, expected)


@pytest.mark.parametrize("outer", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_its_second_derivative(outer, inner):
    of_both = outer(inner(lambda x: jnp.sum(cubes(x, Y))))(X)
    np.testing.assert_array_equal(of_both, [[12, 0], [0, np.nan]])
    masked = outer(inner(lambda x: jnp.sum(jnp.where(UNDEFINED, 0, cubes(x, Y)))))(X)
    np.testing.assert_array_equal(masked, [[12, 0], [0, 0]])
    third = jax.jacfwd(outer(inner(lambda x: jnp.sum(cubes(x, Y)))))(X)
    assert third[0, 0, 0] == 6 and np.isnan(third[1, 1, 1]) and third[0, 1, 0] == 0


def test_it_maps():
    """Mapped alone, with what it depends on, and with neither."""
    xs = jnp.stack([X, 2 * X, -X])
    gradient = jax.grad(lambda x, y: cubes(x, y)[0])
    np.testing.assert_array_equal(jax.vmap(gradient, (0, None))(xs, Y)[:, 0], 3 * xs[:, 0] ** 2)
    value_and_tangent = jax.jit(jax.vmap(lambda x: jax.jvp(lambda x: cubes(x, Y), (x,), (jnp.array([1.0, 0.0]),))[1]))(
        xs
    )
    np.testing.assert_array_equal(value_and_tangent, np.stack([3 * np.asarray(xs)[:, 0] ** 2, np.zeros(3)], 1))
    hessians = jax.vmap(jax.hessian(lambda x: cubes(x, Y)[1]), 0)(xs)
    assert np.isnan(hessians[:, 1, 1]).all() and (np.asarray(hessians[:, 0]) == 0).all()
