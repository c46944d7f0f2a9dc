"""Balls in bodies that are flat by many powers of ten: bounds that hold and meet, in bounded time and memory."""

import jax
import numpy as np
import pytest

from jaxgrasp.quality import ferrari_canny, force_closure, largest_ball
from tests.quality import known

BOUNDS = ("l1", "linf")
CORNERS = [0, 90, 180, 270]


@pytest.mark.parametrize("bound", BOUNDS)
def test_the_ball_is_linear_in_a_tiny_friction(bound):
    """Four fingers push the object only within their plane: every other wrench is exerted by friction alone."""
    rough = ferrari_canny(known.star(CORNERS, 1e-5), bound, tol=1e-5)
    assert rough.converged
    per_friction = rough.upper / 1e-5
    np.testing.assert_allclose(per_friction, np.sqrt(1 / 3) if bound == "l1" else per_friction, rtol=1e-4)
    for friction in (1e-7, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13):
        quality = ferrari_canny(known.star(CORNERS, friction), bound)
        expected = friction * per_friction
        assert quality.lower <= expected * (1 + 1e-4) and expected <= quality.upper * (1 + 1e-4)
        assert quality.lower > expected / 2 and quality.located
        assert quality.converged == (quality.lower >= 0.999 * quality.upper)
        assert quality.converged or friction < 2e-11
        np.testing.assert_allclose(np.linalg.norm(quality.direction), 1, rtol=1e-12)


def test_frictions_of_very_different_sizes_end_in_bounds_that_meet():
    for n, bound in ((4, "l1"), (4, "linf"), (6, "l1")):
        plain = known.ordinary(n, 20, seed=3)
        wide = known.changed(plain, friction=10 ** np.random.default_rng(n).uniform(-3, 9, plain.friction.shape))
        quality = ferrari_canny(wide, bound)
        assert (quality.lower > 0).sum() >= 15
        assert quality.converged.all() and quality.located.all()


@pytest.mark.parametrize("bound", BOUNDS)
def test_a_long_length_leaves_a_ball_of_torques(bound):
    """With a long length the hardest wrench is a torque, and the radius is that torque over the length."""
    grasp = known.ordinary(5, 12, seed=3)
    short, long = (ferrari_canny(grasp, bound, length=length) for length in (1e3, 1e7))
    assert (short.lower > 0).sum() >= 6 and short.converged.all() and long.converged.all()
    assert (1e3 * short.lower <= 1e7 * long.upper * (1 + 1e-4)).all()
    assert (1e7 * long.lower <= 1e3 * short.upper * (1 + 1e-4)).all()


@pytest.mark.parametrize("bound", BOUNDS)
def test_contacts_almost_on_a_line_have_a_ball_as_narrow_as_they_are(bound):
    """Radii shrink in proportion to the width, once it is small."""
    grasp = known.ordinary(5, 12, seed=3)
    middle = grasp.points.mean(1, keepdims=True)
    radii = []
    for width in (1e-4, 1e-7):
        narrow = known.changed(grasp, points=middle + (grasp.points - middle) * [1, width, width])
        quality = ferrari_canny(narrow, bound, length=0.05)
        assert quality.converged.all() and (quality.lower > 0).sum() >= 4
        radii.append((quality.lower / width, quality.upper / width))
    (wide_lower, wide_upper), (narrow_lower, narrow_upper) = radii
    assert (wide_lower <= narrow_upper * 1.01).all() and (narrow_lower <= wide_upper * 1.01).all()


def test_a_surface_without_room_for_more_facets_leaves_true_bounds(monkeypatch):
    grasp = known.ordinary(5, 6, seed=3)
    exact = ferrari_canny(grasp, "linf")
    monkeypatch.setattr(largest_ball, "MOST_FACETS", 300)
    rough = ferrari_canny(grasp, "linf")
    closed = force_closure(grasp).closed
    assert closed.any() and not rough.located[closed].any() and not rough.converged[closed].any()
    assert (rough.lower <= exact.upper).all() and (exact.lower <= rough.upper).all() and (rough.lower[closed] > 0).all()


def test_bodies_that_wait_for_room_have_the_same_balls(monkeypatch):
    grasp = known.ordinary(5, 12, seed=3)
    together = ferrari_canny(grasp, "linf")
    monkeypatch.setattr(largest_ball, "MOST_TOGETHER", 1000)
    for value, expected in zip(together, ferrari_canny(grasp, "linf"), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-7, atol=1e-10)


def test_a_tolerance_beyond_the_digits_ends_with_what_they_allow():
    """No bound is worse than by a tolerance that they do allow; here rounding alone makes facets without end."""
    grasp = jax.tree.map(lambda array: array[1:2], known.ordinary(4, 3, seed=1))
    fine, finest = (ferrari_canny(grasp, "linf", tol=tol) for tol in (1e-8, 1e-13))
    closed = fine.lower > 0
    assert closed.any() and fine.converged.all()
    assert not finest.converged[closed].any() and finest.located.all()
    assert (finest.lower >= (1 - 1e-8) * fine.upper).all()
