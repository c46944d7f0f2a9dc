"""Both sides of a teleoperation: what each does with a message of the other, at every step.

The person's side sends joint angles and the pose of the wrist, and gets torques, and a force on the wrist where it has
a device for it. The robot's side retargets the hand, commands the robot, measures its contacts and sends torques and
force (position-force architecture). Both ends of the network are ports of [`jaxgrasp.glove.passivity`][]; each message
carries the energy that was passed on.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.passivity import LARGEST_ACCELERATION, PERIOD, MotionPort, TorquePort
from jaxgrasp.glove.protocol.device import N_FINGERS
from jaxgrasp.glove.substitution import (
    Sensations,
    Substitution,
    finger_contacts,
    finger_indices,
    finger_saturation,
)
from jaxgrasp.model.hand import Hand
from jaxgrasp.teleop.feedback import ForceFeedback
from jaxgrasp.teleop.follower import Follower, FollowerContacts, FollowerState, PalmPose
from jaxgrasp.teleop.retarget import Retargeting
from jaxgrasp.teleop.wrist import WristDevice

LARGEST_WRIST_ACCELERATION = 12.0
"""Acceleration of the wrist that the prediction of the next step allows for [m/s2]."""
MAX_SILENCE = 0.025
"""Time without a newer message of the robot after which no torque flows [s]."""
SILENCE = Sensations.none()
"""Neither vibration nor heat."""
NO_FORCE = np.zeros(3)


class PersonMessage(NamedTuple):
    """Message from the person's side."""

    angles: Float[np.ndarray, "P"]
    """Angles of all joints of the person's hand [rad]."""
    wrist: PalmPose
    """Pose of the person's wrist in the robot's world."""
    sent: float
    """Energy passed on so far by the person's port [J]."""

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack the message into one vector."""
        return np.concatenate([self.angles, self.wrist.origin, self.wrist.rotation.ravel(), [self.sent]])

    @staticmethod
    def size(joints: int) -> int:
        """Return the number of elements of the vector."""
        return joints + 13

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], joints: int) -> "PersonMessage | None":
        """Unpack a message; return None for a vector that is not finite or holds no rotation."""
        if vector.shape != (joints + 13,) or not np.isfinite(vector).all():
            return None
        angles, origin, rotation, sent = np.split(vector, [joints, joints + 3, joints + 12])
        rotation = rotation.reshape(3, 3)
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
            return None
        # A network of single precision leaves rotations that are only nearly orthonormal.
        u, _, v = np.linalg.svd(rotation)
        return PersonMessage(angles, PalmPose(origin, u @ v), float(sent[0]))


class RobotMessage(NamedTuple):
    """Message from the robot's side."""

    torques: Float[np.ndarray, "channels"]
    """Torques of the glove against flexion [N.m]."""
    sent: float
    """Energy passed on so far by the robot's port [J]."""
    is_running: bool
    """False after the robot's emergency stop."""
    sensations: Sensations = SILENCE
    """Vibration and heat that the person is to feel."""
    wrist_force: Float[np.ndarray, "3"] = NO_FORCE
    """Force on the person's wrist, along the axes of the robot's world [N]."""

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack the message into one vector."""
        flags = [self.sent, float(self.is_running)]
        return np.concatenate([self.torques, flags, self.sensations.vector(), self.wrist_force])

    @staticmethod
    def size(channels: int) -> int:
        """Return the number of elements of the vector."""
        return channels + 2 + 2 * N_FINGERS + 3

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "RobotMessage | None":
        """Unpack a message; return None for a vector that is not finite."""
        if vector.shape != (RobotMessage.size(channels),) or not np.isfinite(vector).all():
            return None
        torques, (sent, is_running), sensations, force = np.split(vector, [channels, channels + 2, -3])
        return RobotMessage(torques, float(sent), is_running == 1.0, Sensations.of(sensations), force)


class PersonSide:
    """The person's side: torques of the glove and force on the wrist from the robot's messages, and what to send."""

    def __init__(
        self, person: Hand, model: GloveModel, period: float = PERIOD, *, wrist_device: WristDevice | None = None
    ) -> None:
        """Create a side that has heard nothing.

        Args:
            person: human hand.
            model: of the glove.
            period: time between two steps [s].
            wrist_device: that exerts the force on the person's wrist; None where nothing is felt there.
        """
        self._channels = len(model.joints)
        self._indices = list(model.joint_indices(person.joints))
        self._transmission = model.transmission(person.joints)
        self._is_free = np.all(self._transmission == 0, 0)
        self._wrist_device = wrist_device
        accelerations = np.array([LARGEST_ACCELERATION] * self._channels + [LARGEST_WRIST_ACCELERATION] * 3)
        self.port = TorquePort(period=period, largest_acceleration=accelerations)
        """Port of the glove's channels, and of the wrist's place with the force against it."""
        self.trouble = "the robot has not answered"
        """Reason why no torque flows; empty while the robot answers."""
        self._heard: tuple[float, RobotMessage] | None = None

    @property
    def sensations(self) -> Sensations:
        """Return the vibration and heat of the robot's newest message; silence unless torque may flow."""
        return SILENCE if self.trouble or self._heard is None else self._heard[1].sensations

    def receive(self, timestamp: float, vector: Float[np.ndarray, "size"] | None) -> None:
        """Take the newest message of the robot's side, where it arrived at this time [s]."""
        message = None if vector is None else RobotMessage.of(vector, self._channels)
        if message is not None:
            self._heard = timestamp, message

    def step(
        self, timestamp: float, flexions: Float[np.ndarray, "channels"], others: Float[np.ndarray, "P"], wrist: PalmPose
    ) -> tuple[Float[np.ndarray, "channels"], PersonMessage]:
        """Command the device on the wrist; return the torques of the glove [N.m], and the message to send.

        Args:
            timestamp: time now [s].
            flexions: angles that the glove reads [rad].
            others: angles of all joints, of which those without a channel count [rad].
            wrist: pose of the wrist in the robot's world.
        """
        requested, sent = np.zeros(self._channels + 3), 0.0
        self.trouble = self._find_trouble(timestamp)
        if self._heard is not None:
            sent = self._heard[1].sent
            if not self.trouble:
                force = NO_FORCE if self._wrist_device is None else self._heard[1].wrist_force
                requested = np.concatenate([self._heard[1].torques, -force])
        allowed = self.port.step(np.concatenate([flexions, wrist.origin]), requested, sent)
        torques, force_against = allowed[: self._channels], allowed[self._channels :]
        if self._wrist_device is not None:
            self._wrist_device.command(timestamp, np.concatenate([-force_against, np.zeros(3)]))
        angles = np.where(self._is_free, others, flexions @ self._transmission)
        return torques, PersonMessage(angles, wrist, self.port.tank.sent)

    def _find_trouble(self, timestamp: float) -> str:
        if self._heard is None:
            return "the robot has not answered"
        at, message = self._heard
        if timestamp - at > MAX_SILENCE:
            return f"the robot has been silent for {1e3 * (timestamp - at):.0f} ms"
        return "" if message.is_running else "the robot made an emergency stop"


