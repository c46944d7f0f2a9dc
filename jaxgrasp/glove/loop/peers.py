"""Peers of the I/O side, which give it torque laws and receive its state: a local process or a remote computer."""

import math
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxgrasp.glove.loop.exchange import GloveState, Slot, TorqueLaw
from jaxgrasp.glove.network.link import NetworkLink

LAW, STATE = "law", "state"
"""File names of the slots in the folder that two processes share."""
CALL = 0.05
"""Time between two calls of a silent glove [s]."""
MAX_LEAD = 0.005
"""Largest time by which a law may seem to come from the future [s]."""


class Peer(ABC):
    """The computing side, as the I/O side sees it."""

    @abstractmethod
    def law(self, timestamp: float) -> TorqueLaw | None:
        """Return the latest law, with ``computed_at`` on the local clock; None before the first law."""

    @abstractmethod
    def publish(self, timestamp: float, state: GloveState) -> None:
        """Send the state of the glove to the peer."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection to the other side."""


class SlotPeer(Peer):
    """Peer on this machine, through slots in shared memory; it has the same clock."""

    def __init__(self, folder: Path, channels: int) -> None:
        """Open the slots that ``make_slots`` created in a folder."""
        self._channels = channels
        self._law = Slot(folder / LAW, TorqueLaw.size(channels))
        self._state = Slot(folder / STATE, GloveState.size(channels))

    def law(self, timestamp: float) -> TorqueLaw | None:
        vector = self._law.read()
        if vector is None:
            return None
        law = TorqueLaw.of(vector, self._channels)
        # It may have come while this turn was held up after it had read its clock: then it is as fresh as can be.
        return replace(law, computed_at=timestamp) if timestamp < law.computed_at <= time.perf_counter() else law

    def publish(self, timestamp: float, state: GloveState) -> None:
        self._state.write(state.vector())

    def close(self) -> None:
        self._law.close()
        self._state.close()


class LinkPeer(Peer):
    """Peer on another computer, through a link that drops messages that are too old."""

    def __init__(self, link: NetworkLink, channels: int) -> None:
        """Wrap a link whose incoming messages are laws."""
        self._link, self._channels = link, channels

    def law(self, timestamp: float) -> TorqueLaw | None:
        message = self._link.receive(timestamp)
        if message is None:
            return None
        # The age that it had already when it was sent counts too: an engine that hangs may go on sending.
        return TorqueLaw.of(message.values, self._channels).since(timestamp - self._link.exchange.age(timestamp))

    def publish(self, timestamp: float, state: GloveState) -> None:
        self._link.send(timestamp, state.since(timestamp).vector())

    def close(self) -> None:
        self._link.close()


class EngineLink:
    """Engine side of a link to a remote glove, with ``state`` and ``write`` as in ``GloveProcess``."""

    def __init__(self, link: NetworkLink, channels: int) -> None:
        """Wrap a link whose incoming messages are states."""
        self._link, self._channels = link, channels
        self._called_at = -math.inf

    def state(self, timestamp: float) -> GloveState | None:
        """Return the latest state of the glove; None without a fresh state, and then call the glove again when due."""
        message = self._link.receive(timestamp)
        if message is None:
            if timestamp - self._called_at > CALL:
                self._called_at = timestamp
                zeros = np.zeros(self._channels)
                law = TorqueLaw(timestamp, False, zeros, zeros, np.zeros((self._channels, self._channels)))
                self.write(timestamp, law)
            return None
        state = GloveState.of(message.values, self._channels)
        return None if state is None else state.since(timestamp - self._link.exchange.age(timestamp))

    def write(self, timestamp: float, law: TorqueLaw) -> None:
        """Send the torque law that the glove follows from now on."""
        self._link.send(timestamp, law.since(timestamp).vector())

    def close(self) -> None:
        """Close the connection to the other side."""
        self._link.close()


class NoPeer(Peer):
    """Absent peer: the sensors are read, and there is no law."""

    def law(self, timestamp: float) -> TorqueLaw | None:
        return None

    def publish(self, timestamp: float, state: GloveState) -> None:
        return

    def close(self) -> None:
        return


def make_slots(folder: Path, channels: int) -> tuple[Slot, Slot]:
    """Create empty slots for laws and for states in a folder."""
    law = Slot(folder / LAW, TorqueLaw.size(channels), create=True)
    return law, Slot(folder / STATE, GloveState.size(channels), create=True)
