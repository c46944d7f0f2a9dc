"""Balls scaled by an ellipsoid of task wrenches: the plain ball, laws, Qhull, brute force, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import GraspError
from jaxgrasp.quality import ferrari_canny, ferrari_canny_at, force_closure
from tests.quality import known

BOUNDS = ("l1", "linf")


@pytest.fixture(scope="module")
def batch():
    """Return grasps that are closed with some margin."""
    grasp = known.ordinary(5, 18, torsion=True)
    indices = np.flatnonzero(force_closure(grasp).margin > 0.02)[:3]
    return jax.tree.map(lambda array: array[indices], grasp)


def some_axes(count: int, seed: int = 0) -> np.ndarray:
    """Return semi-axes of any directions: some newtons and some newton centimetres."""
    rng = np.random.default_rng(seed)
    return np.array([1, 1, 1, 0.03, 0.03, 0.03])[:, None] * (np.eye(6) + 0.3 * rng.normal(size=(count, 6, 6)))


def of_length(length) -> np.ndarray:
    units = np.ones_like(length)
    return np.stack([units, units, units, length, length, length], -1)[..., None] * np.eye(6)


@pytest.mark.parametrize("bound", BOUNDS)
def test_a_sphere_is_the_plain_ball(batch, bound):
    lengths = np.array([0.02, 0.03, 0.05])
    plain = ferrari_canny(batch, bound, length=lengths, tol=1e-4)
    quality = ferrari_canny(batch, bound, ellipsoid=of_length(lengths), tol=1e-4)
    np.testing.assert_allclose(quality.upper, plain.upper, rtol=1e-7)
    np.testing.assert_allclose(quality.lower, plain.lower, rtol=2e-4)
    np.testing.assert_allclose(quality.direction, plain.direction, atol=1e-5)


def test_laws(batch):
    """Twice the ellipsoid, half the factor; a turned frame, order of the axes, their signs: none matters."""
    axes = some_axes(3)
    plain = ferrari_canny(batch, ellipsoid=axes, tol=1e-4)
    assert (plain.lower > 0).all() and (plain.lower >= (1 - 1.01e-4) * plain.upper).all()
    double = ferrari_canny(batch, ellipsoid=2 * axes, tol=1e-4)
    np.testing.assert_allclose(double.upper, plain.upper / 2, rtol=1e-6)
    order = np.random.default_rng(1).permutation(6)
    mirrored = ferrari_canny(batch, ellipsoid=-axes[..., order], tol=1e-4)
    np.testing.assert_allclose(mirrored.upper, plain.upper, rtol=1e-6)
    turned, rotation = known.turned(batch)
    block_rotation = np.kron(np.eye(2), rotation)
    np.testing.assert_allclose(
        ferrari_canny(turned, ellipsoid=block_rotation @ axes, tol=1e-4).upper, plain.upper, rtol=1e-6
    )
    # An ellipsoid inside another: the factor is no smaller.
    inner = axes * np.random.default_rng(2).uniform(0.3, 1, 6)
    assert (ferrari_canny(batch, ellipsoid=inner, tol=1e-4).upper >= plain.lower).all()


def test_pyramids_are_their_hull_by_qhull(batch):
    hard, axes = known.changed(batch, torsion=None), some_axes(3)
    quality = ferrari_canny(hard, ellipsoid=axes, sides=8, about=np.zeros(3))
    assert (quality.lower > 0).sum() >= 2
    for index in np.flatnonzero(quality.lower > 0):
        edges = known.pyramid_edges(known.single(hard, index), 8, 1.0, np.zeros(3)).reshape(-1, 6)
        radius = known.hull_radius(edges @ np.linalg.inv(axes[index]).T)
        np.testing.assert_allclose(quality.upper[index], radius, rtol=1e-6)


@pytest.mark.parametrize("bound", BOUNDS)
def test_no_direction_is_below_the_lower_bound_and_its_wrench_is_the_hardest(batch, bound):
    axes = some_axes(3)
    quality = ferrari_canny(batch, bound, ellipsoid=axes)
    rng = np.random.default_rng(3)
    for index in range(3):
        grasp = known.single(batch, index)
        near = quality.direction[index] + rng.normal(size=(20_000, 6)) * np.geomspace(1e-6, 3, 20_000)[:, None]
        near[0] = quality.direction[index]
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        # Along the twist A^-T d a wrench A u works at the rate d.u.
        length, _ = known.frame_of(grasp)
        twists = near @ np.linalg.inv(axes[index])
        scaled = np.concatenate([twists[:, :3], twists[:, 3:] * length], 1)
        heights = known.height(grasp, scaled, bound)
        assert heights.min() >= quality.lower[index]
        assert heights[0] == pytest.approx(quality.upper[index], rel=1e-8)


@pytest.mark.parametrize("bound", BOUNDS)
def test_derivatives_are_those_of_the_value(batch, bound):
    axes = some_axes(3)
    plain = ferrari_canny(batch, bound, ellipsoid=axes, tol=1e-6)

    def upper(points, axes):
        return ferrari_canny(known.changed(known.of_jax(batch), points=points), bound, ellipsoid=axes, tol=1e-6).upper

    def beside(points, axes):
        return ferrari_canny_at(known.changed(known.of_jax(batch), points=points), plain, ellipsoid=axes)

    arrays = jnp.asarray(batch.points), jnp.asarray(axes)
    rng = np.random.default_rng(4)
    tangent = tuple(scale * rng.normal(size=a.shape) for a, scale in zip(arrays, (0.01, np.abs(axes))))
    value, forward = jax.jit(lambda *a: jax.jvp(beside, a, tangent))(*arrays)
    np.testing.assert_allclose(value, plain.upper, rtol=1e-6)
    reverse = jax.jit(jax.grad(lambda *a: jnp.sum(upper(*a)), (0, 1)))(*arrays)
    product = sum(np.sum(np.asarray(a) * b, tuple(range(1, b.ndim))) for a, b in zip(reverse, tangent))
    np.testing.assert_allclose(product, forward, rtol=1e-5)
    step = 1e-5
    ends = [
        ferrari_canny(
            known.changed(batch, points=batch.points + sign * tangent[0]),
            bound,
            ellipsoid=axes + sign * tangent[1],
            tol=1e-6,
        ).upper
        for sign in (step, -step)
    ]
    np.testing.assert_allclose(forward, (ends[0] - ends[1]) / (2 * step), rtol=1e-4)


def test_an_ellipsoid_that_cannot_be_used_is_named():
    grasp = known.triangle()
    with pytest.raises(ValueError, match="length and ellipsoid are both given"):
        ferrari_canny(grasp, length=1.0, ellipsoid=np.eye(6))
    with pytest.raises(GraspError, match="ellipsoid is flat: expected six semi-axes that span all wrenches"):
        ferrari_canny(grasp, ellipsoid=np.diag([1.0, 1, 1, 1, 1, 0]))
    bad = np.eye(6)
    bad[1, 2] = np.nan
    with pytest.raises(GraspError, match=r"ellipsoid\[1, 2\] is nan: expected a finite number \[N, N.m\]"):
        ferrari_canny(grasp, ellipsoid=bad)
