"""A probe: a tool held between thumb and fingers, whose tip meets surfaces with stiffness, friction and texture.

The force at the tip is that of a spring along the surface's normal, with Coulomb friction against the tip's motion. The
hand feels it through its contacts with the tool, by eq. 16, as torques of the finger joints.
"""

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates

from jaxgrasp.teleop.feedback import ForceFeedback, LinkLoads
from jaxgrasp.validation.checked import checked

SLOW = 1e-3
"""Speed over which friction rises from zero to its whole force [m/s]: no force jumps where the tip turns back."""


def _flat() -> np.ndarray:
    return np.zeros((2, 2))


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface over the xy plane: heights on a grid, with stiffness and friction.

    Raises:
        ValueError: for numbers that are out of their ranges, and heights that are no grid of finite numbers.
    """

    stiffness: float
    """[N/m]"""
    friction: float = 0.0
    """Coulomb coefficient."""
    heights: Float[np.ndarray, "rows columns"] = field(default_factory=_flat)
    """Heights at the points of a grid, rows along y and columns along x [m]; beyond it they repeat."""
    spacing: float = 1e-3
    """Distance of two points of the grid [m]."""

    def __post_init__(self) -> None:
        for name, least in (("stiffness", True), ("spacing", True), ("friction", False)):
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 if least else value >= 0)):
                raise ValueError(f"{name} is {value}: expected a {'positive number' if least else 'number, 0 or more'}")
        heights = np.asarray(self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise ValueError(f"heights has shape {heights.shape}: expected a grid of 2 by 2 points or more")
        if not np.isfinite(heights).all():
            row, column = np.argwhere(~np.isfinite(heights))[0]
            raise ValueError(f"heights[{row}, {column}] is {heights[row, column]}: expected a finite height [m]")

    def height(self, x: float, y: float) -> tuple[float, Float[np.ndarray, "2"]]:
        """Compute the height at a point, and its slope along x and y, by cubic interpolation."""
        at = np.array([[y, y, y, y + SLOPE_STEP, y - SLOPE_STEP], [x, x + SLOPE_STEP, x - SLOPE_STEP, x, x]])
        values = map_coordinates(np.asarray(self.heights, float), at / self.spacing, order=3, mode="grid-wrap")
        slope = np.array([values[1] - values[2], values[3] - values[4]]) / (2 * SLOPE_STEP)
        return float(values[0]), slope

    def force(
        self, tip: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], radius: float = 0.0
    ) -> Float[np.ndarray, "3"]:
        """Compute the force of the surface on a tip [N]; zero where the tip does not touch.

        Args:
            tip: centre of the tip [m].
            velocity: of the tip [m/s].
            radius: of the tip [m].
        """
        height, slope = self.height(float(tip[0]), float(tip[1]))
        normal = np.array([-slope[0], -slope[1], 1.0])
        normal /= np.linalg.norm(normal)
        # Depth along the normal, by the plane that touches the surface below the tip.
        depth = (height - tip[2]) * normal[2] + radius
        if depth <= 0:
            return np.zeros(3)
        pressing = self.stiffness * depth
        sliding = velocity - (velocity @ normal) * normal
        speed = np.linalg.norm(sliding)
        return pressing * normal - self.friction * pressing * sliding / max(speed, SLOW)


SLOPE_STEP = 1e-4
"""Step of the differences that give a slope [m]."""


@checked
def load_heights(path: str | os.PathLike) -> Float[np.ndarray, "rows columns"]:
    """Load a grid of heights [m] from a CSV file of numbers, a row of the grid in each line.

    Raises:
        ValueError: for a line that has another count of numbers than the first, or an entry that is no finite number.
        OSError: for a file that cannot be read.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(Path(path).read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip():
            continue
        row = []
        for column, entry in enumerate(line.split(","), 1):
            try:
                value = float(entry)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise ValueError(f"{path}, line {number}, entry {column} is {entry.strip()!r}: expected a height [m]")
            row.append(value)
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{path}, line {number} has {len(row)} numbers: expected {len(rows[0])}, as the first has")
        rows.append(row)
    if len(rows) < 2 or len(rows[0]) < 2:
        raise ValueError(f"{path} has {len(rows)} lines of numbers: expected a grid of 2 by 2 heights or more")
    return np.array(rows)


class HeldProbe:
    """A tool in a pinch grip of thumb and fingers; its tip's force becomes torques of the finger joints."""

    def __init__(
        self,
        feedback: ForceFeedback,
        angles: Float[np.ndarray, "P"],
        tip: Float[np.ndarray, "3"],
        *,
        fingers: tuple[str, ...] = ("thumb", "index", "middle"),
        squeeze: float = 2.0,
    ) -> None:
        """Hold a tool at its middle between fingertips.

        Args:
            feedback: of the person's hand and glove.
            angles: of the person's joints while holding the tool [rad].
            tip: place of the tool's tip in the wrist's frame [m].
            fingers: that hold it, the thumb first; it presses as hard as all others together.
            squeeze: normal force of each finger but the thumb [N].

        Raises:
            ValueError: for a finger that the hand lacks, or a squeeze that is not positive.
        """
        if not (math.isfinite(squeeze) and squeeze > 0):
            raise ValueError(f"squeeze is {squeeze}: expected a positive force [N]")
        names = [link.name for link in feedback.person.links]
        for finger in fingers:
            if f"{finger} distal" not in names:
                raise ValueError(f"fingers has {finger!r}: expected fingers of the hand, such as 'thumb' and 'index'")
        self._feedback, self._angles, self._tip = feedback, np.asarray(angles, float), np.asarray(tip, float)
        links = [names.index(f"{finger} distal") for finger in fingers]
        count = len(names)
        self._squeeze, self._normals = np.zeros(count), np.tile([1.0, 0, 0], (count, 1))
        self._squeeze[links] = squeeze
        self._squeeze[links[0]] = squeeze * (len(links) - 1)
        points = feedback.contact_points(self._normals, self._angles)
        across = points[links[1:]].mean(0) - points[links[0]]
        across /= np.linalg.norm(across)
        self._normals[links[0]], self._normals[links[1:]] = across, -across
        points = feedback.contact_points(self._normals, self._angles)
        self._middle = self._squeeze @ points / self._squeeze.sum()

    def torques(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "channels"]:
        """Compute the torques against flexion for a force on the tip, in the wrist's axes, before limits [N.m]."""
        # The hand must exert the opposite of what the surface does, about the middle of the grip.
        moment = np.cross(self._tip - self._middle, force)
        wrench = -np.concatenate([force, moment])
        loads = LinkLoads(self._normals, self._squeeze, np.zeros(3), wrench)
        return self._feedback.torques_of(loads, self._angles)

    def felt_force(
        self,
        torques: Float[np.ndarray, "channels"],
        direction: Float[np.ndarray, "3"],
        is_rendered: Bool[np.ndarray, "channels"] | None = None,
    ) -> float:
        """Compute the force along a direction that torques on the glove stand for, by least squares [N].

        Args:
            torques: rendered torques against flexion [N.m].
            direction: unit vector of the force on the tip, in the wrist's axes.
            is_rendered: channels that count, as booleans, such as those that no limit cuts; all where not given.
        """
        grip_torques = self.torques(np.zeros(3))
        change = self.torques(np.asarray(direction, float)) - grip_torques
        mask = np.ones(len(grip_torques), bool) if is_rendered is None else np.asarray(is_rendered, bool)
        unit_change, force_change = change[mask], (torques - grip_torques)[mask]
        return float(unit_change @ force_change / (unit_change @ unit_change))
