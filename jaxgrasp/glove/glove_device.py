"""Interface of a glove device: it reads joint angles, resists flexion, and resists nothing after any fault."""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.guard import Guard, GuardOutput
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.substitution import Sensations

REOPEN = 0.25
"""Time between attempts to open a port [s]."""
SILENCE = 0.25
"""Longest time without a frame from the device before the link counts as lost [s]."""
STOPPED_HERE = "emergency stop: requested at the host"


class LinkState(IntEnum):
    """State of the link between a host and its device."""

    CLOSED = 0
    """The port is not open."""
    GREETING = 1
    """The port is open, and no valid answer has arrived."""
    LINKED = 2
    """The device answers."""
    ARMING = 3
    """The user asked for torque: a new session begins, and the device has not confirmed it yet."""
    ARMED = 4
    """Torque may flow."""


@dataclass
class Reading:
    """Latest sensor values of a glove; arrays ``(channels,)``, NaN before the first value and for absent sensors."""

    angles: np.ndarray
    """Joint angles [rad]."""
    torques: np.ndarray
    """Torques that the cables exert [N.m]."""
    saturated: np.ndarray
    """Mask of the channels whose gauge is at the end of its range."""
    angles_at: float = -np.inf
    """Time at which the angles were read, on the host's clock [s]."""
    torques_at: float = -np.inf
    """Time at which the tensions were read, on the host's clock [s]."""

    @staticmethod
    def empty(channels: int) -> "Reading":
        """Create a reading without any sensor values: NaN angles and torques, no saturated gauge."""
        nan_values = np.full(channels, np.nan)
        return Reading(nan_values, nan_values.copy(), np.zeros(channels, bool))


class Capability(NamedTuple):
    """Capabilities of a device class."""

    resists_by: Literal["torque", "position limit", "vibration", "nothing"]
    """Physical effect by which the device renders a requested torque; nothing if it only reads."""
    measures_torque: bool
    """True if the device measures torques, so that ``Reading.torques`` holds finite numbers."""
    outlives_host: bool
    """True if the device has no watchdog, so that its last command stays in force after its host dies."""


class GloveDevice(ABC):
    """A glove on a line, driven by calls to ``poll`` and ``send`` at the caller's rate; neither waits.

    Nothing is armed but by ``arm``; whatever goes wrong trips the guard, and what is sent then resists nothing. A line
    that goes away is opened again, and stays without torque.
    """

    capability: ClassVar[Capability]
    acceptance: ClassVar[str] = ""
    """Sentence that the user must repeat exactly to arm the device; empty if none is required."""
    model: GloveModel
    guard: Guard
    """Guard that bounds the commands; its state is the state of the device."""
    state: LinkState
    trouble: str
    """Reason why there is no link."""
    reading: Reading
    _line: Line | None
    """Open line; None while the port is not open."""
    _next_attempt: float
    """Time of the next attempt to open the port or to greet [s]."""

    @abstractmethod
    def arm(self, timestamp: float, accepted: str = "") -> None:
        """Ask for torque; ``state`` is ARMED once there may be any. What latched before is forgotten.

        Args:
            timestamp: time [s], on a clock that never runs backwards; of all calls.
            accepted: what the user said, where there is an ``acceptance``.

        Raises:
            ValueError: without a link, without fresh angles, and without these words.
        """

    def disarm(self) -> None:
        """Disarm the guard: no torque from the next command on."""
        self.guard.disarm()
        self.state = min(self.state, LinkState.LINKED)

    def stop(self, timestamp: float) -> None:
        """Execute the emergency stop: no torque from the next command on, and latched, in any state; never raise."""
        self.guard.stop(STOPPED_HERE)
        self.state = min(self.state, LinkState.LINKED)

    @abstractmethod
    def poll(self, timestamp: float) -> Reading:
        """Read and decode the bytes that came, open the port and greet when due; return the latest sensor values."""

    @abstractmethod
    def send(
        self,
        timestamp: float,
        requested: Any,
        measured_at: float,
        slope: Float[np.ndarray, "channels channels"] | None = None,
    ) -> GuardOutput:
        """Send a command; return the guard's output for it.

        Args:
            timestamp: as for ``poll``.
            requested: torques by which to resist flexion ``(channels,)`` [N.m].
            measured_at: when the angles were read that these torques answer [s].
            slope: derivative of the torques (rows) by the angles [N.m/rad], for devices that limit positions.
        """

    def sense(self, sensations: Sensations) -> None:  # noqa: B027
        """Set the vibration and heat that later calls of ``send`` bring to the device, where it has such channels."""

    @abstractmethod
    def close(self, timestamp: float) -> None:
        """Send a command of zero, if the line takes it, and close the line."""

    def _drop_line(self, timestamp: float, trouble: str) -> None:
        """Trip the guard, close the line and schedule the next attempt to open the port."""
        self.guard.trip(trouble)
        self.trouble = trouble
        self._close_line()
        self.state, self._next_attempt = LinkState.CLOSED, timestamp + REOPEN

    def _close_line(self) -> None:
        """Close the line if it is open; devices with two lines close both."""
        if self._line is not None:
            self._line.close()
        self._line = None

    @property
    def is_free(self) -> bool:
        """True if no command is in force that resists; always true for a device that does not outlive its host."""
        return True

    @staticmethod
    def free(line: Line) -> bool:
        """Send the command that ends all resistance, on a line in unknown state; for devices that outlive their host.

        Returns:
            True if the line took all of it.

        Raises:
            LineError: if the line is gone.
        """
        raise NotImplementedError

    silences_second_line: ClassVar[bool] = False
    """True if something on the line from which joints are read goes on after the host's death, until ``silence``."""

    @staticmethod
    def silence(line: Line) -> None:
        """Send what ends all vibration on the line from which joints are read.

        Raises:
            LineError: if the line is gone.
        """
        raise NotImplementedError

    def status_text(self) -> str:
        """Return further information from the glove, such as pressed buttons, as text for display."""
        return ""

    def last_frames(self) -> list[dict[str, Any]]:
        """Return the last frames of both directions, oldest first, for the latch log; empty if none are kept."""
        return []

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """Return the device's counters as a JSON-serializable dictionary."""


class OutlivingDevice(GloveDevice):
    """A device that outlives its host: it is told to end all resistance, and whether it heard that is kept."""

    name_and_remedy: ClassVar[tuple[str, str]]
    """Words for the log where it could not be freed: what resists, and what its user does then."""

    def __init__(self, model: GloveModel, open_line: Callable[[], Line], guard: Guard) -> None:
        """Create a host whose line is not open yet.

        Args:
            model: of the glove.
            open_line: opens the port; called again after each loss.
            guard: of the model.
        """
        self.model, self.guard = model, guard
        self.state, self.trouble = LinkState.CLOSED, "not opened yet"
        self.reading = Reading.empty(len(model.joints))
        self.links = 0
        """Number of times that the link was established."""
        self._open, self._next_attempt = open_line, -math.inf
        self._line = None
        self._may_hold = False

    def close(self, timestamp: float) -> None:
        """End all resistance, if the line is still there, and close it."""
        self.disarm()
        if self._line is not None:
            try:
                self._may_hold = not self.free(self._line)
            except LineError as error:
                self.trouble = str(error)
        self._close_line()
        self.state = LinkState.CLOSED
        if self._may_hold:
            name, remedy = self.name_and_remedy
            logging.getLogger(type(self).__module__).error("%s could not be freed: %s; %s", name, self.trouble, remedy)

    @property
    def is_free(self) -> bool:
        return not self._may_hold
