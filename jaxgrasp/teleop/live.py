"""Teleoperation in real time: a glove here, a robot here or at another computer, as fast as both sides go."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.rendering import TickTimes, run_at_rate
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.teleop.follower import PalmPose
from jaxgrasp.teleop.network import SimulatedLink
from jaxgrasp.teleop.session import PersonMessage, PersonSide, RobotSide

OLDEST = 2.0
"""Age up to which a message of the other side counts as its newest [s]; its silence is judged by arrivals."""


class RobotConnection(ABC):
    """Connection of the person's side with a robot's."""

    @abstractmethod
    def exchange(self, timestamp: float, message: PersonMessage, near: PersonSide) -> None:
        """Send a message, and hand over to ``near`` the newest that has come back."""

    @abstractmethod
    def close(self) -> None:
        """Free what the connection holds."""


class RobotHere(RobotConnection):
    """The robot in this process, behind a simulated network."""

    def __init__(self, side: RobotSide, outgoing: SimulatedLink, incoming: SimulatedLink, joints: int) -> None:
        """Connect a robot's side; ``joints`` is the number of the person's joints."""
        self.side, self._outgoing, self._incoming, self._joints = side, outgoing, incoming, joints
        self._started_at: float | None = None

    def exchange(self, timestamp: float, message: PersonMessage, near: PersonSide) -> None:
        """Send a message to the robot's side, let it act, and hand over what has come back."""
        if self._started_at is None:
            self._started_at = timestamp
        self._outgoing.send(timestamp, message.vector())
        heard = self._outgoing.receive(timestamp)
        # The robot's clock begins at zero with the first message.
        received = None if heard is None else PersonMessage.of(heard, self._joints)
        answer = self.side.step(timestamp - self._started_at, received)
        self._incoming.send(timestamp, answer.vector())
        near.receive(self._incoming.arrived_at, self._incoming.receive(timestamp))

    def close(self) -> None:
        """Do nothing: the robot belongs to the caller."""


class RobotElsewhere(RobotConnection):
    """The robot at another computer, behind a network link."""

    def __init__(self, link: NetworkLink) -> None:
        """Use a link whose ``oldest`` is ``OLDEST``."""
        self._link, self._number = link, -1

    def exchange(self, timestamp: float, message: PersonMessage, near: PersonSide) -> None:
        """Send a message, and hand over the newest that has come."""
        self._link.send(timestamp, message.vector())
        answer = self._link.receive(timestamp)
        if answer is not None and answer.number != self._number:
            self._number = answer.number
            near.receive(timestamp, answer.values)

    def close(self) -> None:
        """Close the link."""
        self._link.close()


def run_person(
    near: PersonSide,
    robot: RobotConnection,
    state: Callable[[], GloveState | None],
    write: Callable[[TorqueLaw], None],
    wrist: Callable[[float], PalmPose | None],
    others: Float[np.ndarray, "P"],
    rate: float,
    goes_on: Callable[[float], bool],
) -> TickTimes:
    """Run the person's side at a constant rate until ``goes_on`` returns False; return the times of its steps.

    A law is written at each step; it is marked as invalid while the robot is silent or stopped, so that the glove's
    guard lets go.

    Args:
        near: the person's side.
        robot: connection with the robot.
        state: current state of the glove.
        write: receiver of the torque law.
        wrist: pose of the person's wrist in the robot's world at a time [s]; None while it is unknown.
        others: angles of the person's joints that the glove does not read [rad].
        rate: of the steps [Hz].
        goes_on: function called after each step with the time.
    """

    def step(timestamp: float) -> None:
        glove_state, pose = state(), wrist(timestamp)
        if glove_state is None or pose is None or not np.all(np.isfinite(glove_state.angles)):
            return
        angles = glove_state.angles
        torques, message = near.step(timestamp, angles, others, pose)
        robot.exchange(timestamp, message, near)
        slope = np.zeros((len(angles), len(angles)))
        write(TorqueLaw(timestamp, not near.trouble, angles, torques, slope, near.sensations))

    return run_at_rate(step, rate, goes_on)


def run_robot(
    side: RobotSide, link: NetworkLink, joints: int, rate: float, goes_on: Callable[[float], bool]
) -> TickTimes:
    """Run the robot's side behind a network link at a constant rate; return the times of its steps.

    Args:
        side: the robot's side; its clock begins at zero here.
        link: to the person's side, of ``PersonMessage.size(joints)`` numbers, with ``OLDEST`` as its oldest age.
        joints: number of the person's joints.
        rate: of the steps [Hz].
        goes_on: function called after each step with the time.
    """
    started_at = time.perf_counter()

    def step(timestamp: float) -> None:
        heard = link.receive(timestamp)
        message = None if heard is None else PersonMessage.of(heard.values, joints)
        link.send(timestamp, side.step(timestamp - started_at, message).vector())

    return run_at_rate(step, rate, goes_on)
