"""Messages between the two sides of the loop: the torque law by angle, and the glove's state.

Slot for the latest value in memory that processes share: no queue, no partial value.
"""

import math
import mmap
import struct
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.protocol.device import N_FINGERS
from jaxgrasp.glove.substitution import Sensations

_HEAD = struct.Struct("<QI")
MAX_TRIES = 20


class Slot:
    """Array that one process writes and others read, in a memory-mapped file.

    A value is whole or not seen: it travels with its number and a check sum, whatever the order in which a processor
    lets another see what it writes.
    """

    def __init__(self, path: Path, size: int, *, create: bool = False) -> None:
        """Open a slot for ``size`` numbers.

        Args:
            path: the file, on the same machine for all.
            size: how many numbers.
            create: make the file, empty; the others need it to be there.

        Raises:
            OSError: without the file, or the right to it.
            ValueError: for a file of another size.
        """
        length = _HEAD.size + 8 * size
        if create:
            path.write_bytes(b"\0" * length)
        with open(path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        if len(self._memory) != length:
            raise ValueError(f"{path} has {len(self._memory)} bytes: expected {length}")
        self._size, self._number = size, _HEAD.unpack_from(self._memory)[0]
        self._latest: tuple[int, np.ndarray] | None = None

    def write(self, values: Float[np.ndarray, "size"]) -> None:
        """Replace the value, of shape ``(size,)``."""
        self._number += 1
        raw = values.tobytes()
        # The number is no part of what could be right by chance: an old one fails with new numbers.
        checksum = zlib.crc32(raw, self._number % 2**32)
        self._memory[_HEAD.size :] = raw
        self._memory[: _HEAD.size] = _HEAD.pack(self._number, checksum)

    def read(self) -> Float[np.ndarray, "size"] | None:
        """Return the latest complete value, of shape ``(size,)``; None before the first."""
        for _ in range(MAX_TRIES):
            number, checksum = _HEAD.unpack_from(self._memory)
            if number == 0 or (self._latest is not None and number == self._latest[0]):
                break
            raw = self._memory[_HEAD.size :]
            if zlib.crc32(raw, number % 2**32) == checksum:
                self._latest = number, np.frombuffer(raw, np.float64)
                break
        return None if self._latest is None else self._latest[1]

    def close(self) -> None:
        """Unmap the shared memory."""
        self._memory.close()


WORDS_SIZE = 120
"""Number of bytes of the words in a vector."""


def pack_words(words: str) -> Float[np.ndarray, "120"]:
    """Pack words into numbers, a byte each; what is longer is cut, and the rest is zero."""
    codes = np.frombuffer(words.encode()[:WORDS_SIZE], np.uint8)
    return np.pad(codes.astype(float), (0, WORDS_SIZE - len(codes)))


def unpack_words(numbers: Float[np.ndarray, "120"]) -> str:
    """Unpack words from their numbers; numbers that are no bytes are left out, as is a character that was cut."""
    is_byte = (numbers >= 1) & (numbers <= 255)
    return bytes(numbers[is_byte].astype(np.uint8).tolist()).decode(errors="ignore")


@dataclass(frozen=True, eq=False)
class TorqueLaw:
    """First-order torque law about given angles, from the slow computation to the fast line.

    The line knows no contacts; between two computations it follows the derivative to fresh angles.
    """

    computed_at: float
    """Time of the computation, on the clock of the side that computed it [s]."""
    is_valid: bool
    """True if the law may be acted on."""
    angles: Float[np.ndarray, "channels"]
    """Angles at which the law was computed [rad]."""
    torques: Float[np.ndarray, "channels"]
    """Torques that resist flexion at these angles [N.m]."""
    derivative: Float[np.ndarray, "channels channels"]
    """Derivative of the torques (rows) by the angles [N.m/rad]."""
    sensations: Sensations = field(default_factory=Sensations.none)
    """Vibration and heat beside the torques; silence where not given."""

    def at(self, angles: Float[np.ndarray, "channels"], reach: float) -> Float[np.ndarray, "channels"]:
        """Compute the torques at other angles [N.m]; deviations are clipped to ``reach`` [rad] on either side."""
        # tau(theta) = tau_0 + dtau/dtheta (theta - theta_0)
        return self.torques + self.derivative @ np.clip(angles - self.angles, -reach, reach)

    def since(self, timestamp: float) -> "TorqueLaw":
        """Replace the time by the age, to send the law to another clock; a second call there restores a time."""
        return replace(self, computed_at=timestamp - self.computed_at)

    @staticmethod
    def size(channels: int) -> int:
        """Return the number of elements of its vector."""
        return 2 + channels * (2 + channels) + 2 * N_FINGERS

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into one vector."""
        return np.concatenate(
            [
                [self.computed_at, float(self.is_valid)],
                self.angles,
                self.torques,
                self.derivative.ravel(),
                self.sensations.vector(),
            ]
        )

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "TorqueLaw":
        """Unpack a law from its vector; a vector that is not finite gives a law that is not valid."""
        ends = [channels, 2 * channels, channels * (2 + channels)]
        angles, torques, derivative, sensations = np.split(vector[2:], ends)
        valid = bool(vector[1] == 1.0 and np.all(np.isfinite(vector)))
        slopes = derivative.reshape(channels, channels)
        return TorqueLaw(float(vector[0]), valid, angles, torques, slopes, Sensations.of(sensations))


@dataclass(frozen=True, eq=False)
class GloveState:
    """State of the glove as the I/O side reports it."""

    at: float
    """Time of the report [s]."""
    link: int
    """Code of the ``LinkState``."""
    guard: int
    """Code of the ``GuardState``."""
    clipped: float
    """Largest part cut from a torque by limit or sign at this tick [N.m]: such a trial may have to be discarded."""
    angles_at: float
    """Time at which the angles were read [s]."""
    angles: Float[np.ndarray, "channels"]
    """Joint angles [rad]."""
    torques: Float[np.ndarray, "channels"]
    """Commanded torques [N.m]."""
    measured: Float[np.ndarray, "channels"]
    """Torques measured by the cables' tension [N.m]."""
    asked: Float[np.ndarray, "channels"] = None  # type: ignore[assignment]
    """Torques that the law asks for at these angles, before scale and limits [N.m]; NaN where they are not known."""
    cut_s: Float[np.ndarray, "channels"] = None  # type: ignore[assignment]
    """Time for which each torque was cut, by limit or warmth, since the start [s]; NaN where it is not known."""
    cause: str = ""
    """Reason why no torque flows: of the guard's latch, or of the lost link; cut after ``WORDS_SIZE`` bytes."""

    def __post_init__(self) -> None:
        for name in ("asked", "cut_s"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.angles), np.nan))

    def since(self, timestamp: float) -> "GloveState":
        """Replace times by ages, to send the state to another clock; a second call there restores times."""
        return replace(self, at=timestamp - self.at, angles_at=timestamp - self.angles_at)

    @staticmethod
    def size(channels: int) -> int:
        """Return the number of elements of its vector."""
        return 5 + 5 * channels + WORDS_SIZE

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into one vector."""
        head = [self.at, self.link, self.guard, self.clipped, self.angles_at]
        arrays = (self.angles, self.torques, self.measured, self.asked, self.cut_s)
        return np.concatenate([head, *arrays, pack_words(self.cause)])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "GloveState | None":
        """Unpack a state from its vector; return None for an invalid vector."""
        at, link, guard, clipped, angles_at = vector[:5].tolist()
        if link not in (0, 1, 2, 3, 4) or guard not in (0, 1, 2) or not math.isfinite(at):
            return None
        angles, torques, measured, asked, cut_s, words = np.split(vector[5:], channels * np.arange(1, 6))
        codes = int(link), int(guard)
        felt = (angles, torques, measured, asked, cut_s)
        return GloveState(at, *codes, clipped, angles_at, *felt, unpack_words(words))
