"""The largest ball around the origin in a convex body, between two proven bounds that are brought together.

Below, a surface of simplices inside the body (``inner_polytope.py``). Above, the body's reach along any direction.
The lowest facet shows where to look: along its normal the body either reaches no further, and the bounds have met, or
it has a point beyond the facet, which the surface takes in.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.inner_polytope import InnerPolytope
from jaxgrasp.quality.wrench_sets import Reach, WrenchSet

AT_ONCE = 8
"""Facets that are looked at together: more of them take in points that others have made useless."""
SHRINKING = 1e-3
"""Largest share of the tolerance by which points are drawn towards the origin, each by another: corners that all lie in
one plane, as those of discs and pyramids do, make facets whose planes rounding decides."""


class Ball(NamedTuple):
    """What is known of the radius, and where the body ends."""

    lower: float
    upper: float
    direction: np.ndarray
    """``(6,)``, unit: along it the body reaches no further than ``upper``."""
    touched: Reach
    """Points of the body about as far along the direction."""


def largest_ball(body: WrenchSet, inside: float, tol: float, max_points: int) -> Ball:
    """The bounds, within ``tol`` of each other relative to the upper one unless there are ``max_points`` before.

    Args:
        body: convex, around the origin.
        inside: radius of a ball that is known to lie in it.
        tol: relative.
        max_points: of the surface.
    """
    rng = np.random.default_rng(0)
    star, seen = InnerPolytope(inside), [body.reach(np.concatenate([np.eye(6), -np.eye(6)]))]
    upper, direction = np.inf, np.zeros(6)
    while True:
        facets = star.lowest(AT_ONCE)
        normals, lowest = star.normals[facets], star.offsets.min()
        reached = body.reach(normals)
        seen.append(reached)
        best = np.argmin(reached.height)
        if reached.height[best] < upper:
            upper, direction = reached.height[best], normals[best]
        if lowest >= (1 - tol) * upper or len(star.points) >= max_points:
            break
        drawn = reached.points * (1 - SHRINKING * tol * rng.uniform(size=(len(facets), 1)))
        # No facet needs to come nearer than this for the bounds to meet.
        grown = [star.grow(point, tol / 2 * upper) for point in drawn]
        if not any(grown):
            break
    lower = max(lowest - body.slack, inside)
    everything = Reach(*(np.concatenate(parts) for parts in zip(*seen)))
    near = everything.points @ direction >= (1 - 4 * tol) * upper
    return Ball(lower, upper + body.slack, direction, Reach(*(part[near] for part in everything)))
