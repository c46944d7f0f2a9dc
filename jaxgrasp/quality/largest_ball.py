"""The largest balls around the origin in convex bodies, each between two proven bounds that are brought together.

Below, a surface of simplices inside the body (see the third part). Above, the body's reach along any direction.
The lowest facet shows where to look: along its normal the body either reaches no further, and the bounds have met, or
it has a point beyond the facet, which the surface takes in. Bodies are worked on side by side, in coordinates where
they are about round.

Coordinates in which bodies of wrenches are about as long in all directions, for the search of their largest balls.

Contacts with little friction, almost on a line, or far from where torques are taken exert wrenches of which those in
weak directions are shorter by many powers of ten. Planes through points of such a flat body lose as many digits. A
linear map shortens the long axes of the discs' matrix to the shortest: facets and Newton's equations then have numbers
of equal size, and only lengths are measured in the original coordinates.

Closed surfaces of simplices around the origin, with corners in convex bodies: a ball they hold is in the body too.

Such a surface grows by points of the body, as a convex hull does. What makes its ball a proof is not that it is
convex, which rounding may spoil, but that every ray from the origin meets one of its simplices: all of them are in the
body, and none comes nearer to the origin than the least distance of its corners along any unit vector. Rays keep
meeting it whatever facets a point replaces, if it lies beyond their planes and the origin does not: the
simplices between the point and those facets, whose surface is added, then do not hold the origin.

Many surfaces grow side by side, each by a point of its own: then each step is a few operations on long arrays. A facet
is one whole number, the numbers of its corners in ascending order; ridges that only one of a point's facets has are
found by sorting them all.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.wrench_sets import WrenchSets


class RoundedBodies(NamedTuple):
    """Bodies ``G`` whose wrenches w are mapped to diag(scales) axes^T w.

    A direction e of the mapped coordinates stands for the direction axes (scales * e) of the original ones, and reaches
    of both along these are equal. Directions are normalised to |scales * e| = 1, so heights are those of the bodies
    before they were mapped.
    """

    bodies: WrenchSets
    """The mapped wrenches."""
    axes: np.ndarray
    """``(G, 6, 6)``: orthonormal columns."""
    scales: np.ndarray
    """``(G, 6)``: 0 to 1."""

    def take(self, selection: np.ndarray) -> "RoundedBodies":
        """Return the bodies of these numbers, or of this mask."""
        return RoundedBodies(self.bodies.take(selection), self.axes[selection], self.scales[selection])

    def original(self, directions: np.ndarray) -> np.ndarray:
        """Return the unit directions ``(G, 6)`` in original coordinates that mapped ones stand for."""
        plain = np.matmul(self.axes, (self.scales * directions)[..., None])[..., 0]
        return plain / np.linalg.norm(plain, axis=1, keepdims=True)

    def normalised(self, directions: np.ndarray) -> np.ndarray:
        """Return mapped directions ``(G, 6)`` of any length with |scales * e| = 1."""
        return directions / np.linalg.norm(self.scales * directions, axis=1, keepdims=True)


def rounded(bodies: WrenchSets) -> RoundedBodies:
    """Map bodies by the singular values s of their discs' matrix, or of their edges' one: scales are min(s) / s.

    A ball of the radius that ``decide_all`` proves (its ``margin``) lies in the mapped bodies too: the proof moves the
    forces of each contact by up to r, which makes any wrench of length r min(s) before and after the mapping.

    Args:
        bodies: force-closed, so that no singular value is zero.
    """
    _, sizes, rows = np.linalg.svd(bodies.alone_edges().discs.reshape(len(bodies.present), -1, 6), full_matrices=False)
    scales = sizes[:, -1:] / sizes
    axes = np.swapaxes(rows, 1, 2)
    discs = np.matmul(bodies.discs, axes[:, None]) * scales[:, None, None]
    return RoundedBodies(replace(bodies, discs=discs), axes, scales)


BITS = 10
"""Bits of a whole number of 64, for each of six corners."""
MOST_POINTS = 1 << BITS
MOST_SURFACES = 1 << (64 - 5 * BITS)
"""Ridges are sorted by surface and corners at once."""
ROOM = 192
"""Facets that arrays have room for at first."""
MOST_FACETS = 1 << 18
"""Facets of a surface at most, some seconds of work: most balls take a thousand, and those that touch the body along a
whole circle, as of contacts evenly around an axis, up to 200,000. More come of lost digits alone, without end."""
NEARLY_FLAT = 1e-9
"""Relative singular value of a facet's corners under which they span no plane but a smaller flat."""
UNEVEN = 1e-11
"""Relative difference in height of a facet's corners above which its plane is computed with more care."""
FLUSH = 1e-10
"""Relative height of a point above a facet's plane at which it lies in that plane but for lost digits."""

