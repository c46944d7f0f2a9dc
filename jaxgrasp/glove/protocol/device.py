"""Reference device of the native protocol, which firmware must match: the twin of ``firmware/glove_device.c``."""

import struct
import zlib
from collections.abc import Sequence as Numbers
from enum import IntEnum

from jaxgrasp.glove.protocol.frames import (
    CHANNELS,
    NO_FLAGS,
    SEQUENCES,
    TICKS,
    Flag,
    Frame,
    FrameReader,
    Kind,
    Sequence,
)

WINDOW = 64
"""Largest step of a command's number after the newest: the watchdog latches long before so many are missing."""
LONGEST_SILENCE = 1_000_000
"""Largest step of a frame's clock after the last frame's [us]."""
LONGEST_STEP = 20_000
"""Largest duration that a step counts [us], so that no pause allows a jump."""
LONGEST_COOLING = 8000
"""Largest cooling time that a step counts [ms], so that 64 bits hold every product."""
MAX_HEATING = 2**16 - 1
"""Longest time constant of motors [10 ms]."""
FADING = 5
"""Divisor of the bearable warmth: over its last fifth, a motor's largest count fades to its continuous count."""
N_FINGERS = 5
"""Largest number of vibration channels, and of heat channels: a finger each, thumb first."""
MAX_AMPLITUDE = 1000
"""Largest amplitude of a vibration [1/1000]."""
VIBRATION_WATCHDOG, HEAT_WATCHDOG = 50, 250
"""Times after which vibration falls silent and heaters go off, from when the device sent what the newest VIBRATE or
HEAT answers [ms]."""
HOTTEST = 4200
"""Bound of the temperature of a heat channel [1/100 deg C]. No message and no setting raises it."""
MAX_HEAT_RISE = 20_000
"""Largest steady rise of a heater [1/100 deg C], so that 64 bits hold every product."""
ANSWERS = (Kind.CAPABILITY, Kind.LIMITS, Kind.CONTINUOUS)
"""Answers of a device to a HELLO, in this order."""


class DeviceState(IntEnum):
    """State of a device. The codes travel in STATUS frames."""

    IDLE = 0
    """Zero torque: the device was never armed, or was disarmed."""
    ARMED = 1
    """Torque of the last command, within the device's bounds."""
    LATCHED = 2
    """Zero torque after a fault, until the device is armed again."""


class Cause(IntEnum):
    """Cause for which a device gave up its torque."""

    NONE = 0
    WATCHDOG = 1
    """No command came in time."""
    GREETED = 2
    """A host began anew."""
    OWN = 3
    """A fault of its own: a sensor, a motor."""
    STOPPED = 4
    """The emergency stop: its own button, or a host's STOP."""


REASONS: dict[int, str] = {
    Cause.NONE: "nothing",
    Cause.WATCHDOG: "no command came in time",
    Cause.GREETED: "a host began anew",
    Cause.OWN: "a fault of its own",
    Cause.STOPPED: "its emergency stop was pressed",
}
"""Descriptions of the causes for users."""
LATCHING_CAUSES = (Cause.OWN, Cause.STOPPED)
"""Causes that latch whatever the state."""


