"""Main board of a DOGlove: bytes to encoder readings that are plausible, and strengths of vibration to its commands.

The board sends frames of 76 bytes, little-endian: AA 55 00 00, the encoders' supply [uV], 16 readings of 24 bits, and a
word whose high half is the low half of the sum of the 17 words before it, and whose low half counts milliseconds.
**The sum says nothing about the high halves of the words**: a fault there passes it, and is refused here because the
word then differs by 2^16 or more from the parabola through the three frames before it.

The board plays a waveform of vibration at once, and again each time that the duration of its command has passed,
**until a command of waveform 0 comes: nothing on it ends a vibration by itself** (``Users/lra_control.c`` and
``Core/Src/main.c`` of its firmware, https://github.com/doublehan07/DOGlove_Firmware). So the longest duration is always
sent, and a vibration that goes on is sent again before its waveform ends: after a host's death the waveform ends, and
comes again every 65.5 s. Waveforms are those of the DRV2605L's library: the buzzes 47 to 51 have 100, 80, 60, 40 and
20 % of the full strength.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrasp.glove.model import FINGERS

FRAME_HEADER = b"\xaa\x55\x00\x00"
FRAME_SIZE, WORDS, ENCODERS = 76, 18, 16
FULL_READING, FULL_VOLTAGE = 0x7FFFFF, 5.0
"""Largest reading of an encoder, and its voltage [V]."""
SUPPLY_RANGE = (2_500_000, 5_500_000)
"""Supply of the encoders that is believed [uV]."""
OVERSHOOT = 0.05
"""Largest part of the supply by which an encoder's voltage may lie outside it."""
HALF_STEP = 2**15
"""Largest difference of a word from its prediction: half of what a fault in a word's high half changes."""
AGREEING = 4
"""Number of frames in a row that lie on a line with one another, from which on they are believed."""
COUNTS = 2**14
"""Counts of an encoder for one turn; a servo's positions are converted to the same unit."""
STOP_WAVEFORM, MAX_WAVEFORM = 0, 123


class BoardFrame(NamedTuple):
    """Values of a frame of the main board."""

    words: Int[np.ndarray, "17"]
    """Supply [uV] and 16 readings."""
    milliseconds: int
    """The board's clock, 16 bits; no check covers it."""

    def counts(self) -> Int[np.ndarray, "16"]:
        """Convert the readings to counts, ``COUNTS`` for a turn."""
        volts = self.words[1:] * (FULL_VOLTAGE / FULL_READING)
        return np.rint(COUNTS * volts / (self.words[0] * 1e-6)).astype(int)


class BoardReader:
    """Decoder from the main board's bytes to frames that are plausible; it raises nothing, and keeps few bytes."""

    def __init__(self) -> None:
        """Create a decoder that has seen nothing."""
        self.accepted = self.refused = self.implausible = 0
        """Number of valid frames; of false starts and frames with a wrong sum or range; and of frames with a right sum
        that differ from their predecessors too much."""
        self._buffer = bytearray()
        self._last: list[tuple[int, np.ndarray]] = []
        self._number = 0
        self._candidates: list[np.ndarray] = []

    def feed(self, data: bytes) -> list[BoardFrame]:
        """Take bytes and return the frames that they complete."""
        self._buffer += data
        frames: list[BoardFrame] = []
        while (start := self._buffer.find(FRAME_HEADER)) >= 0:
            del self._buffer[:start]
            if len(self._buffer) < FRAME_SIZE:
                return frames
            frame = read_frame(bytes(self._buffer[:FRAME_SIZE]))
            # A false start costs one byte, or a frame that begins within it would be lost too.
            del self._buffer[: 1 if frame is None else FRAME_SIZE]
            if frame is None:
                self.refused += 1
            elif self._is_plausible(frame.words):
                self.accepted += 1
                frames.append(frame)
            else:
                self.implausible += 1
        # The header's first bytes may have come already.
        del self._buffer[: max(0, len(self._buffer) - 3)]
        return frames

    def _is_plausible(self, words: np.ndarray) -> bool:
        """Return True if a frame continues those before it, or if it is the last of several that agree."""
        # One frame more may have been lost than were refused.
        for number in (self._number + 1, self._number + 2) if self._last else ():
            if np.abs(words - _extrapolated(self._last, number)).max() < HALF_STEP:
                self._last = [*self._last[1:], (number, words)]
                self._number, self._candidates = number, []
                return True
        self._number += 1
        if len(self._candidates) >= 2:
            before, last = self._candidates[-2:]
            if np.abs(words - 2 * last + before).max() >= HALF_STEP:
                self._candidates = self._candidates[-1:]
        self._candidates.append(words)
        if len(self._candidates) < AGREEING:
            return False
        self._last = list(enumerate(self._candidates[-3:]))
        self._number, self._candidates = 2, []
        return True


def _extrapolated(frames: list[tuple[int, np.ndarray]], number: int) -> np.ndarray:
    """Extrapolate the words of three numbered frames to another number, by Lagrange's parabola."""
    (i, a), (j, b), (k, c) = frames
    n = number
    return (
        a * ((n - j) * (n - k) / ((i - j) * (i - k)))
        + b * ((n - i) * (n - k) / ((j - i) * (j - k)))
        + c * ((n - i) * (n - j) / ((k - i) * (k - j)))
    )


