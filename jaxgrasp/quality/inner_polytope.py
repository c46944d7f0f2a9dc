"""A closed surface of simplices around the origin, with corners in a convex body: a ball it holds is in the body too.

Such a surface grows by points of the body, as a convex hull does. What makes its ball a proof is not that it is
convex, which rounding may spoil, but that every ray from the origin meets one of its simplices: all of them are in the
body, and none comes nearer to the origin than the least distance of its corners along any unit vector. Rays keep
meeting it whatever facets a point replaces, if it lies beyond their planes and the origin does not: the
simplices between the point and those facets, whose surface is added, then do not hold the origin.
"""

import itertools

import numpy as np

NEARLY_FLAT = 1e-9
"""Relative singular value of a facet's corners under which they span no plane but a smaller flat."""


class InnerPolytope:
    """A surface of five-dimensional simplices in six dimensions."""

    def __init__(self, radius: float):
        """The cross-polytope whose corners are ``radius`` away from the origin."""
        self.points = np.concatenate([np.eye(6), -np.eye(6)]) * radius
        signs = itertools.product((0, 6), repeat=6)
        self.facets = np.array([[axis + sign for axis, sign in enumerate(chosen)] for chosen in signs])
        """``(F, 6)``: corners."""
        self.normals, self.offsets = self._planes(self.facets)
        """``(F, 6)``, unit, and ``(F,)``: no corner of a facet is nearer along its normal."""

    def lowest(self, count: int) -> np.ndarray:
        """Some facets of least offsets, the least of all among them."""
        if count >= len(self.offsets):
            return np.arange(len(self.offsets))
        return np.argpartition(self.offsets, count)[:count]

    def grow(self, point: np.ndarray, least: float) -> bool:
        """Take a point in, if it lies beyond some facet by ``least`` > 0 or more."""
        beyond = self.normals @ point - self.offsets
        if beyond.max() < least:
            return False
        # The origin is on the other side of these only.
        hidden = (beyond > 0) & (self.offsets > 0)
        self.points = np.vstack([self.points, point])
        rim = _rim(self.facets[hidden])
        new = np.concatenate([rim, np.full((len(rim), 1), len(self.points) - 1)], 1)
        normals, offsets = self._planes(new)
        kept = ~hidden
        self.facets = np.concatenate([self.facets[kept], new])
        self.normals = np.concatenate([self.normals[kept], normals])
        self.offsets = np.concatenate([self.offsets[kept], offsets])
        return True

    def _planes(self, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        corners = self.points[facets]
        with np.errstate(all="ignore"):
            try:
                across = np.linalg.solve(corners, np.ones((len(facets), 6, 1)))[..., 0]
            except np.linalg.LinAlgError:
                across = np.full((len(facets), 6), np.nan)
            normals = across / np.linalg.norm(across, axis=1, keepdims=True)
            along = np.einsum("fcj,fj->fc", corners, normals)
            sound = np.ptp(along, 1) <= NEARLY_FLAT * np.abs(along).max(1)
        if not sound.all():
            across = np.linalg.pinv(corners[~sound], NEARLY_FLAT) @ np.ones(6)
            normals[~sound] = across / np.linalg.norm(across, axis=1, keepdims=True)
            along = np.einsum("fcj,fj->fc", corners, normals)
        return normals, along.min(1)


def _rim(facets: np.ndarray) -> np.ndarray:
    """The ridges ``(r, 5)`` that only one of the facets has; more exactly, that an odd number of them have."""
    ridges = np.sort(np.concatenate([np.delete(facets, corner, 1) for corner in range(6)]), 1)
    ridges = ridges[np.lexsort(ridges.T)]
    first = np.concatenate([[True], (ridges[1:] != ridges[:-1]).any(1)])
    times = np.diff(np.append(np.flatnonzero(first), len(ridges)))
    return ridges[first][times % 2 == 1]
