"""What a glove is to those who drive it: angles in, resistance to flexion out, and none on every way out."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.guard import Guard, GuardOutput
from jaxgrasp.glove.line import Line
from jaxgrasp.glove.model import GloveModel

REOPEN = 0.25
"""Time between attempts to open a port [s]."""
SILENCE = 0.25
"""How long a device may say nothing before it counts as gone [s]."""
STOPPED_HERE = "emergency stop: asked for at the host"


class LinkState(IntEnum):
    """How far a host has come with its device."""

    CLOSED = 0
    """No port."""
    GREETING = 1
    """A port, and no answer that fits."""
    LINKED = 2
    """A device that answers."""
    ARMING = 3
    """A person asked for torque: a new session begins, and the device has not yet said yes."""
    ARMED = 4
    """Torque may flow."""


@dataclass
class Reading:
    """What a glove's sensors said last; arrays ``(channels,)``, NaN before they spoke, and where there are none."""

    angles: np.ndarray
    """Joints [rad]."""
    torques: np.ndarray
    """Torques that the cables exert [N.m]."""
    saturated: np.ndarray
    """Whether a channel's gauge is at its end."""
    angles_at: float = -np.inf
    """When the angles were read, on the host's clock [s]."""
    torques_at: float = -np.inf
    """When the tensions were [s]."""

    @staticmethod
    def of_nothing(channels: int) -> "Reading":
        """Before any sensor spoke."""
        nothing = np.full(channels, np.nan)
        return Reading(nothing, nothing.copy(), np.zeros(channels, bool))


class Capability(NamedTuple):
    """What a device can do."""

    resists_by: Literal["torque", "position limit", "vibration"]
    """What a torque that is asked for becomes."""
    measures_torque: bool
    """Whether ``Reading.torques`` are numbers."""
    outlives_host: bool
    """Whether what it was told last stays when its host is gone, since it has no watchdog."""


class GloveDevice(ABC):
    """A glove on a line, driven by calls to ``poll`` and ``send`` at the caller's rate; neither waits.

    Nothing is armed but by ``arm``; whatever goes wrong trips the guard, and what is sent then resists nothing. A line
    that goes away is opened again, and stays without torque.
    """

    capability: ClassVar[Capability]
    acceptance: ClassVar[str] = ""
    """What its user has to say, letter by letter, for it to be armed; nothing of a device that needs no such words."""
    model: GloveModel
    guard: Guard
    """Bounds what is sent; its state is the device's."""
    state: LinkState
    trouble: str
    """Why there is no link."""
    reading: Reading
    _line: Line | None
    """None while the port is not open."""
    _next: float
    """When there is something to do again: to open the port, or to greet [s]."""

    @abstractmethod
    def arm(self, now: float, accepted: str = "") -> None:
        """Ask for torque; ``state`` is ARMED once there may be any. What latched before is forgotten.

        Args:
            now: time [s], on a clock that never runs backwards; of all calls.
            accepted: what the user said, where there is an ``acceptance``.

        Raises:
            ValueError: without a link, without fresh angles, and without these words.
        """

    def disarm(self) -> None:
        """No torque from the next command on."""
        self.guard.disarm()
        self.state = min(self.state, LinkState.LINKED)

    def stop(self, now: float) -> None:
        """Emergency stop: no torque from the next command on, and latched, whatever the state; it raises nothing."""
        self.guard.stop(STOPPED_HERE)
        self.state = min(self.state, LinkState.LINKED)

    @abstractmethod
    def poll(self, now: float) -> Reading:
        """Take what came; open and greet where that is due."""

    @abstractmethod
    def send(
        self, now: float, wanted: Any, measured_at: float, slope: Float[np.ndarray, "channels channels"] | None = None
    ) -> GuardOutput:
        """Send a command; what the guard made of it.

        Args:
            now: as for ``poll``.
            wanted: torques by which to resist flexion ``(channels,)`` [N.m].
            measured_at: when the angles were read that these torques answer [s].
            slope: derivative of the torques (rows) by the angles [N.m/rad], for devices that limit positions.
        """

    @abstractmethod
    def close(self, now: float) -> None:
        """A command of zero, if the line takes it, and no line."""

    def _lose(self, now: float, trouble: str) -> None:
        """Without a line nothing flows until a person arms it again; the port is tried anew a little later."""
        self.guard.trip(trouble)
        self.trouble = trouble
        if self._line is not None:
            self._line.close()
        self._line, self.state, self._next = None, LinkState.CLOSED, now + REOPEN

    @property
    def is_free(self) -> bool:
        """Whether the device resists nothing for all that it was told; of one that does not outlive its host, yes."""
        return True

    @staticmethod
    def free(line: Line) -> bool:
        """Say on a line, of which no more is known, that nothing is resisted: of a device that outlives its host.

        Returns:
            Whether the line took it.

        Raises:
            LineError: if the line is gone.
        """
        raise NotImplementedError

    def also_says(self) -> str:
        """What the glove says besides, such as its buttons, for a person who watches."""
        return ""

    def last_frames(self) -> list[dict[str, Any]]:
        """What went to and fro last, oldest first, for a record of why torque ended; of a device that keeps it."""
        return []

    @abstractmethod
    def report(self) -> dict[str, Any]:
        """What it has counted, for a summary in JSON."""
