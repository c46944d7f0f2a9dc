"""The min-weight: against its dual program, known values, laws, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

from jaxgrasp.quality import ferrari_canny, min_weight, min_weight_at
from tests.quality import known
from tests.quality.known import pyramid_edges


def by_the_dual(edges: np.ndarray) -> float:
    """Solve the dual: the least e so that a twist works at rates <= e along all edges, and e less their mean is 1 / m.

    With d and e the multipliers of balance and of the weights' sum, m times the primal's l.
    """
    count = len(edges)
    mean = edges.mean(0)
    program = linprog(
        np.eye(7)[6],
        A_ub=np.column_stack([edges, -np.ones(count)]),
        b_ub=np.zeros(count),
        A_eq=np.append(-mean, 1.0)[None],
        b_eq=[1.0],
        bounds=[(None, None)] * 7,
    )
    return program.fun


@pytest.mark.parametrize("sides", [4, 5])
@pytest.mark.parametrize("n", [3, 5, pytest.param(10, marks=pytest.mark.slow)])
def test_it_is_its_duals_value_and_its_weights_balance(n, sides):
    grasp = known.ordinary(n, 8)
    weight = min_weight(grasp, sides=sides)
    for index in range(8):
        edges = pyramid_edges(known.single(grasp, index), sides)
        np.testing.assert_allclose(weight.value[index], by_the_dual(edges.reshape(-1, 6)), rtol=1e-6, atol=1e-8)
        balance = np.einsum("nk,nkj->j", weight.weights[index], edges)
        assert np.abs(balance).max() < 1e-10
    np.testing.assert_allclose(weight.weights.sum((1, 2)), 1, rtol=1e-10)
    np.testing.assert_allclose(weight.weights.min((1, 2)) * n * sides, weight.value, rtol=1e-8, atol=1e-12)
    assert (weight.value <= 1 + 1e-12).all()


def test_equal_weights_balance_where_all_is_symmetric_and_nothing_does_on_one_side():
    np.testing.assert_allclose(min_weight(known.on_axes(0.5)).value, 1, rtol=1e-12)
    assert min_weight(known.star([0, 50, 100], 0.3)).value < 0
    nobody = known.changed(known.triangle(), present=np.zeros(3))
    for grasp in (known.star([0], 0.5), nobody):
        weight = min_weight(grasp)
        assert weight.value == -np.inf and not weight.weights.any()
        gradient = jax.grad(
            lambda p, g=grasp, f=weight: jnp.sum(min_weight_at(known.changed(known.of_jax(g), points=p), f))
        )(jnp.asarray(grasp.points))
        # A value that is not there has no derivative; of contacts that are not there it is zero.
        assert (gradient == 0).all() if grasp is nobody else np.isnan(gradient).all()


def test_above_zero_it_means_closed():
    grasp = known.ordinary(5, 40, torsion=True)
    weight = min_weight(grasp, sides=4)
    closed = ferrari_canny(grasp, sides=4, tol=0.5).lower > 0
    np.testing.assert_array_equal(weight.value > 1e-9, closed)


def test_neither_place_nor_unit_nor_padding_matters():
    grasp = known.ordinary(5, 6)
    plain = min_weight(grasp).value
    for other_grasp in (
        known.changed(grasp, points=grasp.points + [1.0, 2.0, 3.0]),
        known.changed(grasp, points=100 * grasp.points),
        known.padded(grasp),
    ):
        np.testing.assert_allclose(min_weight(other_grasp).value, plain, rtol=1e-7, atol=1e-9)


def test_derivatives_are_those_of_the_value():
    grasp = known.ordinary(5, 6)
    weight = min_weight(grasp)
    points, friction = jnp.asarray(grasp.points), jnp.asarray(grasp.friction)
    rng = np.random.default_rng(0)
    tangent = 0.03 * rng.normal(size=points.shape), rng.normal(size=friction.shape)

    @jax.jit
    def of(points, friction):
        return min_weight_at(known.changed(known.of_jax(grasp), points=points, friction=friction), weight)

    value, forward = jax.jvp(of, (points, friction), tangent)
    np.testing.assert_allclose(value, weight.value, rtol=1e-9)
    slopes = jax.grad(lambda *a: jnp.sum(of(*a)), argnums=(0, 1))(points, friction)
    product = sum(np.sum(np.asarray(a) * b, tuple(range(1, b.ndim))) for a, b in zip(slopes, tangent))
    np.testing.assert_allclose(product, forward, rtol=1e-9)
    step = 1e-5
    ends = [
        min_weight(
            known.changed(grasp, points=grasp.points + s * tangent[0], friction=grasp.friction + s * tangent[1])
        ).value
        for s in (step, -step)
    ]
    np.testing.assert_allclose(forward, (ends[0] - ends[1]) / (2 * step), rtol=1e-5)


@pytest.mark.usefixtures("unchecked")
def test_bad_sides_are_named():
    with pytest.raises(TypeError, match=r"sides is 2.5 of type float: expected a whole number"):
        min_weight(known.triangle(), sides=2.5)
