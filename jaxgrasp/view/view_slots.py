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
"""Numbers of a [`TrialState`][]."""


class Carried(NamedTuple):
    """Poses and wrenches of hand and objects, as numbers."""

    wrist: Float[np.ndarray, "3 4"]
    followed: Followed

    @staticmethod
    def at(wrist: Pose, followed: Followed) -> "Carried":
        """Build the state of a hand from the wrist's pose and the followed objects."""
        return Carried(pose_matrix(wrist), followed)

    @staticmethod
    def size(n_bodies: int, links: int) -> int:
        """Return the length of the vector."""
        return 14 + 18 * n_bodies + links

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        placed, wrenches, contributions, time, grip = self.followed
        head = [time, np.nan if grip is None else float(grip)]
        return np.concatenate([head, self.wrist.ravel(), pose_matrix(placed).ravel(), wrenches.ravel(), contributions])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], n_bodies: int) -> "Carried":
        """Unpack the state from a vector, with this number of objects."""
        head, wrist, placed, wrenches, contributions = np.split(vector, np.cumsum([2, 12, 12 * n_bodies, 6 * n_bodies]))
        poses = placed.reshape(n_bodies, 3, 4)
        grip = None if np.isnan(head[1]) else GripType(int(head[1]))
        poses_of_bodies = Pose(poses[..., 3], poses[..., :3])
        followed = Followed(poses_of_bodies, wrenches.reshape(n_bodies, 6), contributions, float(head[0]), grip)
        return Carried(wrist.reshape(3, 4), followed)


class TrialState(NamedTuple):
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
    def of(vector: Float[np.ndarray, "9"]) -> "TrialState":
        """Unpack the state of the trial from a vector."""
        return TrialState(*vector.tolist())


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
    extra: Float[np.ndarray, "more"]
    """Vector of a [`Carried`][] or a [`TrialState`][]."""

    @staticmethod
    def size(channels: int, extra: int) -> int:
        """Return the length of the vector."""
        return 3 + 3 * channels + extra

    @staticmethod
    def ticked(state: GloveState, law: TorqueLaw, extra: Float[np.ndarray, "more"]) -> "ViewFrame":
        """Build the frame from the glove's state and the torques of a tick."""
        return ViewFrame(state.angles_at, state.link, state.guard, law.angles, law.torques, state.measured, extra)

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        head = [self.angles_at, float(self.link), float(self.guard)]
        return np.concatenate([head, self.angles, self.torques, self.measured, self.extra])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "ViewFrame":
        """Unpack the frame from a vector, with this number of channels."""
        (at, link, guard), *parts = np.split(vector, 3 + channels * np.arange(4))
        return ViewFrame(float(at), int(link), int(guard), *parts)
