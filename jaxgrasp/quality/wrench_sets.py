"""The wrenches in reach of bounded normal forces, as convex bodies that answer how far they go in a direction.

NumPy, in float64: what certifies is host arithmetic whose rounding is counted.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

Bound = Literal["l1", "linf"]
BOUNDS = get_args(Bound)

LEAST_SIDES = 3


class Reach(NamedTuple):
    """How far a body goes along some directions, and by which forces."""

    height: np.ndarray
    """``(f,)``: the support function."""
    points: np.ndarray
    """``(f, 6)``: wrenches that attain it."""
    press: np.ndarray
    """``(f, n)``: their normal forces."""
    lean: np.ndarray
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
    """Whether the sum of all normal forces is at most 1, or each of them."""
    corners: np.ndarray | None = None
    """``(k, 3)``: the u that a pyramid has edges at; ``None`` for cones."""

    @property
    def size(self) -> float:
        """The length of no disc's wrench is larger."""
        across = np.sqrt(np.einsum("njk,njk->n", self.spans, self.spans))
        return float(np.max(np.linalg.norm(self.centres, axis=1) + across, initial=0))

    @property
    def slack(self) -> float:
        """By how much rounding may change what the body reaches along a unit direction."""
        return self.rounding * self.size * (len(self.centres) if self.bound == "linf" else 1)

    def supports(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Each contact's largest power of unit normal force ``(f, n)``, and the u that attains it ``(f, n, 3)``."""
        across = np.einsum("fj,njk->fnk", directions, self.spans)
        if self.corners is None:
            sizes = np.linalg.norm(across, axis=-1)
            lean = across / np.where(sizes > 0, sizes, 1)[..., None]
        else:
            heights = across @ self.corners.T
            lean = self.corners[np.argmax(heights, -1)]
            sizes = np.max(heights, -1)
        return directions @ self.centres.T + sizes, lean

    def reach(self, directions: np.ndarray) -> Reach:
        """Along directions ``(f, 6)``."""
        values, lean = self.supports(directions)
        press = (values > 0).astype(float)
        if self.bound == "l1":
            press *= np.arange(values.shape[1]) == np.argmax(values, 1)[:, None]
        lean = lean * press[..., None]
        points = press @ self.centres + np.einsum("njk,fnk->fj", self.spans, lean)
        return Reach(np.sum(press * values, 1), points, press, lean)


def pyramid(sides: int, soft: bool) -> np.ndarray:
    """The u of the edges of pyramids inside the cones: ``sides`` for friction, two more for soft fingers' moments."""
    angles = 2 * np.pi * np.arange(sides) / sides
    corners = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], -1)
    return np.concatenate([corners, [[0, 0, 1], [0, 0, -1]]]) if soft else corners


def check_bound(bound: str) -> None:
    if bound not in BOUNDS:
        raise ValueError(f"bound is {bound!r}: expected 'l1' or 'linf'")


def check_sides(sides: int | None) -> None:
    if sides is not None and (not isinstance(sides, int) or sides < LEAST_SIDES):
        raise ValueError(f"sides is {sides!r}: expected a whole number, {LEAST_SIDES} or more, or None for cones")
