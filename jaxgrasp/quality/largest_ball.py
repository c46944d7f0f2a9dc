"""The largest balls around the origin in convex bodies, each between two proven bounds that are brought together.

Below, a surface of simplices inside the body (``inner_polytope.py``). Above, the body's reach along any direction.
The lowest facet shows where to look: along its normal the body either reaches no further, and the bounds have met, or
it has a point beyond the facet, which the surface takes in. Bodies are worked on side by side; those that are done make
room for others.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.inner_polytope import InnerPolytopes
from jaxgrasp.quality.wrench_sets import WrenchSets

SIDE_BY_SIDE = 64
"""Bodies: fewer, and the price of each operation counts; more, and their facets no longer fit the processor's cache."""
SHRINKING = 1e-3
"""Largest share of the tolerance by which points are drawn towards the origin, each by another: corners that all lie in
one plane, as those of discs and pyramids do, make facets whose planes rounding decides."""


class Balls(NamedTuple):
    """What is known of the radii, and where the bodies end."""

    lower: np.ndarray
    """``(G,)``, but for rounding of the body's own data."""
    upper: np.ndarray
    """``(G,)``, likewise."""
    direction: np.ndarray
    """``(G, 6)``, unit: along it the body reaches no further than ``upper``."""
    corners: np.ndarray
    """``(G, 6, 6)``: the body's points along these carry the facet across the direction; zeros for none."""


def largest_balls(bodies: WrenchSets, inside: np.ndarray, tol: float, max_points: int) -> Balls:
    """The bounds, within ``tol`` of each other relative to the upper one unless there are ``max_points`` before.

    Args:
        bodies: convex, around the origin.
        inside: radii ``(G,)`` > 0 of balls that are known to lie in them.
        tol: relative.
        max_points: of each surface.
    """
    count = len(inside)
    balls = Balls(np.array(inside), np.full(count, np.inf), np.zeros((count, 6)), np.zeros((count, 6, 6)))
    shrinking = np.random.default_rng(0).uniform(size=max_points + 16)
    own = np.arange(min(count, SIDE_BY_SIDE))
    following, stars, some = len(own), InnerPolytopes(inside[own]), bodies.take(own)
    while len(own):
        lowest, normals, corners = stars.lowest()
        reached = some.reach(normals)
        better = reached.height < balls.upper[own]
        balls.upper[own[better]] = reached.height[better]
        balls.direction[own[better]], balls.corners[own[better]] = normals[better], corners[better]
        drawn = reached.points * (1 - SHRINKING * tol * shrinking[stars.size])[:, None]
        met = (lowest >= (1 - tol) * balls.upper[own]) | (stars.size >= max_points)
        # No facet needs to come nearer than this for the bounds to meet.
        least = np.where(met, np.inf, tol / 2 * balls.upper[own])
        done = ~stars.grow(drawn, normals, least)
        if done.any():
            balls.lower[own[done]] = np.maximum(lowest[done], inside[own[done]])
            own = own[~done]
            stars.keep(~done)
            if following < count and len(own) <= SIDE_BY_SIDE / 2:
                more = np.arange(following, min(count, following + SIDE_BY_SIDE - len(own)))
                stars.join(InnerPolytopes(inside[more]))
                own, following = np.concatenate([own, more]), following + len(more)
            some = bodies.take(own)
    return balls
