"""The ball of wrenches: its bounds against hulls by Qhull and brute force, laws, and derivatives."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from jaxgrasp import Grasp
from jaxgrasp.quality import Epsilon, ferrari_canny, ferrari_canny_at, force_closure
from jaxgrasp.quality.grasp_input import ROUNDING
from jaxgrasp.quality.largest_ball import InnerPolytopes
from tests.quality import known

BOUNDS = ("l1", "linf")
TOL = 1e-3


def closed_ones(n: int, count: int, torsion: bool = False, least: float = 0.01) -> Grasp:
    """Return ordinary grasps that are closed with a margin of at least ``least``."""
    grasp = known.ordinary(n, 6 * count, torsion=torsion)
    indices = np.flatnonzero(force_closure(grasp).margin > least)[:count]
    assert len(indices) == count
    return jax.tree.map(lambda array: array[indices], grasp)


def brute_force(grasp: Grasp, bound: str, starts: int = 12) -> float:
    """Search the least height over many directions and refine the best of them."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    heights = known.height(grasp, directions, bound)

    def height(d):
        return known.height(grasp, d[None] / np.linalg.norm(d), bound)[0]

    best = directions[np.argsort(heights)[:starts]]
    options = {"maxiter": 4000, "xatol": 1e-7, "fatol": 1e-9, "adaptive": True}
    return min(minimize(height, d, method="Nelder-Mead", options=options).fun for d in best)


@pytest.mark.parametrize("n", [3, 4])
def test_cones_lie_between_fine_pyramids(n):
    batch = closed_ones(n, 2)
    quality = ferrari_canny(batch)
    for index in range(2):
        grasp = known.single(batch, index)
        length, about = known.frame_of(grasp)
        inner, outer = (
            known.hull_radius(known.generators(grasp, length, about, 16, outside).reshape(-1, 6))
            for outside in (False, True)
        )
        assert inner <= quality.upper[index] + 1e-8 and quality.lower[index] <= outer + 1e-8
        assert outer < 1.1 * inner


@pytest.mark.slow
@pytest.mark.parametrize("torsion", [False, True])
@pytest.mark.parametrize("bound", BOUNDS)
def test_bounds_agree_with_brute_force(bound, torsion):
    batch = closed_ones(5, 3, torsion)
    quality = ferrari_canny(batch, bound)
    for index in range(3):
        least = brute_force(known.single(batch, index), bound)
        assert quality.lower[index] <= least * (1 + 1e-9)
        assert quality.upper[index] <= least * (1 + 1e-6)


@pytest.mark.parametrize("bound", BOUNDS)
def test_no_direction_is_below_the_lower_bound_and_the_one_found_reaches_the_upper(bound):
    batch = closed_ones(5, 3, torsion=True)
    quality = ferrari_canny(batch, bound)
    rng = np.random.default_rng(1)
    for index in range(3):
        grasp, direction = known.single(batch, index), quality.direction[index]
        near = direction + rng.normal(size=(20_000, 6)) * np.geomspace(1e-6, 3, 20_000)[:, None]
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        assert known.height(grasp, near, bound).min() >= quality.lower[index]
        np.testing.assert_allclose(known.height(grasp, direction[None], bound)[0], quality.upper[index], rtol=1e-10)
        assert quality.lower[index] >= (1 - 1.01 * TOL) * quality.upper[index]


@pytest.mark.parametrize("sides", [4, 7])
def test_pyramids_with_a_bounded_sum_are_their_hull(sides):
    batch = closed_ones(5, 3, least=0.03)
    quality = ferrari_canny(batch, sides=sides)
    for index in range(3):
        radius = known.hull_radius(known.pyramid_edges(known.single(batch, index), sides).reshape(-1, 6))
        np.testing.assert_allclose(quality.upper[index], radius, rtol=1e-6)


def test_pyramids_with_each_force_bounded_are_their_minkowski_sum():
    batch = closed_ones(3, 2)
    quality = ferrari_canny(batch, "linf", sides=4)
    assert (quality.lower > 0).all()
    for index in range(2):
        edges = known.pyramid_edges(known.single(batch, index), 4)
        choices = [np.concatenate([np.zeros((1, 6)), edge]) for edge in edges]
        radius = known.hull_radius(np.array([np.sum(chosen, 0) for chosen in itertools.product(*choices)]))
        np.testing.assert_allclose(quality.upper[index], radius, rtol=1e-6)


@pytest.mark.parametrize("torsion", [0.005, 0.03])
def test_two_soft_fingers(torsion):
    """Fingers on a line: they turn about it by torsion / length = g, and slide and turn the other ways by friction.

    Along d = (t, s, 0, 0, 0, s) they work at the rates 2 mu s - t and t: at most mu s, where t = mu s.
    """
    quality = ferrari_canny(known.two_fingers(torsion), tol=1e-2)
    expected = min(torsion / 0.05, 0.5 / np.sqrt(2 + 0.5**2))
    assert quality.lower <= expected * (1 + 1e-12) and expected <= quality.upper * (1 + 1e-12)
    np.testing.assert_allclose(quality.upper, expected, rtol=1e-9)