def read_frame(data: bytes) -> BoardFrame | None:
    """Decode a frame of 76 bytes; return None for a wrong header, sum or range."""
    if len(data) != FRAME_SIZE or data[:4] != FRAME_HEADER:
        return None
    unsigned = np.frombuffer(data, "<u4", WORDS, 4).astype(np.int64)
    if int(unsigned[:-1].sum()) & 0xFFFF != int(unsigned[-1]) >> 16:
        return None
    words = np.concatenate([unsigned[:1], np.frombuffer(data, "<i4", ENCODERS, 8)])
    supply = int(words[0])
    if not SUPPLY_RANGE[0] <= supply <= SUPPLY_RANGE[1]:
        return None
    readings = words[1:] * (FULL_VOLTAGE / FULL_READING) / (supply * 1e-6)
    if np.any(np.abs(words[1:]) > FULL_READING) or readings.min() < -OVERSHOOT or readings.max() > 1 + OVERSHOOT:
        return None
    return BoardFrame(words, int(unsigned[-1]) & 0xFFFF)


def vibration_command(finger: int, waveform: int, milliseconds: int) -> bytes:
    """Encode a command for the vibration actuator of a finger, 0 (thumb) to 4.

    Args:
        finger: which one.
        waveform: of the DRV2605L's library, 1 to 123; 0 stops.
        milliseconds: duration, 0 to 65535.

    Raises:
        ValueError: for other numbers.
    """
    ranges = {"finger": (finger, 4), "waveform": (waveform, MAX_WAVEFORM), "milliseconds": (milliseconds, 0xFFFF)}
    for name, (value, largest) in ranges.items():
        if not 0 <= value <= largest:
            raise ValueError(f"{name} is {value}: expected 0 to {largest}")
    body = bytes([finger, waveform, milliseconds >> 8, milliseconds & 0xFF])
    return b"\x55\xaa" + body + bytes([sum(body) & 0xFF])


LEVELS = (STOP_WAVEFORM, 51, 50, 49, 48, 47)
"""Waveforms of the strengths 0, 0.2, 0.4, 0.6, 0.8 and 1."""
LONGEST = 0xFFFF
"""Longest time after which the board plays a waveform again [ms]."""
PACE = 0.005
"""Time between two commands [s]: the board loses one that comes while it handles another."""
JITTER = 5e-4
"""Time by which a command may come earlier, so that a loop of this pace sends one at each turn [s]."""
REPEAT = 0.05
"""Time after which a vibration that goes on is sent again [s], and a stop, which may have been lost."""
HYSTERESIS = 0.7
"""Distance from its step, in steps, within which a strength is not changed."""
STOPS = 3
"""Number of times that a stop is sent."""


def silencing_commands() -> tuple[bytes, ...]:
    """Return the commands that end the vibration of each finger; ``PACE`` must pass between two of them."""
    return tuple(vibration_command(finger, STOP_WAVEFORM, 0) for finger in range(len(FINGERS)))


class VibrationSender:
    """Commands of the main board that are due: what changed first, stops before all, then what goes on."""

    def __init__(self) -> None:
        """Create a sender of a board that may still vibrate by what another host told it."""
        self._targets = np.zeros(len(FINGERS), int)
        self._orders: dict[int, bytes] = {}
        self.forget()

    def forget(self) -> None:
        """Begin with a board in unknown state: every finger is told anew, or stopped."""
        self._levels = np.full(len(FINGERS), -1)
        self._sent_at = np.full(len(FINGERS), -math.inf)
        self._stops = np.zeros(len(FINGERS), int)
        self._last_at = -math.inf

    def request(self, amplitudes: Float[np.ndarray, "5"]) -> None:
        """Set the strengths from now on, 0 to 1; what is not a number is silence."""
        shares = np.clip(np.nan_to_num(amplitudes, posinf=0.0, neginf=0.0), 0.0, 1.0)
        exact = (len(LEVELS) - 1) * shares
        # A strength between two steps stays at one of them: each change starts its waveform anew.
        is_near = (np.abs(exact - self._targets) <= HYSTERESIS) & (self._targets > 0) & (exact > 0)
        self._targets = np.where(is_near, self._targets, np.rint(exact).astype(int))

    def play(self, finger: int, waveform: int, milliseconds: int) -> None:
        """Play a waveform at the next turn, and again each time that so much time has passed, until another comes.

        Raises:
            ValueError: as ``vibration_command``.
        """
        self._orders[finger] = vibration_command(finger, waveform, milliseconds)

    def due(self, timestamp: float) -> bytes | None:
        """Return the command to send now; None where there is none, or the board still handles one."""
        if timestamp - self._last_at < PACE - JITTER:
            return None
        if self._orders:
            finger = next(iter(self._orders))
            # What it plays goes on until a strength changes.
            self._record(timestamp, finger, int(self._targets[finger]), STOPS)
            return self._orders.pop(finger)
        is_new = self._targets != self._levels
        is_stop = self._targets == 0
        is_ongoing = ~is_new & (timestamp - self._sent_at >= REPEAT) & ((self._targets > 0) | (self._stops < STOPS))
        for mask in (is_new & is_stop, is_new, is_ongoing):
            if mask.any():
                finger = int(np.argmin(np.where(mask, self._sent_at, math.inf)))
                stops = int(self._stops[finger]) + 1 if is_stop[finger] and not is_new[finger] else 1
                level = int(self._targets[finger])
                self._record(timestamp, finger, level, stops)
                return vibration_command(finger, LEVELS[level], LONGEST if level else 0)
        return None

    def _record(self, timestamp: float, finger: int, level: int, stops: int) -> None:
        self._levels[finger], self._stops[finger] = level, stops
        self._sent_at[finger] = self._last_at = timestamp
