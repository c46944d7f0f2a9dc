"""Exact shapes: distance and normal against closed forms, by other means than their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Plane, Shape, Shifted, Sphere, check_shape, signed_distance

SHAPES = [Sphere(0.04), Plane(), Box(0.05, 0.08, 0.03), Cylinder(0.03, 0.1), Capsule(0.02, 0.06)]
NAMES = [type(shape).__name__ for shape in SHAPES]
each_shape = pytest.mark.parametrize("shape", SHAPES, ids=NAMES)


def points(count: int = 2000, reach: float = 0.1, dtype=np.float64) -> np.ndarray:
    return np.random.default_rng(5).uniform(-reach, reach, (count, 3)).astype(dtype)


def surface(shape: Shape, count: int = 200_000) -> np.ndarray:
    """Return points drawn on the surface, from each shape's own description."""
    rng = np.random.default_rng(6)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    if isinstance(shape, Sphere):
        return shape.radius * direction
    if isinstance(shape, Plane):
        return np.append(rng.uniform(-0.2, 0.2, (count, 2)), np.zeros((count, 1)), 1)
    if isinstance(shape, Box):
        half = np.array([shape.length, shape.width, shape.height]) / 2
        spots = rng.uniform(-1, 1, (count, 3))
        face = rng.integers(3, size=count)
        spots[np.arange(count), face] = rng.choice([-1, 1], count)
        return half * spots
    angle, level = rng.uniform(0, 2 * np.pi, count), rng.uniform(-shape.height / 2, shape.height / 2, count)
    side = np.stack([shape.radius * np.cos(angle), shape.radius * np.sin(angle), level], 1)
    end = rng.choice([-1, 1], count) * shape.height / 2
    if isinstance(shape, Cylinder):
        radius = shape.radius * np.sqrt(rng.uniform(size=count))
        caps = np.stack([radius * np.cos(angle), radius * np.sin(angle), end], 1)
    else:
        caps = shape.radius * direction
        caps[:, 2] += np.where(caps[:, 2] > 0, 1, -1) * shape.height / 2
    return np.where((rng.uniform(size=count) < 0.5)[:, None], side, caps)


@each_shape
def test_the_foot_of_the_normal_lies_on_the_surface_and_nothing_is_nearer(shape):
    at = points()
    distance, normal = jax.device_get(signed_distance(shape, at))
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, rtol=1e-14)
    foot = at - distance[:, None] * normal
    again, _ = signed_distance(shape, foot)
    np.testing.assert_allclose(again, 0, atol=1e-16)
    drawn = surface(shape)
    nearest = np.array([np.sqrt(np.min(np.sum((drawn - p) ** 2, 1))) for p in at[:200]])
    assert (nearest >= np.abs(distance[:200]) - 1e-15).all()
    # The drawn points are some 1 mm apart.
    np.testing.assert_allclose(nearest, np.abs(distance[:200]), atol=2e-3)


@each_shape
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_normal_is_the_gradient(shape, dtype):
    at = points(dtype=dtype)
    distance, normal = signed_distance(shape, at)
    gradient = jax.vmap(jax.grad(lambda p: signed_distance(shape, p)[0]))(at)
    assert distance.dtype == dtype
    np.testing.assert_allclose(gradient, normal, atol=1e-5 if dtype == np.float32 else 1e-12)


@each_shape
def test_distance_moves_no_faster_than_the_point(shape):
    at, step = points(), 1e-3 * points(reach=1.0)[::-1]
    before, _ = signed_distance(shape, at)
    after, _ = signed_distance(shape, at + step)
    assert (np.abs(after - before) <= np.linalg.norm(step, axis=1) + 1e-16).all()


@each_shape
def test_centres_and_axes_have_a_unit_normal_and_finite_derivatives(shape):
    at = np.array([[0.0, 0, 0], [0, 0, 0.01], [0, 0, -0.2]])
    distance, normal = signed_distance(shape, at)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, rtol=1e-14)
    assert np.isfinite(jax.jacobian(lambda p: signed_distance(shape, p)[1].sum())(jnp.asarray(at))).all()
    assert np.isfinite(distance).all()


def test_sizes_broadcast_and_are_differentiable():
    at = points(7)
    radii = np.linspace(0.01, 0.05, 7)
    distance, _ = signed_distance(Sphere(radii), at)
    one_by_one = [float(signed_distance(Sphere(r), p)[0]) for r, p in zip(radii, at, strict=True)]
    np.testing.assert_allclose(distance, one_by_one, rtol=1e-15)
    slope = jax.grad(lambda h: signed_distance(Cylinder(0.03, h), jnp.array([0.01, 0, 0.2]))[0])(0.1)
    assert slope == pytest.approx(-0.5)


@pytest.mark.parametrize(
    "shape, message",
    [
        (Sphere(0.0), r"Sphere.radius is 0.0: expected a positive number"),
        (Box(0.1, -0.2, 0.1), r"Box.width is -0.2"),
        (Cylinder(0.1, np.array([0.1, np.nan])), r"Cylinder.height\[1\] is nan"),
    ],
    ids=["zero", "negative", "nan"],
)
def test_a_shape_of_no_volume_is_refused(shape, message):
    with pytest.raises(ValueError, match=message):
        check_shape(shape)


def test_a_sound_shape_passes():
    for shape in SHAPES:
        check_shape(shape)


@each_shape
def test_a_shifted_solid_is_the_solid_elsewhere(shape):
    shift, at = np.array([0.01, -0.02, 0.03]), points(200)
    for shifted_value, expected in zip(signed_distance(Shifted(shape, *shift), at), signed_distance(shape, at - shift)):
        np.testing.assert_array_equal(shifted_value, expected)