@pytest.mark.parametrize("bound", ["l1", pytest.param("linf", marks=pytest.mark.slow)])
def test_frame_order_and_padding_do_not_matter(bound):
    grasp = closed_ones(4, 2)
    turned, _ = known.turned(grasp)
    names = ("points", "normals", "friction", "squeeze")
    others = [
        turned,
        known.changed(grasp, points=grasp.points + [1.0, -2.0, 0.5]),
        known.changed(grasp, points=100 * grasp.points),
        known.changed(grasp, **{name: getattr(grasp, name)[:, ::-1] for name in names}),
        known.padded(grasp),
    ]
    plain = ferrari_canny(grasp, bound)
    for other_grasp in others:
        quality = ferrari_canny(other_grasp, bound)
        np.testing.assert_allclose(quality.upper, plain.upper, rtol=1e-7)
        assert (quality.lower <= plain.upper).all() and (plain.lower <= quality.upper).all()
    rescaled = ferrari_canny(known.changed(grasp, points=100 * grasp.points), bound, length=5.0)
    np.testing.assert_allclose(rescaled.upper, ferrari_canny(grasp, bound, length=0.05).upper, rtol=1e-7)


@pytest.mark.parametrize("bound", BOUNDS)
def test_more_friction_and_more_contacts_never_hurt_and_a_longer_unit_never_helps(bound):
    frame = {"length": 0.05, "about": np.zeros(3)}
    grasp = closed_ones(4, 2)
    grasp = known.changed(grasp, points=grasp.points - grasp.points.mean(1, keepdims=True))
    plain = ferrari_canny(grasp, bound, **frame)
    rough = ferrari_canny(known.changed(grasp, friction=1.2 * grasp.friction), bound, **frame)
    assert (plain.lower <= rough.upper).all() and (rough.upper > plain.upper).all()
    fewer = known.changed(grasp, present=np.array([[1.0, 1, 1, 0]] * 2))
    assert (ferrari_canny(fewer, bound, **frame).lower <= plain.upper).all()
    longer = ferrari_canny(grasp, bound, length=0.1, about=np.zeros(3))
    assert (longer.lower <= plain.upper).all() and (2 * longer.upper >= plain.lower).all()


def test_each_force_bounded_gives_at_least_what_their_sum_bounded_gives_and_at_most_n_times_that():
    grasp = closed_ones(5, 3)
    total, by_force = (ferrari_canny(grasp, bound) for bound in BOUNDS)
    assert (total.lower <= by_force.upper).all() and (by_force.lower <= 5 * total.upper).all()


def test_few_points_leave_the_bounds_apart_but_true():
    grasp = closed_ones(8, 2)
    exact = ferrari_canny(grasp, "linf")
    for max_points in (1, 40, 80):
        rough = ferrari_canny(grasp, "linf", max_points=max_points)
        assert (rough.lower > 0).all()
        assert (rough.lower <= exact.upper).all() and (exact.lower <= rough.upper).all()


def test_grasps_that_are_not_closed_have_none():
    for grasp in (known.two_fingers(None), known.on_axes(0.0), known.star([0, 50, 100], 0.3)):
        quality = ferrari_canny(grasp)
        assert quality.lower == quality.upper == 0 and not quality.normal_force.any()
        np.testing.assert_allclose(np.linalg.norm(quality.direction), 1)
        assert known.height(grasp, quality.direction[None], "l1")[0] < 1e-12
    for sides in (3, 4):
        assert ferrari_canny(known.two_fingers(None), "linf", sides=sides).upper == 0


def test_every_ray_meets_a_surface_an_odd_number_of_times_even_where_points_coincide():
    stars, rng = InnerPolytopes(np.array([0.1, 0.2])), np.random.default_rng(0)
    for _ in range(60):
        point = np.round(rng.normal(size=6), 1)
        points = np.stack([point, 2 * point])
        stars.grow(points, points, np.full(2, 1e-9))
        stars.grow(points * (1 - 1e-12), points, np.full(2, 1e-15))
    rays = rng.normal(size=(20, 6))
    for index in range(2):
        corners, normals, offsets = stars.simplices(index)
        flat = np.abs(np.linalg.det(corners)) < 1e-12
        shares = np.linalg.solve(np.swapaxes(corners, -1, -2)[~flat][:, None], rays[..., None])[..., 0]
        assert (np.sum((shares > 0).all(-1), 0) % 2 == 1).all()
        # What bounds are lessened by for rounding covers that of their own planes.
        slack = ROUNDING * np.finfo(float).eps * np.linalg.norm(corners, axis=-1).max()
        assert (np.einsum("fcj,fj->fc", corners, normals).min(1) >= offsets - slack).all()


