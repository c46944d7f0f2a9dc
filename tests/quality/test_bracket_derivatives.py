"""Derivatives of values between bounds, at the default tolerances, against differences of tight bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp
from jaxgrasp.quality import ferrari_canny, ferrari_canny_at, force_closure, largest_wrench
from tests.quality import known

BOUNDS = ("l1", "linf")
STEP = 1e-6
COUNT = 24


def tried_grasps() -> list[Grasp]:
    """Return closed grasps of four contacts, half with ordinary friction and half with friction from 1e-3 to 1e3."""
    plain = known.ordinary(4, 80, seed=7)
    wide = known.changed(plain, friction=10 ** np.random.default_rng(4).uniform(-3, 3, plain.friction.shape))
    batches = []
    for batch in (plain, wide):
        closed = np.flatnonzero(force_closure(batch).margin > 1e-6)[:COUNT]
        assert len(closed) == COUNT
        batches.append(jax.tree.map(lambda array, closed=closed: array[closed], batch))
    return batches


def tangent_of(grasp: Grasp) -> Grasp:
    """Return a random tangent of points, normals (at right angles to themselves) and friction (in proportion)."""
    rng = np.random.default_rng(5)
    across = rng.normal(size=grasp.normals.shape)
    across -= np.sum(across * grasp.normals, -1, keepdims=True) * grasp.normals
    friction = grasp.friction * rng.normal(size=grasp.friction.shape)
    return Grasp(0.03 * rng.normal(size=across.shape), across, friction, np.zeros_like(grasp.squeeze))


def moved(grasp: Grasp, step: float) -> Grasp:
    moved_grasp = jax.tree.map(lambda a, b: a + step * b, grasp, tangent_of(grasp))
    return known.changed(
        moved_grasp, normals=moved_grasp.normals / np.linalg.norm(moved_grasp.normals, axis=-1, keepdims=True)
    )


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_balls_derivatives_are_differences_of_tight_bounds(bound):
    """Both bounds, and ``ferrari_canny_at``; a direction of length 1 along which the body ends at the upper bound."""

    @jax.jit
    def slopes(grasp: Grasp, tangent: Grasp):
        def bounds(grasp):
            quality = ferrari_canny(grasp, bound)
            return quality.lower, quality.upper

        return jax.jvp(bounds, (grasp,), (tangent,))[1]

    for grasp in tried_grasps():
        ends = [ferrari_canny(moved(grasp, sign * STEP), bound, tol=1e-8) for sign in (1, -1)]
        assert all((end.lower > (1 - 1e-7) * end.upper).all() for end in ends)
        numeric = (ends[0].upper - ends[1].upper) / (2 * STEP)
        arguments = known.of_jax(grasp), known.of_jax(tangent_of(grasp))
        quality = ferrari_canny(grasp, bound)
        assert quality.located.all() and quality.converged.all()
        beside = jax.jvp(
            lambda g, bounds=quality: ferrari_canny_at(g, bounds), *((argument,) for argument in arguments)
        )[1]
        scale = np.abs(numeric) + quality.upper
        for slope in (*slopes(*arguments), beside):
            np.testing.assert_array_less(np.abs(slope - numeric) / scale, 1e-4)
        np.testing.assert_allclose(np.linalg.norm(quality.direction, axis=1), 1, rtol=1e-12)
        for index in range(COUNT):
            height = known.height(known.single(grasp, index), quality.direction[index][None], bound)[0]
            np.testing.assert_allclose(height, quality.upper[index], rtol=1e-3)


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_largest_wrenchs_derivatives_are_differences_of_tight_bounds(bound):
    task = np.random.default_rng(6).normal(size=(COUNT, 6)) * [1, 1, 1, 0.05, 0.05, 0.05]

    @jax.jit
    def slopes(grasp: Grasp, tangent: Grasp):
        def bounds(grasp):
            margin = largest_wrench(grasp, task, bound)
            return margin.lower, margin.upper

        return jax.jvp(bounds, (grasp,), (tangent,))[1]

    for grasp in tried_grasps():
        ends = [largest_wrench(moved(grasp, sign * STEP), task, bound, tol=1e-10) for sign in (1, -1)]
        assert all((end.lower > (1 - 1e-8) * end.upper).all() for end in ends)
        numeric = (ends[0].upper - ends[1].upper) / (2 * STEP)
        scale = np.abs(numeric) + ends[0].upper
        for slope in slopes(known.of_jax(grasp), known.of_jax(tangent_of(grasp))):
            np.testing.assert_array_less(np.abs(slope - numeric) / scale, 1e-2)


@pytest.mark.parametrize("bound", BOUNDS)
def test_bounds_left_apart_say_so_and_have_no_derivative(bound):
    grasp = jax.tree.map(lambda array: array[:3], tried_grasps()[0])
    quality = ferrari_canny(grasp, bound, max_points=14)
    assert not quality.converged.any() and not quality.located.any()
    assert str(quality).endswith("3 with bounds further apart than tol")
    inputs = known.of_jax(grasp)

    def of_friction(friction):
        return jnp.sum(ferrari_canny_at(known.changed(inputs, friction=friction), quality))

    assert np.isnan(jax.grad(of_friction)(inputs.friction)).all()
    closed = ferrari_canny(grasp, bound)
    assert closed.converged.all() and "apart" not in str(closed)
    for name, side in (("lower", -1), ("upper", 1)):

        def traced(friction, name=name):
            return jnp.sum(getattr(ferrari_canny(known.changed(inputs, friction=friction), bound, max_points=14), name))

        value, slope = jax.value_and_grad(traced)(inputs.friction)
        # Which directions a search that ends early has looked at hangs on the last digits.
        assert side * value >= side * closed.lower.sum() * (1 - 1e-3 * side)
        assert np.isnan(slope).all()


@pytest.mark.parametrize("count, limits, is_open", [(3, (600, 1000), False), (6, (150, 250), True)])
def test_soft_fingers_around_an_axis_say_that_their_bounds_stayed_apart(count, limits, is_open):
    """Under ``linf``, six and more come to the search's limit; the bounds still hold those of a longer search."""
    turn = 2 * np.pi * np.arange(count) / count
    outward = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    ring = Grasp(0.03 * outward, -outward, np.full(count, 0.5), np.ones(count), torsion=np.full(count, 0.01))
    short, long = (ferrari_canny(ring, "linf", max_points=points) for points in limits)
    assert short.lower <= long.upper * (1 + 1e-12) and long.lower <= short.upper * (1 + 1e-12)
    for ball in (short, long):
        assert bool(ball.converged) == (not is_open) == (ball.lower >= 0.999 * ball.upper)
        assert str(ball).endswith("1 with bounds further apart than tol") == is_open
