"""Host side of the native protocol: greet, arm, command and read; the torque is zero after any fault."""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import REOPEN, SILENCE, Capability, GloveDevice, LinkState, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput, GuardState
from jaxgrasp.glove.line import Line, LineError, Pace
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.monitors import EncoderWatch, PassivityWatch, TensionWatch
from jaxgrasp.glove.protocol.device import MAX_AMPLITUDE, N_FINGERS, REASONS, Cause, DeviceState
from jaxgrasp.glove.protocol.frames import (
    CHANNELS,
    LINE_SIZE,
    NO_FLAGS,
    SEQUENCES,
    TICKS,
    Flag,
    Frame,
    FrameReader,
    Kind,
    PeerClock,
    RoundTrip,
    Sequence,
    encode,
)
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.glove.substitution import Sensations, SensationSender

REPEAT = 0.05
"""Time between attempts to greet and to arm [s], on a fast line."""
ARMING = 0.5
"""Longest time for a device to confirm that it is armed [s]."""
MAX_SILENCE = 0.025
"""Longest time without angles on a fast line [s]: with the frames on their way then, torque ends within 55 ms."""
MAX_SILENT_FRAMES = 6
"""The same limit for a slow line, in frames: at most two other frames lie between two frames of angles."""
OLDEST_TENSION = 0.15
"""Largest age of the measured tensions while the device is armed [s]."""
LONGEST_WATCHDOG = 50
"""Longest watchdog time of a device that may be armed [ms]."""
LONGEST_WAIT = 0.013
"""Longest time that a frame and its answer may wait on their way, in addition to their transfer time [s]."""
TRIP_WINDOW = 0.06
"""Time of which the shortest round trip counts [s]: longer than a program that is held up reads frames late, since it
latches after 25 ms without angles."""
SESSIONS = 2**15
RECENT_FRAMES = 100
"""Number of recent frames that are kept, of both directions together: a quarter of a second."""
BOUNDS = (Kind.LIMITS, Kind.CONTINUOUS)
"""Kinds of frames that must follow a CAPABILITY before a device may be armed."""
DEVICE_KINDS = (Kind.ANGLES, Kind.TENSIONS, Kind.STATUS, Kind.SKIN)
"""Kinds of frames that only a device sends: a line that echoes returns the host's own frames."""


@dataclass
class HostCounts:
    """Counters of a host since it was created."""

    commands: int = 0
    """Number of commands sent."""
    sensations: int = 0
    """Number of VIBRATE and HEAT frames sent."""
    held_back: int = 0
    """Number of frames not sent because the line was busy."""
    cut: int = 0
    """Number of frames of which the line took only a part."""
    links: int = 0
    """Number of handshakes that succeeded."""
    missing: int = 0
    """Number of device frames lost in earlier sessions; ``GloveHost.order`` counts those of the current session."""
    status: dict[str, int] = field(default_factory=dict)
    """Counters of the device in this session, from its last STATUS."""