def directions_of(grasp: Grasp, seed: int = 5) -> Grasp:
    """Return a random tangent of points, normals (at right angles to themselves), friction and torsion."""
    rng = np.random.default_rng(seed)
    across = rng.normal(size=grasp.normals.shape)
    across -= np.sum(across * grasp.normals, -1, keepdims=True) * grasp.normals
    torsion = None if grasp.torsion is None else 0.01 * rng.normal(size=grasp.torsion.shape)
    squeeze = np.zeros_like(grasp.squeeze)
    return Grasp(0.03 * rng.normal(size=across.shape), across, rng.normal(size=squeeze.shape), squeeze, None, torsion)


def moved(grasp: Grasp, tangent: Grasp, step: float) -> Grasp:
    moved_grasp = jax.tree.map(lambda a, b: a + step * b, grasp, tangent)
    return known.changed(
        moved_grasp, normals=moved_grasp.normals / np.linalg.norm(moved_grasp.normals, axis=-1, keepdims=True)
    )


@pytest.mark.parametrize(
    ("bound", "sides"), [("l1", None), pytest.param("linf", None, marks=pytest.mark.slow), ("l1", 6), ("linf", 5)]
)
def test_derivatives_are_those_of_the_value(bound, sides):
    grasp = closed_ones(5, 4, torsion=True)
    quality = ferrari_canny(grasp, bound, sides=sides)

    @jax.jit
    def value(grasp: Grasp):
        return ferrari_canny_at(grasp, quality)

    inputs, tangent = known.of_jax(grasp), known.of_jax(directions_of(grasp))
    values, forward = jax.jvp(value, (inputs,), (tangent,))
    polished = np.abs(values - quality.upper) < 1e-9 * quality.upper
    assert polished.sum() >= 3
    reverse = jax.grad(lambda grasp: jnp.sum(value(grasp)))(inputs)
    product = sum(
        np.sum(np.asarray(a * b).reshape(4, -1), 1) for a, b in zip(jax.tree.leaves(reverse), jax.tree.leaves(tangent))
    )
    np.testing.assert_allclose(product, forward, rtol=1e-9, atol=1e-12)
    step = 1e-5
    ends = [ferrari_canny(moved(grasp, directions_of(grasp), sign * step), bound, sides=sides) for sign in (1, -1)]
    numeric = (ends[0].upper - ends[1].upper) / (2 * step)
    np.testing.assert_allclose(np.asarray(forward)[polished], numeric[polished], rtol=2e-5, atol=1e-6)


def test_the_differentiable_value_works_under_jit_and_vmap():
    grasp = closed_ones(4, 3)
    quality = ferrari_canny(grasp)
    expected = ferrari_canny_at(known.of_jax(grasp), quality)
    single = jax.jit(jax.vmap(lambda g, *f: ferrari_canny_at(g, Epsilon(*f))))(known.of_jax(grasp), *quality)
    np.testing.assert_allclose(single, expected, rtol=1e-12)
    np.testing.assert_allclose(expected, quality.upper, rtol=TOL)


@pytest.mark.usefixtures("unchecked")
def test_bad_options_are_named():
    grasp = known.triangle()
    with pytest.raises(ValueError, match="bound is 'l2': expected 'l1' or 'linf'"):
        ferrari_canny(grasp, "l2")
    with pytest.raises(ValueError, match="sides is 2: expected a whole number, 3 or more, or None"):
        ferrari_canny(grasp, sides=2)
    with pytest.raises(ValueError, match="tol is 0: expected a number between 0 and 1"):
        ferrari_canny(grasp, tol=0)
    with pytest.raises(ValueError, match="max_points is 0: expected 1 to 1000"):
        ferrari_canny(grasp, max_points=0)


def test_inside_jit_vmap_and_grad_it_is_the_same():
    grasp = closed_ones(4, 3)
    plain = ferrari_canny(grasp)
    inside = jax.jit(jax.vmap(ferrari_canny))(known.of_jax(grasp))
    for name in ("lower", "upper", "direction"):
        np.testing.assert_allclose(getattr(inside, name), getattr(plain, name), rtol=1e-9, atol=1e-9)

    def upper(points):
        return jnp.sum(ferrari_canny(known.changed(known.of_jax(grasp), points=points)).upper)

    def beside(points):
        return jnp.sum(ferrari_canny_at(known.changed(known.of_jax(grasp), points=points), plain))

    points = jnp.asarray(grasp.points)
    np.testing.assert_allclose(jax.jit(jax.grad(upper))(points), jax.grad(beside)(points), rtol=1e-6, atol=1e-9)
