"""Vibration of a DOGlove: strengths of five fingers as waveforms of its main board, one command at a time.

The board plays a waveform at once, and again each time that the duration of its command has passed, **until a command
of waveform 0 comes: nothing on it ends a vibration by itself** (``Users/lra_control.c`` and ``Core/Src/main.c`` of its
firmware, https://github.com/doublehan07/DOGlove_Firmware). So the longest duration is always sent, and a vibration that
goes on is sent again before its waveform ends: after a host's death the waveform ends, and comes again every 65.5 s.
Waveforms are those of the DRV2605L's library: the buzzes 47 to 51 have 100, 80, 60, 40 and 20 % of the full strength.
"""

import math

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import FINGERS
from jaxgrasp.glove.other_devices.doglove_board import STOP_WAVEFORM, vibration_command

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
