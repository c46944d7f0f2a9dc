"""The follower: a robot hand on an arm that a person moves from afar, as the rest of the package sees it.

A real robot implements [`jaxgrasp.teleop.Follower`][]; [`jaxgrasp.teleop.MujocoFollower`][] is a simulated one, and
[`jaxgrasp.teleop.NullFollower`][] touches nothing.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

COMMAND_RATE = 500.0
"""Rate of commands [Hz]."""
MAX_SILENCE = 0.1
"""Time without a command after which a follower holds its posture [s]."""


class PalmPose(NamedTuple):
    """Pose of a palm's frame in the robot's world."""

    origin: Float[np.ndarray, "3"]
    """[m]"""
    rotation: Float[np.ndarray, "3 3"]
    """The palm's axes in the world, as columns."""


class FollowerContacts(NamedTuple):
    """Measured contacts of the hand with the object that it handles; C may be 0."""

    points: Float[np.ndarray, "C 3"]
    """Places in the world [m]."""
    normals: Float[np.ndarray, "C 3"]
    """Unit vectors into the object."""
    forces: Float[np.ndarray, "C 3"]
    """Forces of the hand on the object [N]."""
    links: Int[np.ndarray, "C"]
    """Index of the touching link of each contact among ``Follower.links``."""

    @staticmethod
    def none() -> "FollowerContacts":
        """Return contacts of a hand that touches nothing."""
        return FollowerContacts(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int))

    def wrench(self, centre: Float[np.ndarray, "3"]) -> Float[np.ndarray, "6"]:
        """Compute the wrench of the hand on the object about a point [N, N.m]."""
        moments = np.cross(self.points - centre, self.forces)
        return np.concatenate([self.forces.sum(0), moments.sum(0)])


class FollowerState(NamedTuple):
    """Measurements of a follower at one time."""

    at: float
    """Time of the measurement, on the follower's clock [s]."""
    angles: Float[np.ndarray, "J"]
    """Measured angles of the hand's joints [rad]."""
    palm: PalmPose
    """Measured pose of the palm."""
    contacts: FollowerContacts
    object_centre: Float[np.ndarray, "3"]
    """Centre of mass of the handled object, about which wrenches are taken [m]."""
    cause: str
    """Reason of the emergency stop; empty while the robot runs."""


class Follower(ABC):
    """A robot hand on an arm, with position control whose forces are limited."""

    joints: tuple[str, ...]
    """Names of the hand's joints."""
    links: tuple[str, ...]
    """Names of the hand's links that can touch."""

    @abstractmethod
    def command(self, timestamp: float, angles: Float[np.ndarray, "J"], palm: PalmPose) -> None:
        """Set the desired joint angles [rad] and the desired pose of the palm.

        Raises:
            ValueError: for angles or a pose that are not finite numbers of the right shape: the last command holds.
        """

    @abstractmethod
    def read(self, timestamp: float) -> FollowerState:
        """Return the measurements at a time that never runs backwards [s]."""

    @abstractmethod
    def stop(self, cause: str) -> None:
        """Execute the emergency stop: no actuator exerts a force until ``release``."""

    @abstractmethod
    def release(self) -> None:
        """End the emergency stop; the robot holds its posture until the next command."""

    def close(self) -> None:  # noqa: B027
        """Free the robot's resources."""


def check_command(joints: tuple[str, ...], angles: Float[np.ndarray, "J"], palm: PalmPose) -> None:
    """Raise ValueError unless a command is finite numbers, an angle for each joint and a rotation."""
    if np.shape(angles) != (len(joints),):
        raise ValueError(f"angles has shape {np.shape(angles)}: expected ({len(joints)},), one for each joint")
    is_finite = np.isfinite(angles)
    if not is_finite.all():
        k = int(np.argmin(is_finite))
        raise ValueError(f"angles[{k}], of {joints[k]}, is {angles[k]}: expected a finite angle [rad]")
    origin, rotation = np.asarray(palm.origin), np.asarray(palm.rotation)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise ValueError(f"palm.origin is {palm.origin}: expected three finite numbers [m]")
    if rotation.shape != (3, 3) or not np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6:
        raise ValueError("palm.rotation is no rotation matrix: expected orthonormal columns")


class NullFollower(Follower):
    """A robot that reaches every commanded posture at once and touches only what it is told to."""

    def __init__(self, joints: tuple[str, ...], links: tuple[str, ...] = ()) -> None:
        """Create a robot with all angles 0 and the palm at the world's origin."""
        self.joints, self.links = joints, links
        self.contacts = FollowerContacts.none()
        """Contacts that ``read`` reports; set them to play a contact."""
        self._angles, self._palm = np.zeros(len(joints)), PalmPose(np.zeros(3), np.eye(3))
        self._cause = ""

    def command(self, timestamp: float, angles: Float[np.ndarray, "J"], palm: PalmPose) -> None:
        check_command(self.joints, angles, palm)
        if not self._cause:
            self._angles, self._palm = np.array(angles, float), palm

    def read(self, timestamp: float) -> FollowerState:
        contacts = FollowerContacts.none() if self._cause else self.contacts
        return FollowerState(timestamp, self._angles.copy(), self._palm, contacts, self._palm.origin, self._cause)

    def stop(self, cause: str) -> None:
        self._cause = self._cause or cause

    def release(self) -> None:
        self._cause = ""
