"""Many equal bodies, each with a place, a turn, sizes and a colour of its own: contacts, friction cones, arrows."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

HEAD, SHAFT, HEAD_RADIUS = 0.007, 0.0009, 0.0024
"""Length of an arrow's head, and radii of its shaft and of its head [m]; a short arrow is thinner all over."""
NOTHING = 1e-7
"""Size of an absent instance [m]: the number of instances is constant, so that no handle is created anew."""


class Instances(NamedTuple):
    """``N`` copies of a body that has unit size in each direction and stands along z."""

    positions: np.ndarray
    """``(N, 3)`` [m]"""
    quaternions: np.ndarray
    """``(N, 4)``, w first."""
    scales: np.ndarray
    """``(N, 3)`` [m]"""
    colours: np.ndarray
    """``(N, 3)``, bytes."""

    @property
    def is_visible(self) -> np.ndarray:
        """Mask ``(N,)`` of the copies that are not absent."""
        return self.scales.max(-1) > 2 * NOTHING

    def visible_positions(self) -> np.ndarray:
        """Return the positions of the visible copies ``(V, 3)`` [m]."""
        return self.positions[self.is_visible]

    def visible_ends(self) -> np.ndarray:
        """Return the ends of the visible copies along their own z ``(V, 3)`` [m]."""
        turns = Rotation.from_quat(self.quaternions[self.is_visible], scalar_first=True)
        along = turns.apply([0.0, 0.0, 1.0]).reshape(-1, 3)
        return self.visible_positions() + self.scales[self.is_visible, 2:] * along


class Arrows(NamedTuple):
    """Arrows by their shafts and their heads."""

    shafts: Instances
    heads: Instances


def rgb(colour: str) -> tuple[int, int, int]:
    """Convert a colour ``#rrggbb`` to three bytes."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def turned_to(axes: np.ndarray) -> np.ndarray:
    """Return quaternions ``(N, 4)`` of the shortest turns from z to unit vectors ``(N, 3)``; about x for -z."""
    x, y, z = axes.T
    quaternions = np.stack([1 + z, -y, x, np.zeros_like(z)], 1)
    # Half a turn has no shortest axis.
    quaternions[z < -1 + 1e-12] = [0.0, 1.0, 0.0, 0.0]
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def dots(points: np.ndarray, mask: np.ndarray, radius: float, colours: np.ndarray) -> Instances:
    """Return balls of a radius [m] at the points whose mask is true."""
    sizes = np.where(mask, radius, NOTHING)
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1))
    return Instances(points, identity, np.repeat(sizes[:, None], 3, 1), colours)


def cones(
    apexes: np.ndarray, axes: np.ndarray, friction: np.ndarray, mask: np.ndarray, side: float, colours: np.ndarray
) -> Instances:
    """Return friction cones of equal side [m], so that large friction opens a cone and does not enlarge it."""
    angles = np.arctan(np.where(mask, friction, 0.0))
    sizes = side * np.stack([np.sin(angles), np.sin(angles), np.cos(angles)], 1)
    return Instances(apexes, turned_to(axes), np.where(mask[:, None], np.maximum(sizes, NOTHING), NOTHING), colours)


def arrows(tails: np.ndarray, vectors: np.ndarray, colour: str, size: float = 1.0) -> Arrows:
    """Return arrows ``(N, 3)`` [m] from their tails; heads at most half an arrow long, zero length is invisible.

    ``size`` is the thickness relative to arrows beside a human hand.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    is_visible = lengths > NOTHING
    directions = np.where(is_visible[:, None], vectors / np.where(is_visible, lengths, 1)[:, None], [0.0, 0.0, 1.0])
    sizes = np.where(is_visible, np.minimum(HEAD * size, lengths / 2), NOTHING)
    thin = np.maximum(sizes / HEAD, NOTHING)
    turns, colours = turned_to(directions), np.tile(rgb(colour), (len(tails), 1)).astype(np.uint8)
    shafts = np.stack([SHAFT * thin, SHAFT * thin, np.maximum(lengths - sizes, NOTHING)], 1)
    heads = np.stack([HEAD_RADIUS * thin, HEAD_RADIUS * thin, sizes], 1)
    starts = tails + (lengths - sizes)[:, None] * directions
    return Arrows(Instances(tails, turns, shafts, colours), Instances(starts, turns, heads, colours))