class RobotSide:
    """The robot's side: commands of the robot from the person's messages, and torques back."""

    def __init__(
        self,
        follower: Follower,
        retargeting: Retargeting,
        feedback: ForceFeedback | None,
        palm_offset: Float[np.ndarray, "3"] | None = None,
        substitution: Substitution | None = None,
        *,
        has_wrist: bool = False,
    ) -> None:
        """Create a side that has heard nothing.

        Args:
            follower: the robot.
            retargeting: from the person's hand to the robot's.
            feedback: forces to torques; None where the person feels nothing.
            palm_offset: from the person's wrist to the robot's palm, in the wrist's axes [m]; zero where not given.
            substitution: contacts to vibration and heat; None where neither is to be felt.
            has_wrist: True if the person's side has a device that exerts the contacts' force on the wrist.
        """
        self._has_wrist = has_wrist and feedback is not None
        self._substitution = substitution
        self._fingers = finger_indices(tuple(follower.links))
        self._follower, self._retargeting, self._feedback = follower, retargeting, feedback
        self._offset = np.zeros(3) if palm_offset is None else np.asarray(palm_offset, float)
        person = retargeting.person
        self._indices = [] if feedback is None else list(feedback.model.joint_indices(person.joints))
        self._transmission = None if feedback is None else feedback.model.transmission(person.joints)
        self._joints = () if feedback is None else feedback.model.joints
        self.port: MotionPort | None = None
        self.state: FollowerState = follower.read(0.0)
        """Last measurements of the robot."""
        self.angles: Float[np.ndarray, P] | None = None
        """Angles of the person's hand as the robot follows them [rad]; None before the first message."""

    def step(self, timestamp: float, message: PersonMessage | None) -> RobotMessage:
        """Measure, follow the newest message, and return the message to send."""
        self.state = state = self._follower.read(timestamp)
        is_running = not state.cause
        channels = 0 if self._feedback is None else len(self._indices)
        torques, saturation = np.zeros(channels), np.zeros(N_FINGERS)
        # Force of the hand on the object: the wrist feels its opposite.
        force = state.contacts.forces.sum(0) if self._has_wrist else NO_FORCE
        if message is None:
            return RobotMessage(torques, 0.0, is_running)
        angles, origin = message.angles, message.wrist.origin
        if self._feedback is not None and self._transmission is not None:
            flexions = angles[self._indices]
            moved = np.concatenate([flexions, message.wrist.origin])
            if self.port is None or self.angles is None:
                self.port, self.angles = MotionPort(moved), angles
            # Power is counted by the torques measured now and the motion that is commanded next.
            limits, asked = np.array(self._feedback.model.limits), self._feedback.asked_torques(state, self.angles)
            torques, saturation = np.clip(asked, 0.0, limits), finger_saturation(asked, limits, self._joints)
            follows = np.any(self._transmission != 0, 0)
            allowed = self.port.step(moved, np.concatenate([torques, force]), message.sent)
            angles = np.where(follows, allowed[:channels] @ self._transmission, angles)
            origin = allowed[channels:] if self._has_wrist else origin
        self.angles = angles
        rotation = message.wrist.rotation @ np.asarray(self._retargeting.calibration.axes).T
        palm = PalmPose(origin + message.wrist.rotation @ self._offset, rotation)
        self._follower.command(timestamp, self._retargeting(angles), palm)
        sent = 0.0 if self.port is None else self.port.tank.sent
        return RobotMessage(torques, sent, is_running, self._substitute(timestamp, state, saturation), -force)

    def _substitute(self, timestamp: float, state: FollowerState, saturation: Float[np.ndarray, "5"]) -> Sensations:
        if self._substitution is None:
            return SILENCE
        return substitute_contacts(self._substitution, timestamp, state.contacts, self._fingers, saturation)


def substitute_contacts(
    substitution: Substitution,
    timestamp: float,
    contacts: FollowerContacts,
    fingers: Int[np.ndarray, "L"],
    saturation: Float[np.ndarray, "5"] | None = None,
) -> Sensations:
    """Compute the sensations of a follower's contacts.

    Args:
        substitution: law, and the contacts so far.
        timestamp: time that never runs backwards [s].
        contacts: measured.
        fingers: index of each link's finger, -1 for the palm's.
        saturation: share of the torque that is not given, by finger.
    """
    touching = fingers[contacts.links] if len(contacts.links) else np.zeros(0, int)
    friction = substitution.law.friction
    normal, margins = finger_contacts(contacts.forces, contacts.normals, touching, friction)
    return substitution.step(timestamp, normal, margins, saturation)
