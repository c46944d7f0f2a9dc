"""The largest balls around the origin in convex bodies, each between two proven bounds that are brought together.

Below, a surface of simplices inside the body (``inner_polytope.py``). Above, the body's reach along any direction.
The lowest facet shows where to look: along its normal the body either reaches no further, and the bounds have met, or
it has a point beyond the facet, which the surface takes in. Bodies are worked on side by side, in coordinates where
they are about round (``rounded_bodies.py``).
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.inner_polytope import InnerPolytopes
from jaxgrasp.quality.rounded_bodies import RoundedBodies

SIDE_BY_SIDE = 64
"""Bodies: fewer, and the price of each operation counts; more, and their facets no longer fit the processor's cache."""
MOST_TOGETHER = 1 << 22
"""Facets that surfaces side by side have room for, some 300 MB: where that is too little, half of the bodies wait."""
SHRINKING = 1e-3
"""Largest share of the tolerance by which points are drawn towards the origin, each by another: corners that all lie in
one plane, as those of discs and pyramids do, make facets whose planes rounding decides."""
WITHIN = 0.9
"""Share of the balls known to lie inside that surfaces start with: singular values far below the largest are as exact
as the largest one's digits."""


class Balls(NamedTuple):
    """Bounds of the radii, and where the bodies end; directions are those of the mapped coordinates."""

    lower: np.ndarray
    """``(G,)``, but for rounding of the body's own data."""
    upper: np.ndarray
    """``(G,)``, likewise."""
    direction: np.ndarray
    """``(G, 6)``: along it the body reaches no further than ``upper``."""
    corners: np.ndarray
    """``(G, 6, 6)``: the body's points along these carry the facet across the direction; zeros for none."""
    converged: np.ndarray
    """``(G,)``: whether the bounds have met within the tolerance."""


def largest_balls(bodies: RoundedBodies, inside: np.ndarray, slack: np.ndarray, tol: float, max_points: int) -> Balls:
    """Bound the radii of the largest balls from both sides.

    The bounds end within ``tol`` of each other, relative to the upper one, also after ``slack`` is taken from the lower
    and added to the upper one, where half of ``tol`` is enough for that; unless a surface has ``max_points`` before, or
    more facets than there is room for.

    Args:
        bodies: convex, around the origin.
        inside: radii ``(G,)`` > 0 of balls that are known to lie in them, before and after they were mapped.
        slack: ``(G,)``: rounding of the bodies' own data.
        tol: relative.
        max_points: of each surface.
    """
    count = len(inside)
    balls = Balls(
        np.array(inside),
        np.full(count, np.inf),
        np.zeros((count, 6)),
        np.zeros((count, 6, 6)),
        np.zeros(count, bool),
    )
    for start in range(0, count, SIDE_BY_SIDE):
        indices = np.arange(start, min(count, start + SIDE_BY_SIDE))
        waiting = [indices]
        while waiting:
            waiting += _bring_together(bodies, inside, waiting.pop(), balls, slack, tol, max_points)
    return balls


def _bring_together(
    bodies: RoundedBodies,
    inside: np.ndarray,
    indices: np.ndarray,
    balls: Balls,
    slack: np.ndarray,
    tol: float,
    max_points: int,
) -> list[np.ndarray]:
    """Bring the bounds of the bodies ``indices`` together, and return the numbers of those that had to wait.

    These start again from the beginning, so that which others stand beside a body changes its bounds by rounding alone.
    """
    waiting: list[np.ndarray] = []
    shrinking = np.random.default_rng(0).uniform(size=max_points + 16)
    # A grasp whose surface is large does not widen the arrays of later ones: all start at once.
    active = bodies.take(indices)
    polytopes = InnerPolytopes(WITHIN * inside[indices], active.scales)
    while len(indices):
        lowest, normals, corners = polytopes.lowest()
        reached = active.bodies.reach(normals)
        better = reached.height < balls.upper[indices]
        balls.upper[indices[better]] = reached.height[better]
        balls.direction[indices[better]], balls.corners[indices[better]] = normals[better], corners[better]
        drawn = reached.points * (1 - SHRINKING * tol * shrinking[polytopes.size])[:, None]
        # Each surface proves its own bound: a later one that has lost digits does not take it back.
        balls.lower[indices] = np.maximum(lowest, balls.lower[indices])
        upper = balls.upper[indices]
        balls.converged[indices] = balls.lower[indices] >= (1 - tol) * upper + np.minimum(
            2 * slack[indices], tol / 2 * upper
        )
        ended = balls.converged[indices] | (polytopes.size >= max_points)
        # No facet needs to come nearer than this for the bounds to meet.
        least = np.where(ended, np.inf, tol / 2 * upper)
        done = ~polytopes.grow(drawn, normals, least)
        if done.any():
            indices = indices[~done]
            polytopes.keep(~done)
            active = active.take(~done)
        if polytopes.room > MOST_TOGETHER and len(indices) > 1:
            first: np.ndarray = np.arange(len(indices)) < len(indices) // 2
            waiting.append(indices[~first])
            indices, active = indices[first], active.take(first)
            polytopes.keep(first)
    return waiting
