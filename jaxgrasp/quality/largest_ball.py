"""The largest balls around the origin in convex bodies, each between two proven bounds that are brought together.

Below, a surface of simplices inside the body (``inner_polytope.py``). Above, the body's reach along any direction.
The lowest facet shows where to look: along its normal the body either reaches no further, and the bounds have met, or
it has a point beyond the facet, which the surface takes in. Bodies are worked on side by side.
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
    for start in range(0, count, SIDE_BY_SIDE):
        own = np.arange(start, min(count, start + SIDE_BY_SIDE))
        _bring_together(bodies, own, balls, tol, max_points)
    return balls


def _bring_together(bodies: WrenchSets, own: np.ndarray, balls: Balls, tol: float, max_points: int) -> None:
    """Bring the bounds of some bodies together, whose lower ones are proven already."""
    shrinking = np.random.default_rng(0).uniform(size=max_points + 16)
    # One whose surface is large does not widen the arrays of others that come after it: all start at once.
    polytopes, some = InnerPolytopes(balls.lower[own]), bodies.take(own)
    while len(own):
        lowest, normals, corners = polytopes.lowest()
        reached = some.reach(normals)
        better = reached.height < balls.upper[own]
        balls.upper[own[better]] = reached.height[better]
        balls.direction[own[better]], balls.corners[own[better]] = normals[better], corners[better]
        drawn = reached.points * (1 - SHRINKING * tol * shrinking[polytopes.size])[:, None]
        met = (lowest >= (1 - tol) * balls.upper[own]) | (polytopes.size >= max_points)
        # No facet needs to come nearer than this for the bounds to meet.
        least = np.where(met, np.inf, tol / 2 * balls.upper[own])
        done = ~polytopes.grow(drawn, normals, least)
        if done.any():
            balls.lower[own[done]] = np.maximum(lowest[done], balls.lower[own[done]])
            own = own[~done]
            polytopes.keep(~done)
            some = some.take(~done)
