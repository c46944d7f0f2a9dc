"""What a haptic loop lets a page know, through a slot in shared memory: the latest alone, and nothing waits for it."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import pose_matrix

CARRIED, TRIAL = 30, 9
"""Numbers of a [`Carried`][] and of a [`TrialNow`][]."""


class Carried(NamedTuple):
    """Where hand and object are, as numbers."""

    wrist: Float[np.ndarray, "3 4"]
    placed: Float[np.ndarray, "3 4"]
    inertial: Float[np.ndarray, "6"]
    """Wrench that accelerates the object [N, N.m]."""

    @staticmethod
    def at(wrist: Pose, placed: Pose, inertial: Any) -> "Carried":
        """The state of a hand and an object there."""
        return Carried(pose_matrix(wrist), pose_matrix(placed), np.asarray(inertial))

    def vector(self) -> Float[np.ndarray, "30"]:
        """All of it in one."""
        return np.concatenate([self.wrist.ravel(), self.placed.ravel(), self.inertial])

    @staticmethod
    def of(vector: Float[np.ndarray, "30"]) -> "Carried":
        """What a vector says."""
        return Carried(vector[:12].reshape(3, 4), vector[12:24].reshape(3, 4), vector[24:])


class TrialNow(NamedTuple):
    """Where an experiment is, as numbers: NaN of what there is not."""

    phase: float = 0.0
    """A [`Phase`][jaxgrasp.view.trial_words.Phase]."""
    number: float = math.nan
    most: float = math.nan
    interval: float = math.nan
    first: float = math.nan
    second: float = math.nan
    setting: float = math.nan
    answered: float = 0.0
    """Choices so far, since the program began."""
    right: float = 0.0
    """How many of these were right."""

    def vector(self) -> Float[np.ndarray, "9"]:
        """All of it in one."""
        return np.array(self, float)

    @staticmethod
    def of(vector: Float[np.ndarray, "9"]) -> "TrialNow":
        """What a vector says."""
        return TrialNow(*vector.tolist())


@dataclass(frozen=True, eq=False)
class ViewFrame:
    """One tick of a haptic loop."""

    angles_at: float
    """When the angles were read [s]."""
    link: int
    guard: int
    angles: Float[np.ndarray, "channels"]
    """[rad]"""
    torques: Float[np.ndarray, "channels"]
    """Computed, against flexion [N.m]."""
    measured: Float[np.ndarray, "channels"]
    """By the cables' tension [N.m]."""
    more: Float[np.ndarray, "more"]
    """What [`Carried`][] or [`TrialNow`][] has."""

    @staticmethod
    def size(channels: int, more: int) -> int:
        """Numbers of its vector."""
        return 3 + 3 * channels + more

    @staticmethod
    def ticked(state: GloveState, law: TorqueLaw, more: Float[np.ndarray, "more"]) -> "ViewFrame":
        """What a tick read and computed."""
        return ViewFrame(state.angles_at, state.link, state.guard, law.angles, law.torques, state.measured, more)

    def vector(self) -> Float[np.ndarray, "size"]:
        """All of it in one."""
        head = [self.angles_at, float(self.link), float(self.guard)]
        return np.concatenate([head, self.angles, self.torques, self.measured, self.more])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "ViewFrame":
        """The frame that a vector is of."""
        (at, link, guard), *parts = np.split(vector, 3 + channels * np.arange(4))
        return ViewFrame(float(at), int(link), int(guard), *parts)