class GloveHost(GloveDevice):
    """Host of a glove that speaks the native protocol."""

    capability = Capability("torque", measures_torque=True, outlives_host=False)

    def __init__(
        self,
        model: GloveModel,
        sensors: Sensors,
        open_line: Callable[[], Line],
        guard: Guard,
        *,
        baud: int = 115_200,
        watch: TensionWatch | None = None,
        longest_wait: float = LONGEST_WAIT,
    ):
        """Create a host that has not opened its line yet.

        Args:
            model: the glove.
            sensors: its calibration.
            open_line: opens the port; called again after each loss.
            guard: bounds what is sent; its state is the host's.
            baud: of the line, by which frames are spaced.
            watch: compares measured with commanded torques; the usual tolerances if None.
            longest_wait: how long a command and its answer may wait on their way, beside the time that two frames take
                [s]; beyond that no torque flows.

        Raises:
            ValueError: for a model with more channels than a frame holds, or with channels that have no motor.
        """
        if len(model.joints) > CHANNELS:
            raise ValueError(f"the model has {len(model.joints)} channels: expected at most {CHANNELS}")
        if not all(model.is_resisted):
            joint = model.joints[model.is_resisted.index(False)]
            raise ValueError(f"the model's limit of {joint} is 0: expected a motor at every channel of a native glove")
        self.model, self.guard = model, guard
        self.state = LinkState.CLOSED
        self.trouble = "not opened yet"
        self.counts = HostCounts()
        self.reader = FrameReader()
        self.order = Sequence()
        self.reading = Reading.empty(len(model.joints))
        self._sensors, self._open = sensors, open_line
        self._watch = TensionWatch(len(model.joints)) if watch is None else watch
        self._encoder_watch = EncoderWatch(model.joints)
        self._pace = Pace(baud, LINE_SIZE)
        self._passivity = PassivityWatch(model, 1.5 * self._pace.frame_time)
        # There, and three frames back, each way after a frame that is already on it, and a turn.
        self._repeat = max(REPEAT, 7 * self._pace.frame_time)
        self._patience = max(ARMING, 4 * self._repeat)
        self._line: Line | None = None
        self._number, self._ticks = random.randrange(SEQUENCES), 0
        self._session = self._nonce = 0
        self._pending_bounds: list[Kind] = []
        self._clock = PeerClock(self._pace.frame_time)
        self.round_trip = RoundTrip(TRIP_WINDOW)
        """Estimator of the time until a frame of the device answers a frame of the host."""
        self._longest_trip = 2 * self._pace.frame_time + longest_wait
        self._device_clock = 0
        self._max_silence = max(MAX_SILENCE, MAX_SILENT_FRAMES * self._pace.frame_time)
        self._next_attempt = self._arming_since = self._last_frame_at = self._angles_arrived_at = -np.inf
        self._is_greeted = self._is_stopping = False
        self._flags, self._cause = NO_FLAGS, int(Cause.NONE)
        self._was_cut = False
        self._sensations = SensationSender()
        self.sensation_trouble = ""
        """Reason why the device's vibration and heat channels are not used; empty if they are, or it has none."""
        self.skin = Sensations.none()
        """Amplitudes that the device says it drives, and temperatures of its heat channels [deg C]."""
        self._recent_frames: deque[tuple[float, str, Frame]] = deque(maxlen=RECENT_FRAMES)

    def arm(self, timestamp: float, accepted: str = "") -> None:
        if self.state < LinkState.LINKED:
            raise ValueError(f"the glove cannot be armed: {self.trouble}")
        if not timestamp - self.reading.angles_at <= ARMING:
            raise ValueError("the glove cannot be armed: its encoders send no angles")
        if not timestamp - self.reading.torques_at <= ARMING:
            raise ValueError("the glove cannot be armed: its strain gauges send no tensions")
        if Flag.PRESSED in self._flags:
            raise ValueError("the glove cannot be armed: its emergency stop is pressed")
        self.state, self._arming_since, self._next_attempt, self._is_greeted = (
            LinkState.ARMING,
            timestamp,
            timestamp,
            False,
        )
        self._is_stopping = False
        self._session = random.randrange(SESSIONS)
        self.guard.disarm()
        self._watch.reset()
        self._encoder_watch.reset()
        self._passivity.reset()

    def stop(self, timestamp: float) -> None:
        """Execute the emergency stop: latch the guard and send STOP to the device until it confirms."""
        super().stop(timestamp)
        self._is_stopping = True
        self._send(timestamp, Kind.STOP, ())

    def poll(self, timestamp: float) -> Reading:
        try:
            self._connect(timestamp)
            if self._line is not None:
                for frame in self.reader.feed(self._line.read()):
                    self._handle_frame(timestamp, frame)
        except LineError as error:
            self._drop_line(timestamp, str(error))
        if self.state == LinkState.ARMED:
            self._check_link(timestamp)
        self._check_timeouts(timestamp)
        return self.reading

    def send(
        self, timestamp: float, requested: Any, measured_at: float, slope: np.ndarray | None = None
    ) -> GuardOutput:
        output = self.guard.step(timestamp, self._passivity.damp(requested), measured_at)
        if self.guard.state != GuardState.ARMED and self.state == LinkState.ARMED:
            self.state = LinkState.LINKED
        if self.state == LinkState.ARMING:
            self._request_arming(timestamp)
        elif self._is_stopping:
            # However often it takes: a device stops where it hears it, whatever else is on the line.
            self._send(timestamp, Kind.STOP, ())
        elif self.state >= LinkState.LINKED:
            sensation = self._sensations.due(timestamp)
            if sensation is None:
                self._command(timestamp, output)
            elif self._send(timestamp, *sensation):
                self._sensations.sent(timestamp, *sensation)
                self.counts.sensations += 1
        return output

    @property
    def channels_of_sensations(self) -> tuple[int, int]:
        """Return the numbers of vibration and of heat channels that are used; 0 before a link."""
        return self._sensations.vibrators, self._sensations.heaters

    def sense(self, sensations: Sensations) -> None:
        self._sensations.request(sensations)

    def close(self, timestamp: float) -> None:
        self.disarm()
        if self._line is None:
            return
        try:
            # Not by the pace: a second one for a first that comes right after half a frame.
            for _ in range(2):
                self._line.write(b"\0" + self._encode_frame(timestamp, Kind.COMMAND, (), NO_FLAGS))
        except LineError as error:
            self.trouble = str(error)
        self._line.close()
        self._line, self.state = None, LinkState.CLOSED

    def report(self) -> dict[str, Any]:
        refused = {error.name: count for error, count in self.reader.refused.items()}
        counts = {"commands": self.counts.commands, "sensations": self.counts.sensations}
        counts |= {"vibrators": self._sensations.vibrators, "heaters": self._sensations.heaters}
        counts |= {"held_back": self.counts.held_back, "cut": self.counts.cut}
        received = {
            "heard": self.reader.accepted,
            "missing": self.counts.missing + self.order.missing,
            "refused": refused,
        }
        return counts | received | {"links": self.counts.links, "device": self.counts.status}

    def last_frames(self) -> list[dict[str, Any]]:
        return [
            {"at": at, "way": direction, **vars(frame), "kind": frame.kind.name, "flags": int(frame.flags)}
            for at, direction, frame in self._recent_frames
        ]

    def _request_arming(self, timestamp: float) -> None:
        """Ask for torque, in a new session: however many frames were lost before, the device counts anew."""
        if timestamp < self._next_attempt:
            return
        self._next_attempt = timestamp + self._repeat
        if self._is_greeted:
            self._send(timestamp, Kind.ARM, (self._session, self._nonce))
        else:
            self._greet(timestamp)

    def _greet(self, timestamp: float) -> None:
        self._send(timestamp, Kind.HELLO, (self._session,))

    def _check_timeouts(self, timestamp: float) -> None:
        """Lose patience with a device that says nothing, or does not agree."""
        if self.state >= LinkState.LINKED and timestamp - self._last_frame_at > SILENCE:
            trouble = "the device fell silent"
        elif self.state == LinkState.ARMING and timestamp - self._arming_since > self._patience:
            trouble = "the device did not confirm that it is armed"
        else:
            return
        self.guard.trip(trouble)
        self.state, self.trouble, self._next_attempt = LinkState.GREETING, trouble, timestamp
        self._session = random.randrange(SESSIONS)

    def _command(self, timestamp: float, output: GuardOutput) -> None:
        is_armed = self.state == LinkState.ARMED
        values = tuple(int(count) for count in output.counts)
        if self._send(timestamp, Kind.COMMAND, values, Flag.ENABLE if is_armed else NO_FLAGS):
            self.counts.commands += 1
            if is_armed:
                self._watch.commanded(timestamp, output.torques)
                self._encoder_watch.commanded(output.torques)
                self._passivity.commanded(timestamp, output.torques)

    def _connect(self, timestamp: float) -> None:
        if self.state > LinkState.GREETING or timestamp < self._next_attempt:
            return
        if self._line is None:
            self._next_attempt = timestamp + REOPEN
            self._line = self._open()
            self.state, self.trouble = LinkState.GREETING, "the device does not answer"
            self._session = random.randrange(SESSIONS)
        self._next_attempt = timestamp + self._repeat
        self._greet(timestamp)

    def _send(self, timestamp: float, kind: Kind, values: tuple[int, ...], flags: Flag = NO_FLAGS) -> bool:
        """Send a frame and return True if the line took it; a frame that finds the line busy is dropped."""
        if self._line is None:
            return False
        try:
            if not (self._pace.is_free(timestamp) and self._line.is_free()):
                self.counts.held_back += 1
                return False
            # After part of a frame, a zero ends it, or the next one would be lost with it.
            data = b"\0" * self._was_cut + self._encode_frame(timestamp, kind, values, flags)
            self._was_cut = not self._line.write(data)
        except LineError as error:
            self._drop_line(timestamp, str(error))
            return False
        self.counts.cut += self._was_cut
        self._pace.sent(timestamp)
        return not self._was_cut

    def _encode_frame(self, timestamp: float, kind: Kind, values: tuple[int, ...], flags: Flag) -> bytes:
        self._number = (self._number + 1) % SEQUENCES
        # Two frames of one instant would be one and the same to a device.
        self._ticks = max(int(timestamp * 1e6), self._ticks + 1)
        padded = values + (0,) * (CHANNELS - len(values))
        frame = Frame(kind, self._number, self._ticks % TICKS, padded, flags, self._device_clock)
        self._recent_frames.append((timestamp, "out", frame))
        return encode(frame)

    def _handle_frame(self, timestamp: float, frame: Frame) -> None:
        self._recent_frames.append((timestamp, "in", frame))
        if frame.kind == Kind.CAPABILITY:
            self._handle_capability(timestamp, frame)
        elif frame.kind in self._pending_bounds and self.order.is_new(frame.sequence):
            self._handle_bounds(timestamp, frame)
        elif self.state >= LinkState.LINKED and frame.kind in DEVICE_KINDS and self.order.is_new(frame.sequence):
            self._handle_data(timestamp, frame)

    def _handle_capability(self, timestamp: float, frame: Frame) -> None:
        """Take a CAPABILITY frame: accept the device if its limits agree with the model, else set ``trouble``."""
        session, channels, watchdog, quantum, max_count, slew, nonce, heating_constant = frame.values[:8]
        self._pending_bounds = []
        if self.state not in (LinkState.GREETING, LinkState.ARMING) or session != self._session:
            return
        expected = round(self.model.quantum * 1e7)
        if quantum != expected:
            self.trouble = (
                f"the device's torque per count is {quantum}e-7 N.m: expected {expected}e-7 N.m for {self.model.name}"
            )
        elif channels < len(self.model.joints):
            self.trouble = (
                f"the device has {channels} channels: expected at least {len(self.model.joints)} for {self.model.name}"
            )
        elif not 0 < watchdog <= LONGEST_WATCHDOG:
            self.trouble = f"the device's watchdog is {watchdog} ms: expected 1 to {LONGEST_WATCHDOG}"
        elif not 0 < max_count <= max(self.model.max_counts):
            self.trouble = f"the device allows {max_count} counts: expected at most {max(self.model.max_counts)}"
        elif not 0 < slew <= round(self.model.rate / self.model.quantum / 1000):
            self.trouble = f"the device changes by {slew} counts/ms: expected at most {self.model.rate:g} N.m/s"
        elif self.model.continuous is not None and not 0 < heating_constant % SEQUENCES <= round(
            100 * self.model.heating
        ):
            self.trouble = (
                f"the device's motors warm in {heating_constant % SEQUENCES / 100:g} s: expected {self.model.heating:g}"
            )
        else:
            self.trouble, self._pending_bounds = "the device has not reported all of its limits", list(BOUNDS)
            self._flags = frame.flags & Flag.PRESSED
            self._last_frame_at = timestamp
            self.counts.missing += self.order.missing
            self.order = Sequence(frame.sequence)
            self._clock = PeerClock(self._pace.frame_time)
            self.round_trip = RoundTrip(TRIP_WINDOW)
            self._nonce, self._device_clock = nonce, frame.clock
            self.sensation_trouble, self.skin = self._sensations.learn(frame.values[8:13]), Sensations.none()

    def _handle_bounds(self, timestamp: float, frame: Frame) -> None:
        """Take a frame of each channel's bounds; after the last one, the link is established."""
        self._pending_bounds.remove(frame.kind)
        is_peak = frame.kind == Kind.LIMITS
        bounds = self.model.max_counts if is_peak else self.model.continuous_counts
        for joint, count, max_count in zip(self.model.joints, frame.values, bounds, strict=False):
            if not 0 <= count <= max_count:
                suffix = "" if is_peak else " continuously"
                self.trouble = f"the device allows {count} counts{suffix} at {joint}: expected at most {max_count}"
                self._pending_bounds = []
                return
        self._last_frame_at, self._device_clock = timestamp, frame.clock
        if self._pending_bounds:
            return
        if self.state == LinkState.GREETING:
            self.state = LinkState.LINKED
            self.counts.links += 1
        # Whatever the device said before, it has no torque now; an answer to ARM can only come after this.
        self.trouble, self._is_greeted, self._next_attempt = "", True, timestamp

    def _handle_data(self, timestamp: float, frame: Frame) -> None:
        trip = (int(timestamp * 1e6) - frame.echo) % TICKS * 1e-6
        self.round_trip.add(timestamp, trip)
        sent_at = self._clock.sent_at(frame.clock, timestamp, trip)
        self._last_frame_at, self._device_clock = timestamp, frame.clock
        self._flags, self._cause = frame.flags, frame.cause
        counts = np.array(frame.values[: len(self.model.joints)])
        if frame.kind == Kind.ANGLES:
            self._angles_arrived_at = timestamp
            self.reading.angles, self.reading.angles_at = self._sensors.encoders.angles(counts), sent_at
            if self.state == LinkState.ARMED:
                self._check_angles(sent_at)
        elif frame.kind == Kind.TENSIONS:
            self.reading.torques, self.reading.saturated = self._sensors.gauges.torques(counts)
            self.reading.torques_at = sent_at
            if self.state == LinkState.ARMED:
                self._check_tension(sent_at)
        elif frame.kind == Kind.SKIN:
            felt = np.array(frame.values[: 2 * N_FINGERS])
            self.skin = Sensations(felt[:N_FINGERS] / MAX_AMPLITUDE, felt[N_FINGERS:] / 100)
        elif frame.kind == Kind.STATUS:
            self.counts.status = read_status(frame.values)
            channel, warmth = frame.values[12:]
            self.guard.learn_warmth(channel, warmth / 1000)
        self._update_state(timestamp)

    def _update_state(self, timestamp: float) -> None:
        """Update the link and the guard from the state and cause that the device reports."""
        is_enabled = Flag.ENABLE in self._flags
        is_stopped = Flag.LATCHED in self._flags and self._cause == Cause.STOPPED
        self._is_stopping = self._is_stopping and not is_stopped
        if self.state == LinkState.ARMING and is_enabled and self._is_greeted:
            self.state = LinkState.ARMED
            self.guard.arm(timestamp)
            # Its answers to a greeting took the place of angles.
            self._angles_arrived_at = timestamp
        elif self.state == LinkState.ARMED and not is_enabled:
            self.guard.trip(self._disabled_reason())
            self.state = LinkState.LINKED
        elif is_stopped and Flag.PRESSED in self._flags and self.guard.state != GuardState.LATCHED:
            self.guard.stop(self._disabled_reason())

    def _disabled_reason(self) -> str:
        if Flag.LATCHED not in self._flags:
            return "the device is not armed"
        return f"the device latched: {REASONS.get(self._cause, f'cause {self._cause}')}"

    def _check_link(self, timestamp: float) -> None:
        """Trip the guard if angles or tensions are missing or too old, or if the round trip takes too long."""
        if timestamp - self._angles_arrived_at > self._max_silence:
            is_device_heard = timestamp - self._last_frame_at <= self._max_silence
            self.guard.trip("the encoders fell silent" if is_device_heard else "the device fell silent")
        if timestamp - self.reading.torques_at > OLDEST_TENSION:
            self.guard.trip("the strain gauges fell silent")
        trip = self.round_trip.shortest(timestamp)
        if trip > self._longest_trip:
            self.guard.trip(
                f"the line's round trip takes {1e3 * trip:.0f} ms: expected at most {1e3 * self._longest_trip:.0f} ms"
            )

    def _check_angles(self, at: float) -> None:
        angles = self.reading.angles
        fault = self._encoder_watch.fault(at, angles) or self._passivity.update(at, angles)
        if fault:
            self.guard.trip(fault)

    def _check_tension(self, at: float) -> None:
        torques = self.reading.torques
        fault = self._watch.fault(at, torques, self.reading.saturated) or self._encoder_watch.stands_still(at, torques)
        if fault:
            self.guard.trip(fault)


def read_status(values: tuple[int, ...]) -> dict[str, int]:
    """Decode the values of a STATUS frame into counters by name; state and cause are codes, -1 if unknown."""
    halves = [value % 2**16 for value in values[3:11]]
    counters = [low + 2**16 * high for low, high in zip(halves[::2], halves[1::2], strict=True)]
    numbers = dict(zip(("accepted", "missing", "stale", "refused"), counters, strict=True))
    codes = {
        "state": values[1] if values[1] in DeviceState._value2member_map_ else -1,
        "cause": values[2] if values[2] in Cause._value2member_map_ else -1,
    }
    return codes | numbers | {"newest": values[11] % 2**16}
