"""Coordinates in which bodies of wrenches are about as long in all directions, for the search of their largest balls.

Contacts with little friction, almost on a line, or far from where torques are taken exert wrenches of which those in
weak directions are shorter by many powers of ten. Planes through points of such a flat body lose as many digits. A
linear map shortens the long axes of the discs' matrix to the shortest: facets and Newton's equations then have numbers
of equal size, and only lengths are measured in the original coordinates.
"""

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
