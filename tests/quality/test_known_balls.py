"""Balls whose radii are known, and those of grasps that are hard to get right."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from jaxgrasp.quality import ferrari_canny, force_closure
from jaxgrasp.quality.largest_ball import largest_balls, rounded
from jaxgrasp.quality.wrench_sets import WrenchSets
from tests.quality import known
from tests.quality.known import hull_radius, pyramid_edges


def tetrahedron(friction: float):
    outward = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    return known.grasp_of(0.05 * outward, -outward, friction)


RADII = {
    # The bounds prove it: it is screwed about the axis across two opposite edges.
    "tetrahedron": (tetrahedron, lambda friction: friction / np.sqrt(2)),
    # Turned about the axis that all contacts are equally far from: the squares of what contacts slide by at opposite
    # ends sum up to at least two thirds of a unit twist's.
    "octahedron": (known.on_axes, lambda friction: np.sqrt(2 / 3) * friction),
}


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("name", RADII)
def test_regular_grasps_turn_most_easily_and_by_known_radii(name, friction):
    """Many directions are equally hard; friction alone counts."""
    make, radius = RADII[name]
    quality, expected = ferrari_canny(make(friction), tol=1e-4), radius(friction)
    np.testing.assert_allclose(quality.upper, expected, rtol=1e-9)
    assert (1 - 1.01e-4) * quality.upper <= quality.lower <= expected * (1 + 1e-12)


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_a_triangle_lies_between_fine_pyramids(friction):
    grasp = known.triangle(friction)
    quality = ferrari_canny(grasp)
    frame = known.frame_of(grasp)
    inner, outer = (
        hull_radius(known.generators(grasp, *frame, 32, outside).reshape(-1, 6)) for outside in (False, True)
    )
    assert inner <= quality.upper and quality.lower <= outer < 1.02 * inner


@pytest.mark.parametrize("sides", [4, 8])
@pytest.mark.parametrize("n", [3, 5])
def test_pyramids_are_qhulls_to_nine_digits(n, sides):
    grasp = known.ordinary(n, 30)
    closed = np.flatnonzero(force_closure(grasp).margin > 0.01)[:4]
    quality = ferrari_canny(known.single(grasp, closed), sides=sides)
    for place, index in enumerate(closed):
        edges = pyramid_edges(known.single(grasp, index), sides).reshape(-1, 6)
        # Without a joggle: facets of coplanar edges are cut into simplices.
        hull = ConvexHull(np.concatenate([edges, np.zeros((1, 6))]), qhull_options="Qt")
        np.testing.assert_allclose(quality.upper[place], np.min(-hull.equations[:, -1]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_neither_the_scale_of_the_object_nor_many_contacts_in_one_place_matter(scale):
    grasp = known.triangle(0.4)
    names = ("points", "normals", "friction", "squeeze")
    crowd = known.changed(grasp, **{name: np.repeat(getattr(grasp, name), 4, 0) for name in names})
    shaken = 1e-9 * np.random.default_rng(0).normal(size=crowd.points.shape)
    expected = ferrari_canny(grasp, tol=1e-6).upper
    for other_grasp in (grasp, known.changed(crowd, points=crowd.points + shaken)):
        quality = ferrari_canny(known.changed(other_grasp, points=scale * other_grasp.points))
        assert quality.lower <= expected * (1 + 1e-6) and expected <= quality.upper * (1 + 1e-6)
        assert quality.lower >= (1 - 1.01e-3) * quality.upper


def test_soft_fingers_lie_between_pyramids_inside_and_around():
    """Ellipsoids of leans, by their edges of many sides and moments."""
    grasp = known.ordinary(4, 30, torsion=True)
    closed = np.flatnonzero(force_closure(grasp).margin > 0.01)[:3]
    for index in closed:
        single_grasp = known.single(grasp, int(index))
        quality = ferrari_canny(single_grasp)
        inner = ferrari_canny(single_grasp, sides=16)
        assert inner.lower <= quality.upper and quality.lower <= dense(single_grasp)


def dense(grasp) -> float:
    """Search the least height along many directions near those of small ones."""
    rng, best = np.random.default_rng(0), np.eye(6)[0]
    for width in np.geomspace(2, 1e-3, 12):
        tried = best + width * rng.normal(size=(4000, 6))
        tried /= np.linalg.norm(tried, axis=1, keepdims=True)
        best = tried[np.argmin(known.height(grasp, tried, "l1"))]
    return float(known.height(grasp, best[None], "l1")[0])


def test_rank_deficient_and_open_grasps_have_a_radius_of_zero_beside_closed_ones():
    """In one batch, whatever stands beside them."""
    closed = known.triangle()
    flat = known.grasp_of(np.full((3, 3), 0.3), [[1, 0, 0], [-1, 0, 0], [0, 1, 0]], 0.9)
    sided = known.star([0, 50, 100], 0.3)
    fields = {name: np.stack([getattr(g, name) for g in (closed, flat, sided)]) for name in ("points", "normals")}
    grasps = known.grasp_of(fields["points"], fields["normals"], np.array([[0.5], [0.9], [0.3]]))
    quality = ferrari_canny(grasps)
    np.testing.assert_allclose(quality.upper[0], ferrari_canny(closed).upper, rtol=1e-9)
    assert (quality.upper[1:] == 0).all() and quality.lower[0] > 0
    assert known.height(sided, quality.direction[2][None], "l1") < 1e-12


def test_bodies_that_wait_for_others_have_the_same_balls():
    """More than are worked on side by side: cross-polytopes, whose radii are known."""
    rng = np.random.default_rng(0)
    radii = rng.uniform(0.1, 1, 150)
    corners = np.concatenate([np.eye(6), -np.eye(6)]) * radii[:, None, None]
    discs = np.zeros((150, 12, 4, 6))
    discs[:, :, 0] = corners
    bodies = WrenchSets(discs, np.ones((150, 12), bool), np.full(150, 1e-15))
    balls = largest_balls(rounded(bodies), radii / 10, np.zeros(150), 1e-3, 1000)
    np.testing.assert_allclose(balls.upper, radii / np.sqrt(6), rtol=1e-3)
    assert (balls.lower <= radii / np.sqrt(6)).all() and (balls.lower >= 0.999 * balls.upper).all()
