"""Data from a haptic loop to a page through a slot in shared memory: only the latest frame, without waiting."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.hand.grip_type import GripType
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import pose_matrix

TRIAL = 9
"""Numbers of a [`TrialNow`][]."""


class Carried(NamedTuple):
    """Poses and wrenches of hand and objects, as numbers."""

    wrist: Float[np.ndarray, "3 4"]
    followed: Followed

    @staticmethod
    def at(wrist: Pose, followed: Followed) -> "Carried":
        """Build the state of a hand from the wrist's pose and the followed objects."""
        return Carried(pose_matrix(wrist), followed)

    @staticmethod
    def size(things: int, links: int) -> int:
        """Return the length of the vector."""
        return 14 + 18 * things + links

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        placed, wrenches, contributions, time, grip = self.followed
        head = [time, np.nan if grip is None else float(grip)]
        return np.concatenate([head, self.wrist.ravel(), pose_matrix(placed).ravel(), wrenches.ravel(), contributions])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], things: int) -> "Carried":
        """Unpack the state from a vector, with this number of objects."""
        head, wrist, placed, wrenches, contributions = np.split(vector, np.cumsum([2, 12, 12 * things, 6 * things]))
        poses = placed.reshape(things, 3, 4)
        grip = None if np.isnan(head[1]) else GripType(int(head[1]))
        there = Pose(poses[..., 3], poses[..., :3])
        followed = Followed(there, wrenches.reshape(things, 6), contributions, float(head[0]), grip)
        return Carried(wrist.reshape(3, 4), followed)


class TrialNow(NamedTuple):
    """Current state of an experiment, as numbers: NaN for a missing value."""

    phase: float = 0.0
    """A [`Phase`][jaxgrasp.view.trial_words.Phase]."""
    number: float = math.nan
    most: float = math.nan
    interval: float = math.nan
    first: float = math.nan
    second: float = math.nan
    setting: float = math.nan
    answered: float = 0.0
    """Number of choices since the program began."""
    right: float = 0.0
    """Number of right choices."""

    def vector(self) -> Float[np.ndarray, "9"]:
        """Pack all fields into a vector."""
        return np.array(self, float)

    @staticmethod
    def of(vector: Float[np.ndarray, "9"]) -> "TrialNow":
        """Unpack the state of the trial from a vector."""
        return TrialNow(*vector.tolist())


@dataclass(frozen=True, eq=False)
class ViewFrame:
    """State of the glove and torques in a tick of a haptic loop."""

    angles_at: float
    """Time at which the angles were read [s]."""
    link: int
    guard: int
    angles: Float[np.ndarray, "channels"]
    """Joint angles [rad]."""
    torques: Float[np.ndarray, "channels"]
    """Computed torques against flexion [N.m]."""
    measured: Float[np.ndarray, "channels"]
    """Torques measured by the cables' tension [N.m]."""
    more: Float[np.ndarray, "more"]
    """Vector of a [`Carried`][] or a [`TrialNow`][]."""

    @staticmethod
    def size(channels: int, more: int) -> int:
        """Return the length of the vector."""
        return 3 + 3 * channels + more

    @staticmethod
    def ticked(state: GloveState, law: TorqueLaw, more: Float[np.ndarray, "more"]) -> "ViewFrame":
        """Build the frame from the glove's state and the torques of a tick."""
        return ViewFrame(state.angles_at, state.link, state.guard, law.angles, law.torques, state.measured, more)

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        head = [self.angles_at, float(self.link), float(self.guard)]
        return np.concatenate([head, self.angles, self.torques, self.measured, self.more])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "ViewFrame":
        """Unpack the frame from a vector, with this number of channels."""
        (at, link, guard), *parts = np.split(vector, 3 + channels * np.arange(4))
        return ViewFrame(float(at), int(link), int(guard), *parts)