_CORNERS = np.arange(5, -1, -1, dtype=np.uint64) * np.uint64(BITS)
"""Shifts of the corners in a facet's number, the first corner in the highest bits."""
_CORNER_MASK = np.uint64(MOST_POINTS - 1)
_AXES = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0]
"""A turn of the coordinates that a surface keeps its points in: elimination without pivots dislikes zeros, which points
of symmetric grasps have many of."""


class InnerPolytopes:
    """Surfaces of five-dimensional simplices in six dimensions, ``G`` of them."""

    def __init__(self, radii: np.ndarray, scales: np.ndarray | None = None):
        """Start with cross-polytopes whose corners are ``radii`` (G,) away from the origin.

        Normals n of facets have the length 1 in the norm |scales * n|, and offsets are heights along such normals.
        With ``scales`` (G, 6) of ones, as where none are given, that is the plain distance of a facet's plane.
        """
        count = len(radii)
        self._scales = np.ones((count, 6)) if scales is None else scales
        if count > MOST_SURFACES:
            raise ValueError(f"radii has {count} entries: expected {MOST_SURFACES} at most")
        self._points = np.zeros((count, 32, 6))
        self._points[:, :12] = np.concatenate([np.eye(6), -np.eye(6)]) @ _AXES * radii[:, None, None]
        self.along = np.zeros((count, 32, 6))
        """``(G, P, 6)``: what each point was taken in with; zeros for those of the cross-polytopes."""
        self.size = np.full(count, 12)
        """``(G,)``: how many points there are."""
        signs = np.array(list(itertools.product((0, 6), repeat=6)))
        chosen = np.sort(np.arange(6) + signs, 1).astype(np.uint64)
        self._facets = np.zeros((count, ROOM), np.uint64)
        self._facets[:, :64] = np.bitwise_or.reduce(chosen << _CORNERS, 1)
        self._normals = np.zeros((count, ROOM, 6))
        normals = np.where(signs > 0, -1.0, 1.0)
        lengths = np.linalg.norm(normals * self._scales[:, None], axis=2)
        self._normals[:, :64] = normals @ _AXES / lengths[..., None]
        self._offsets = np.full((count, ROOM), np.inf)
        """``(G, F)``: no corner of a facet is nearer along its normal; infinite where there is no facet."""
        self._offsets[:, :64] = radii[:, None] / lengths
        self._used = np.full(count, 64)
        """``(G,)``: facets lie before this."""

    @property
    def room(self) -> int:
        """Number of facets that the arrays of all surfaces have room for."""
        return self._facets.size

    def lowest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find each surface's facet of least offset: its offset, normal ``(G, 6)``, ``along`` at its corners."""
        surfaces = np.arange(len(self.size))
        facet = np.argmin(self._offsets, 1)
        corners = corners_of(self._facets[surfaces, facet])
        normals = self._normals[surfaces, facet] @ _AXES.T
        return self._offsets[surfaces, facet], normals, self.along[surfaces[:, None], corners]

    def grow(self, points: np.ndarray, along: np.ndarray, least: np.ndarray) -> np.ndarray:
        """Take a point ``(G, 6)`` into each surface, if it lies beyond a facet by ``least`` (G,) > 0 or more and the
        surface then has no more than ``MOST_FACETS`` facets.

        Returns:
            ``(G,)``: whether it was taken.
        """
        if self._points.shape[1] == self.size.max(initial=0):
            self._points, self.along = (_doubled(array) for array in (self._points, self.along))
        surfaces = np.arange(len(self.size))
        points = points @ _AXES
        self._points[surfaces, self.size], self.along[surfaces, self.size] = points, along
        beyond = np.matmul(self._normals, points[..., None])[..., 0] - (1 + FLUSH) * self._offsets
        taken = beyond.max(1) >= least
        # The origin is on the other side of these only.
        surface, facet = np.nonzero((beyond > 0) & (self._offsets > 0) & taken[:, None])
        owners, ridges = _rims(surface, self._facets[surface, facet])
        freed, added = (np.bincount(index, minlength=len(surfaces)) for index in (surface, owners))
        has_room = self._used + added - freed <= MOST_FACETS
        if not has_room.all():
            taken &= has_room
            surface, facet = surface[has_room[surface]], facet[has_room[surface]]
            owners, ridges = owners[has_room[owners]], ridges[has_room[owners]]
        new = (ridges << np.uint64(BITS)) | self.size[owners].astype(np.uint64)
        normals, offsets = self._planes(owners, new)
        self._offsets[surface, facet] = np.inf
        slots = self._slots(surface, facet, owners)
        self._facets[owners, slots] = new
        self._normals[owners, slots] = normals
        self._offsets[owners, slots] = offsets
        self.size += taken
        return taken

    def simplices(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the corners ``(F, 6, 6)``, normals and offsets of one surface's facets."""
        is_facet = np.isfinite(self._offsets[index])
        corners = self._points[index, corners_of(self._facets[index, is_facet])]
        return corners @ _AXES.T, self._normals[index, is_facet] @ _AXES.T, self._offsets[index, is_facet]

    def keep(self, mask: np.ndarray) -> None:
        """Drop all surfaces but those of the mask ``(G,)``, and room that these do not need."""
        for name, array in vars(self).items():
            setattr(self, name, array[mask])
        most = self._used.max(initial=0)
        for name in ("_facets", "_normals", "_offsets"):
            setattr(self, name, getattr(self, name)[:, :most])

    def _slots(self, surface: np.ndarray, facet: np.ndarray, owners: np.ndarray) -> np.ndarray:
        """Assign array slots to new facets: the slots of the facets that they replace, then slots at the end."""
        count = len(self.size)
        freed, added = (np.bincount(index, minlength=count) for index in (surface, owners))
        rank = np.arange(len(owners)) - np.repeat(np.cumsum(added) - added, added)
        slots = self._used[owners] + rank - freed[owners]
        reused = rank < freed[owners]
        slots[reused] = facet[(np.cumsum(freed) - freed)[owners[reused]] + rank[reused]]
        self._used = self._used + np.maximum(added - freed, 0)
        short = self._used.max(initial=0) - self._facets.shape[1]
        if short > 0:
            extra_room = max(short, self._facets.shape[1] // 2)
            self._facets = np.concatenate([self._facets, np.zeros((count, extra_room), np.uint64)], 1)
            self._normals = np.concatenate([self._normals, np.zeros((count, extra_room, 6))], 1)
            self._offsets = np.concatenate([self._offsets, np.full((count, extra_room), np.inf)], 1)
        return slots

    def _lengths(self, owners: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the lengths ``(f,)`` of normals ``(6, f)`` in the norm of their surface."""
        scaled = (_AXES @ normals) * self._scales[owners].T
        return np.sqrt(np.einsum("jf,jf->f", scaled, scaled))

    def _planes(self, owners: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute unit normals ``(f, 6)`` of facets and the least heights of their corners ``(f,)``."""
        corners = np.ascontiguousarray(self._points[owners[:, None], corners_of(facets)].transpose(1, 2, 0))
        normals = _through(corners)
        with np.errstate(all="ignore"):
            normals /= self._lengths(owners, normals)
            heights = np.einsum("cjf,jf->cf", corners, normals)
            least = heights.min(0)
            is_rough = ~(heights.max(0) - least <= UNEVEN * np.abs(least))
        if is_rough.any():
            rough_corners = corners[..., is_rough].transpose(2, 0, 1)
            across = np.linalg.pinv(rough_corners, NEARLY_FLAT) @ np.ones(6)
            normals[:, is_rough] = across.T / self._lengths(owners[is_rough], across.T)
            least[is_rough] = np.einsum("fcj,jf->fc", rough_corners, normals[:, is_rough]).min(1)
        return normals.T, least


def corners_of(facets: np.ndarray) -> np.ndarray:
    """Unpack facets ``(...)`` into the numbers of their corners ``(..., 6)``, ascending."""
    return ((facets[..., None] >> _CORNERS) & _CORNER_MASK).astype(np.intp)


def _rims(surface: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the surfaces and ridges that an odd number of a surface's facets share, sorted by surface."""
    ridges = np.empty((6, len(facets)), np.uint64)
    for corner in range(6):
        shift = np.uint64(BITS * corner)
        above = (facets >> np.uint64(BITS * (corner + 1))) << shift
        ridges[corner] = above | (facets & ((np.uint64(1) << shift) - np.uint64(1)))
    ridges |= surface.astype(np.uint64) << np.uint64(5 * BITS)
    ordered = np.sort(ridges, axis=None)
    first = np.empty(len(ordered), bool)
    first[:1], first[1:] = True, ordered[1:] != ordered[:-1]
    starts = np.flatnonzero(first)
    odd = np.diff(starts, append=len(ordered)) % 2 == 1
    rim = ordered[starts[odd]]
    return (rim >> np.uint64(5 * BITS)).astype(np.intp), rim & np.uint64((1 << (5 * BITS)) - 1)


def _through(corners: np.ndarray) -> np.ndarray:
    """Solve for vectors ``(6, f)`` whose product with each of six corners ``(6, 6, f)`` is 1, without pivots."""
    rows = np.concatenate([corners, np.ones((6, 1, corners.shape[-1]))], 1)
    solution = np.empty((6, corners.shape[-1]))
    with np.errstate(all="ignore"):
        for step in range(5):
            factors = rows[step + 1 :, step] / rows[step, step]
            rows[step + 1 :, step + 1 :] -= factors[:, None] * rows[step, step + 1 :]
        for step in range(5, -1, -1):
            substituted = np.einsum("jf,jf->f", rows[step, step + 1 : 6], solution[step + 1 :])
            solution[step] = (rows[step, 6] - substituted) / rows[step, step]
    return solution


def _doubled(array: np.ndarray) -> np.ndarray:
    """Double the length of the second axis with zeros."""
    return np.concatenate([array, np.zeros_like(array)], 1)


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
