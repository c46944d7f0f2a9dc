"""The wrenches in reach of bounded normal forces, as convex bodies that answer how far they go in a direction.

NumPy, in float64: what certifies is host arithmetic whose rounding is counted.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

Bound = Literal["l1", "linf"]
BOUNDS = get_args(Bound)

LEAST_SIDES = 3


class Support(NamedTuple):
    """Support function of a body along some directions, with the forces that attain it."""

    height: np.ndarray
    """``(f,)``: the support function."""
    points: np.ndarray
    """``(f, 6)``: wrenches that attain it."""
    normal_force: np.ndarray
    """``(f, n)``: their normal forces."""
    tangential: np.ndarray
    """``(f, n, 3)``: u times normal force."""


@dataclass(frozen=True)
class WrenchSet:
    """The wrenches of forces inside friction cones, or inside pyramids, whose normal forces are bounded."""

    centres: np.ndarray
    """``(n, 6)``, of present contacts alone."""
    spans: np.ndarray
    """``(n, 6, 3)``."""
    rounding: float
    """Relative rounding of the numbers above, that of the grasp's own data among it."""
    bound: Bound = "l1"
    """``"l1"`` if the sum of all normal forces is at most 1, ``"linf"`` if each of them is."""
    corners: np.ndarray | None = None
    """``(k, 3)``: the u that a pyramid has edges at; ``None`` for cones."""

    @property
    def size(self) -> float:
        """Upper bound of the length of all discs' wrenches."""
        across = np.sqrt(np.einsum("njk,njk->n", self.spans, self.spans))
        return float(np.max(np.linalg.norm(self.centres, axis=1) + across, initial=0))

    @property
    def slack(self) -> float:
        """Largest change by rounding of the body's support along a unit direction."""
        return self.rounding * self.size * (len(self.centres) if self.bound == "linf" else 1)

    def supports(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute each contact's largest power of unit normal force ``(f, n)``, and its u ``(f, n, 3)``."""
        sizes, tangential = _furthest(np.einsum("fj,njk->fnk", directions, self.spans), self.corners)
        return directions @ self.centres.T + sizes, tangential

    def reach(self, directions: np.ndarray) -> Support:
        """Compute the support function along directions ``(f, 6)``."""
        values, tangential = self.supports(directions)
        normal_force = _pressing(values, self.bound)
        tangential = tangential * normal_force[..., None]
        points = normal_force @ self.centres + np.einsum("njk,fnk->fj", self.spans, tangential)
        return Support(np.sum(normal_force * values, 1), points, normal_force, tangential)


@dataclass(frozen=True)
class WrenchSets:
    """Wrench sets of many grasps side by side, ``G`` of them."""

    discs: np.ndarray
    """``(G, n, 4, 6)``: the centre and the three columns of the span of each contact; zeros for absent ones."""
    present: np.ndarray
    """``(G, n)`` of truth."""
    rounding: np.ndarray
    """``(G,)``."""
    bound: Bound = "l1"
    corners: np.ndarray | None = None

    @property
    def size(self) -> np.ndarray:
        """Upper bound ``(G,)`` of the length of all discs' wrenches."""
        squares = np.einsum("gnkj,gnkj->gnk", self.discs, self.discs)
        across = np.sqrt(squares[..., 1:].sum(-1))
        return np.max(np.sqrt(squares[..., 0]) + across, 1, initial=0)

    @property
    def slack(self) -> np.ndarray:
        """Largest change by rounding of each body's support along a unit direction ``(G,)``."""
        return self.rounding * self.size * (self.present.sum(1) if self.bound == "linf" else 1)

    @staticmethod
    def of_discs(centres: np.ndarray, spans: np.ndarray, present: np.ndarray, rounding: np.ndarray) -> "WrenchSets":
        """Build one flat batch from discs ``(..., n, 6)`` and ``(..., n, 6, 3)``, ``present`` (..., n)."""
        rows = np.concatenate([centres[..., None, :], np.swapaxes(spans, -1, -2)], -2)
        flat = rounding.size, present.shape[-1]
        rows = np.where(present[..., None, None], rows, 0).reshape(*flat, 4, 6).astype(np.float64, copy=False)
        return WrenchSets(rows, present.reshape(flat), rounding.reshape(-1))

    def take(self, selection: np.ndarray) -> "WrenchSets":
        """Return the wrench sets of the grasps selected by index or mask."""
        return replace(
            self, discs=self.discs[selection], present=self.present[selection], rounding=self.rounding[selection]
        )

    def alone(self, index: int) -> WrenchSet:
        """Return the wrench set of one grasp, of its present contacts only."""
        discs = self.discs[index][self.present[index]]
        spans = np.ascontiguousarray(np.swapaxes(discs[:, 1:], 1, 2))
        return WrenchSet(discs[:, 0], spans, float(self.rounding[index]), self.bound, self.corners)

    def alone_edges(self) -> "WrenchSets":
        """Return the bodies of forces of a bounded sum, with each pyramid's edges as frictionless contacts."""
        if self.corners is None:
            return replace(self, bound="l1")
        edges = self.discs[:, :, :1] + np.einsum("gnkj,ck->gncj", self.discs[:, :, 1:], self.corners)
        count = self.present.shape[1] * len(self.corners)
        edges = np.where(self.present[..., None, None], edges, 0).reshape(len(edges), count, 1, 6)
        discs = np.concatenate([edges, np.zeros((*edges.shape[:2], 3, 6))], 2)
        return replace(
            self, discs=discs, present=np.repeat(self.present, len(self.corners), 1), bound="l1", corners=None
        )

    def supports(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute each contact's largest power of unit normal force ``(G, n)`` along a direction per grasp ``(G, 6)``.

        Also returns the u ``(G, n, 3)`` that attains it.
        """
        grasps, count = self.present.shape
        rates = np.matmul(self.discs.reshape(grasps, 4 * count, 6), directions[..., None]).reshape(grasps, count, 4)
        sizes, tangential = _furthest(rates[..., 1:], self.corners)
        return rates[..., 0] + sizes, tangential

    def reach(self, directions: np.ndarray) -> Support:
        """Compute supports along a direction per grasp ``(G, 6)``, as ``WrenchSet.reach`` does, a row per grasp."""
        values, tangential = self.supports(directions)
        normal_force = _pressing(values, self.bound)
        forces = np.concatenate([normal_force[..., None], tangential * normal_force[..., None]], -1)
        return Support(np.sum(normal_force * values, 1), self.exerted(forces), normal_force, forces[..., 1:])

    def exerted(self, forces: np.ndarray) -> np.ndarray:
        """Compute the wrenches ``(G, 6)`` of forces (normal, tangential) ``(G, n, 4)``."""
        grasps, count = self.present.shape
        flat = self.discs.reshape(grasps, 4 * count, 6)
        return np.matmul(forces.reshape(grasps, 1, 4 * count), flat)[:, 0]


def _furthest(across: np.ndarray, corners: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Maximise u.across over all u that friction allows; return the maxima ``(..., n)`` and their u ``(..., n, 3)``."""
    if corners is None:
        sizes = np.sqrt(np.einsum("...nk,...nk->...n", across, across))
        return sizes, across / np.where(sizes > 0, sizes, 1)[..., None]
    heights = across @ corners.T
    return np.max(heights, -1), corners[np.argmax(heights, -1)]


def _pressing(values: np.ndarray, bound: Bound) -> np.ndarray:
    """Return the normal forces ``(f, n)`` that do the most work, from each contact's power of a unit one."""
    normal_force = (values > 0).astype(float)
    if bound == "l1":
        normal_force *= np.arange(values.shape[1]) == np.argmax(values, 1)[:, None]
    return normal_force


def pyramid(sides: int, soft: bool) -> np.ndarray:
    """Return the u of edges of pyramids inside the cones: ``sides`` for friction, two for soft fingers' moments."""
    angles = 2 * np.pi * np.arange(sides) / sides
    corners = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], -1)
    return np.concatenate([corners, [[0, 0, 1], [0, 0, -1]]]) if soft else corners


def check_bound(bound: str) -> None:
    if bound not in BOUNDS:
        raise ValueError(f"bound is {bound!r}: expected 'l1' or 'linf'")


def check_sides(sides: int | None) -> None:
    if sides is not None and (not isinstance(sides, int) or sides < LEAST_SIDES):
        raise ValueError(f"sides is {sides!r}: expected a whole number, {LEAST_SIDES} or more, or None for cones")