class Device:
    """Reference device: commands in, counts of torque out, with its own watchdog; no input raises an error.

    Times are its own clock [us], modulo 2^32, none before the last; it needs ``step`` about every millisecond.
    """

    def __init__(
        self,
        *,
        channels: int = CHANNELS,
        most: int | Numbers[int] = 11_999,
        continuous: Numbers[int] | None = None,
        heating: int = 3000,
        slew: int = 120,
        quantum: int = 100,
        watchdog: int = 50,
        seed: int = 0,
        vibrators: int = 0,
        heaters: int = 0,
        resting: int = 3400,
        heat_rise: int = 3000,
        heat_time: int = 800,
    ):
        """Create a device that is idle.

        Args:
            channels: how many of the 14 it has.
            most: largest count, of all channels or of each.
            continuous: largest count that each channel's motor bears for ever; ``most`` if None, or 0.
            heating: time constant by which motors warm and cool [10 ms]; 0 for none that warm.
            slew: largest change [counts/ms].
            quantum: torque of a count [1e-7 N.m].
            watchdog: time after which it latches, from when it sent what the newest command answers [ms].
            seed: below 2^32, another each time it is switched on, of the numbers that ARM must repeat.
            vibrators: number of vibration channels.
            heaters: number of heat channels.
            resting: temperature of the skin under a heater that is off [1/100 deg C].
            heat_rise: rise of that temperature under a heater that is on for ever [1/100 deg C], at least the true one.
            heat_time: time constant of that rise [10 ms], at most the true one.

        Raises:
            ValueError: for channels that no frame has, counts that are not one for each of them, a time constant
                that does not fit its place, and numbers of a heater that are out of range.
        """
        bounds = {"vibrators": (vibrators, 0, N_FINGERS), "heaters": (heaters, 0, N_FINGERS)}
        bounds |= {"resting": (resting, 0, HOTTEST), "heat_rise": (heat_rise, 1, MAX_HEAT_RISE)}
        for name, (value, least, most_value) in (bounds | {"heat_time": (heat_time, 1, MAX_HEATING)}).items():
            if not least <= value <= most_value:
                raise ValueError(f"{name} is {value}: expected {least} to {most_value}")
        if not 1 <= channels <= CHANNELS:
            raise ValueError(f"channels is {channels}: expected 1 to {CHANNELS}")
        if not 0 <= heating <= MAX_HEATING:
            raise ValueError(f"heating is {heating}: expected 0 to {MAX_HEATING}")
        self._most = _check_counts("most", (most,) * channels if isinstance(most, int) else most, channels)
        continuous_counts = self._most if continuous is None else _check_counts("continuous", continuous, channels)
        self._continuous = [min(count or peak, peak) for count, peak in zip(continuous_counts, self._most, strict=True)]
        self.state, self.cause = DeviceState.IDLE, Cause.NONE
        self.counts = [0] * CHANNELS
        """Torque of each channel [counts]."""
        self.accepted = 0
        """Number of accepted commands."""
        self.session: int | None = None
        """Session of the host that sent the last HELLO."""
        self.reader = FrameReader()
        self.order = Sequence()
        self._channels, self._slew, self._quantum = channels, slew, quantum
        self._watchdog, self._heating = watchdog, heating
        self._requested = [0] * CHANNELS
        self._command_echo = self._stepped_at = self._peer_clock = 0
        self._credit = 0
        self.warmth = [0] * CHANNELS
        """Heat that each motor has taken up and not yet given off [counts^2 ms]."""
        self._remainder_us = self._reported_channel = 0
        self._answers: list[Kind] = []
        self._sent = self._n_drawn = 0
        self._seed = seed
        self.nonce = 0
        """Number that ARM must repeat, drawn at each HELLO and each ARM."""
        self._is_pressed = False
        self.amplitudes = [0] * N_FINGERS
        """Amplitude of each vibration channel [1/1000]."""
        self.are_heating = [False] * N_FINGERS
        """True of each heater that is on."""
        self._vibrators, self._heaters = vibrators, heaters
        self._resting, self._heat_rise, self._heat_time = resting, heat_rise, 10 * heat_time
        self._heat_targets = [0] * N_FINGERS
        self._rises = [0] * N_FINGERS
        self._measured = [0] * N_FINGERS
        self._vibration_echo = self._heat_echo = 0
        self.is_sensed = False
        """True if the host of this session has sent a VIBRATE or HEAT that counted, so that SKIN is sent."""

    def receive(self, clock: int, data: bytes) -> None:
        """Decode bytes from the line and act on their frames, at a time [us]."""
        for frame in self.reader.feed(data):
            if frame.kind == Kind.HELLO:
                self._greet(clock, frame)
            elif frame.kind in (Kind.ARM, Kind.COMMAND) and self.session is not None and self._is_new(frame):
                self._execute(clock, frame)
            elif frame.kind in (Kind.VIBRATE, Kind.HEAT) and self.session is not None and self._is_new(frame):
                self._sense(clock, frame)
            elif frame.kind == Kind.STOP:
                self.trip(Cause.STOPPED)
                if self.session is not None:
                    self.accepted += self._is_new(frame)

    def press(self, is_pressed: bool) -> None:
        """Set the state of the emergency stop's button; a pressed button trips the device."""
        self._is_pressed = is_pressed
        if is_pressed:
            self.trip(Cause.STOPPED)

    def step(self, clock: int) -> list[int]:
        """Advance to a time [us]: warmth, watchdog and slew; return the torques from now on [counts]."""
        elapsed_us = (clock - self._stepped_at) % TICKS
        self._stepped_at = clock
        self._step_skin(clock, self._update_warmth(elapsed_us))
        if self.state == DeviceState.ARMED and (clock - self._command_echo) % TICKS > 1000 * self._watchdog:
            self.trip(Cause.WATCHDOG)
        if self.state != DeviceState.ARMED:
            self._zero_torques()
            return self.counts
        # Whole counts, and what is left of one is kept, so that no clock makes it faster or slower.
        self._credit += self._slew * min(elapsed_us, LONGEST_STEP)
        step, self._credit = divmod(self._credit, 1000)
        self.counts = [
            min(current + max(-step, min(step, target - current)), self._allowed(k))
            for k, (current, target) in enumerate(zip(self.counts, self._requested, strict=True))
        ]
        return self.counts

    def trip(self, cause: Cause) -> None:
        """Set the torque to zero at once; latch if armed, or for a lasting cause, for which it is called repeatedly."""
        if self.state == DeviceState.ARMED or cause in LATCHING_CAUSES:
            self.state, self.cause = DeviceState.LATCHED, cause
        self._zero_torques()
        if self.state == DeviceState.LATCHED:
            self._silence()

    def measure_skin(self, channel: int, temperature: int) -> None:
        """Take the temperature that a sensor at a heat channel measures [1/100 deg C]; 0 without a sensor."""
        self._measured[channel] = temperature

    def frame(self, clock: int, kind: Kind, values: tuple[int, ...], flags: Flag = NO_FLAGS) -> Frame:
        """Create the next frame to send, numbered, with the device's state among the flags."""
        if self.state == DeviceState.ARMED:
            flags |= Flag.ENABLE
        elif self.state == DeviceState.LATCHED:
            flags |= Flag.LATCHED
        if self._is_pressed:
            flags |= Flag.PRESSED
        self._sent = (self._sent + 1) % SEQUENCES
        padded = values + (0,) * (CHANNELS - len(values))
        return Frame(kind, self._sent, clock % TICKS, padded, flags, self._peer_clock, self.cause)

    def answer(self, clock: int) -> Frame | None:
        """Return the next answer to a HELLO: CAPABILITY, LIMITS, CONTINUOUS, once each; None after the last."""
        if not self._answers or self.session is None:
            return None
        kind = self._answers.pop(0)
        if kind != Kind.CAPABILITY:
            return self.frame(clock, kind, tuple(self._most if kind == Kind.LIMITS else self._continuous))
        bounds = (self._channels, self._watchdog, self._quantum, max(self._most), self._slew)
        vibration = (self._vibrators, VIBRATION_WATCHDOG if self._vibrators else 0)
        heat = (self._heaters, HEAT_WATCHDOG, HOTTEST) if self._heaters else (0, 0, 0)
        values = (self.session, *bounds, self.nonce, _signed(self._heating), *vibration, *heat)
        return self.frame(clock, kind, values)

    def skin(self, clock: int) -> Frame:
        """Create a SKIN frame: amplitudes, temperatures, and the heaters that are on."""
        temperatures = [self._temperature(k) if k < self._heaters else 0 for k in range(N_FINGERS)]
        mask = sum(is_on << k for k, is_on in enumerate(self.are_heating))
        # Rises and measured temperatures are below 2^15 by their bounds, but for a sensor that lies.
        values = (*self.amplitudes, *(min(max(t, 0), SEQUENCES // 2 - 1) for t in temperatures), mask)
        return self.frame(clock, Kind.SKIN, values)

    def status(self, clock: int) -> Frame:
        """Create a STATUS frame, with the warmth of the next channel in turn."""
        refused = sum(self.reader.refused.values())
        numbers = (self.accepted, self.order.missing, self.order.stale, refused)
        halves = [half for number in numbers for half in (number % 2**16, number // 2**16 % 2**16)]
        warmth = (self._reported_channel, min(self._share(self._reported_channel), SEQUENCES // 2 - 1))
        self._reported_channel = (self._reported_channel + 1) % self._channels
        values = (self.session or 0, self.state, self.cause, *halves, self.order.newest or 0, *warmth)
        return self.frame(clock, Kind.STATUS, tuple(_signed(value) for value in values))

    def _greet(self, clock: int, frame: Frame) -> None:
        if self.state == DeviceState.ARMED:
            self.trip(Cause.GREETED)
        self.session, self._answers = frame.values[0], list(ANSWERS)
        self.order = Sequence(frame.sequence, WINDOW)
        self._peer_clock = frame.clock
        self.accepted = 0
        self._silence()
        self.is_sensed = False
        self._draw_nonce(clock)

    def _draw_nonce(self, clock: int) -> None:
        self._n_drawn += 1
        self.nonce = _signed(zlib.crc32(struct.pack("<3I", self._seed, clock % TICKS, self._n_drawn)) % SEQUENCES)

    def _is_new(self, frame: Frame) -> bool:
        """Check that a frame is newer than the last by number and by clock; frames of an older session are neither."""
        if not 0 < (frame.clock - self._peer_clock) % TICKS <= LONGEST_SILENCE:
            self.order.stale += 1
            return False
        if not self.order.is_new(frame.sequence):
            return False
        self._peer_clock = frame.clock
        return True

    def _execute(self, clock: int, frame: Frame) -> None:
        """Act on a COMMAND or ARM: disarm at any age; arm or set torques only if it answers a recent frame."""
        if frame.kind == Kind.COMMAND and Flag.ENABLE not in frame.flags:
            self.accepted += 1
            if self.state == DeviceState.ARMED:
                self.state = DeviceState.IDLE
            self._zero_torques()
            return
        if (clock - frame.echo) % TICKS > 1000 * self._watchdog:
            self.order.stale += 1
            return
        self.accepted += 1
        if frame.kind == Kind.ARM:
            if frame.values[:2] == (self.session, self.nonce) and not self._is_pressed:
                self._zero_torques()
                self.state, self.cause, self._command_echo = DeviceState.ARMED, Cause.NONE, frame.echo
                # Each drawn number is valid for one ARM.
                self._draw_nonce(clock)
        elif self.state == DeviceState.ARMED:
            self._command_echo = frame.echo
            self._requested = [min(max(value, 0), most) for value, most in zip(frame.values, self._most, strict=True)]

    def _sense(self, clock: int, frame: Frame) -> None:
        """Act on a VIBRATE or HEAT that answers a recent frame, by its own watchdog, unless the device is latched."""
        is_heat = frame.kind == Kind.HEAT
        if (clock - frame.echo) % TICKS > 1000 * (HEAT_WATCHDOG if is_heat else VIBRATION_WATCHDOG):
            self.order.stale += 1
            return
        self.accepted += 1
        self.is_sensed = True
        if self.state == DeviceState.LATCHED:
            return
        most, count = (HOTTEST, self._heaters) if is_heat else (MAX_AMPLITUDE, self._vibrators)
        values = [min(max(value, 0), most) if k < count else 0 for k, value in enumerate(frame.values[:N_FINGERS])]
        if is_heat:
            self._heat_targets, self._heat_echo = values, frame.echo
        else:
            self.amplitudes, self._vibration_echo = values, frame.echo

    def _step_skin(self, clock: int, elapsed_ms: int) -> None:
        """Advance the heaters' temperatures, then execute both watchdogs and switch the heaters.

        A rise is estimated from above, r <- r - floor(r n / (T + n)) + ceil(h n / T): no less than the exact solution
        of T r' = h - r after n ms. A heater is on only if even the longest step from here stays below its target.
        """
        time, full = self._heat_time, 1000 * self._heat_rise
        for k in range(self._heaters):
            cooling = self._rises[k] * elapsed_ms // (time + elapsed_ms)
            heating = -(-full * elapsed_ms // time) if self.are_heating[k] else 0
            self._rises[k] += heating - cooling
        if (clock - self._vibration_echo) % TICKS > 1000 * VIBRATION_WATCHDOG:
            self.amplitudes = [0] * N_FINGERS
        if (clock - self._heat_echo) % TICKS > 1000 * HEAT_WATCHDOG:
            self._heat_targets = [0] * N_FINGERS
        ahead = -(-full * (LONGEST_STEP // 1000) // time)
        for k in range(self._heaters):
            target = self._heat_targets[k]
            hottest = self._resting + -(-(self._rises[k] + ahead) // 1000)
            self.are_heating[k] = target > 0 and hottest <= target and self._measured[k] < target

    def _temperature(self, channel: int) -> int:
        """Return the larger of the estimated and the measured temperature of a heat channel [1/100 deg C]."""
        return max(self._resting + -(-self._rises[channel] // 1000), self._measured[channel])

    def _silence(self) -> None:
        self.amplitudes, self._heat_targets = [0] * N_FINGERS, [0] * N_FINGERS
        self.are_heating = [False] * N_FINGERS

    def _update_warmth(self, elapsed_us: int) -> int:
        """Update the motors' warmth in whole milliseconds, which are returned: heating by squared counts, and cooling.

        New heat cools from the next step on, so that rounding and long steps never underestimate it.
        """
        elapsed_ms, self._remainder_us = divmod(self._remainder_us + elapsed_us, 1000)
        elapsed_ms, time_constant = min(elapsed_ms, LONGEST_COOLING), 10 * self._heating
        for k, count in enumerate(self.counts):
            cooling = self.warmth[k] * elapsed_ms // max(time_constant + elapsed_ms, 1)
            self.warmth[k] += count * count * elapsed_ms - cooling
        return elapsed_ms

    def _bearable(self, channel: int) -> int:
        """Compute the warmth that a motor bears for ever [counts^2 ms]."""
        return self._continuous[channel] ** 2 * 10 * self._heating

    def _share(self, channel: int) -> int:
        """Compute a motor's warmth [1/1000 of the warmth that it bears for ever]."""
        return self.warmth[channel] * 1000 // max(self._bearable(channel), 1)

    def _allowed(self, channel: int) -> int:
        """Compute the largest count of a channel at the present warmth of its motor."""
        most, continuous_counts, bearable = self._most[channel], self._continuous[channel], self._bearable(channel)
        fading_range, margin = bearable // FADING, max(bearable - self.warmth[channel], 0)
        return (
            most if margin >= fading_range else continuous_counts + (most - continuous_counts) * margin // fading_range
        )

    def _zero_torques(self) -> None:
        self.counts, self._requested, self._credit = [0] * CHANNELS, [0] * CHANNELS, 0


def _signed(value: int) -> int:
    return value - SEQUENCES if value >= SEQUENCES // 2 else value


def _check_counts(name: str, counts: Numbers[int], channels: int) -> list[int]:
    if len(counts) != channels:
        raise ValueError(f"{name} has {len(counts)} entries: expected one for each of {channels} channels")
    for k, count in enumerate(counts):
        if not 0 <= count < SEQUENCES // 2:
            raise ValueError(f"{name}[{k}] is {count}: expected 0 to {SEQUENCES // 2 - 1}")
    return [*counts, *(0,) * (CHANNELS - channels)]
