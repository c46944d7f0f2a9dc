"""DOGlove: 16 joint encoders on a main board, and five servos that resist flexion, on a bus of their own.

The servos run in current-based position mode: each goes to the position of the open finger with at most the current
that the guard's torque needs, so that a straight finger is never pulled farther back. Their bus watchdog is on while
they have torque. **What a servo does when its watchdog fires the manual calls a stop**: in a position mode it may hold
its position with up to its last goal current. So a second process takes the torque away when the host dies, and arming
takes a sentence of the user's; after a cut cable only the servos' power switch is sure.

Formats: https://github.com/TEA-Lab/DOGlove (``glove_mcu.py``, ``servo.py``, ``udp_receiver.py``) and
https://github.com/doublehan07/DOGlove_Firmware, as published.
"""

import contextlib
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from jaxgrasp.glove.glove_device import REOPEN, SILENCE, Capability, LinkState, OutlivingDevice, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput, GuardState
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import FINGERS, FLEXIONS, GloveModel
from jaxgrasp.glove.monitors import EncoderWatch, PassivityWatch
from jaxgrasp.glove.other_devices.doglove_board import (
    COUNTS,
    ENCODERS,
    PACE,
    STOPS,
    BoardFrame,
    BoardReader,
    VibrationSender,
    silencing_commands,
)
from jaxgrasp.glove.other_devices.dynamixel import (
    ALERT,
    CONTROL,
    CURRENT_BASED_POSITION,
    IDENTITY,
    SERVO_MODELS,
    TURN,
    WATCHDOG_UNIT,
    Control,
    Identity,
    Register,
    ServoBus,
    Status,
    read_control,
    read_identity,
)
from jaxgrasp.glove.sensors import Encoders, Gauges, Sensors
from jaxgrasp.glove.substitution import Sensations
from jaxgrasp.validation.checked import checked

ACCEPTANCE = "I accept that a servo may hold its position after its cable is cut"
"""Sentence that a user must repeat exactly to arm such a device."""
BOARD_BAUD, SERVO_BAUD = 921_600, 3_000_000

BOARD_ORDER = (
    *("thumb IP", "thumb PIP", "thumb abduction", "thumb rotation"),
    *(f"{finger} {joint}" for finger in FINGERS[1:] for joint in ("DIP", "PIP", "abduction")),
)
"""The main board's encoders in the order of its frame, by the joint that each reads."""
CHANNELS: dict[str, tuple[tuple[int, int], ...]] = {name: ((k, 1),) for k, name in enumerate(BOARD_ORDER)}
CHANNELS |= {f"{finger} MP": ((ENCODERS + servo, 1),) for servo, finger in enumerate(FINGERS)}
# The linkage's thumb bends about three axes in series: CM (its servo's), PIP and IP. A human hand's bends about two.
CHANNELS["thumb CM"] = CHANNELS["thumb MP"]
CHANNELS["thumb MP"] = (*CHANNELS["thumb CM"], (BOARD_ORDER.index("thumb PIP"), -1))
"""Sensors of each joint of a human hand and of the linkage, and the sign with which their counts add up: 0 to 15 are
encoders, 16 to 20 servos."""
SERVO_CHANNELS = {f"{finger} MP": servo for servo, finger in enumerate(FINGERS)} | {"thumb CM": 0}
"""Servo that resists each of these joints."""
_ZERO_DEGREES = {"DIP": 90.0, "IP": 90.0, "PIP": 270.0, "rotation": 270.0, "abduction": 180.0}
_SERVO_ZEROS = (182.2, 165.2, 150.29, 151.44, 145.9)
"""Readings of the straight linkage in the published software [degrees]; each glove differs by how it was assembled."""

WATCHDOG = 2
"""Bus watchdog of the servos in its units of 20 ms: their torque ends 40 ms after the last instruction."""
OPEN_ANGLE = math.radians(-10)
"""Flexion to which a servo pulls a finger at most [rad]: torque fades over the last degrees before it."""
LINKAGE_OPEN_ANGLE = -1.16
"""The same where joints are the linkage's, whose bars rise as a finger straightens: the end of their range [rad]."""
MAX_BOARD_SILENCE, MAX_SERVO_SILENCE = 0.04, 0.03
"""Longest time without a frame of the board, and without an answer of a servo, while the device is armed [s]."""
ARMING = 0.5
"""Longest time for the servos to confirm that they are armed [s]."""
REPEAT = 0.02
"""Time between two attempts to set the servos up [s]."""
TURN_TIME = 0.005
"""Time between two commands, for the damping of fast motion [s]."""
ASK_AGAIN = 0.012
"""Time after which an unanswered question to the servos is given up [s]."""
CURRENT_TOLERANCE, CURRENT_PATIENCE = 60, 0.06
"""Current beyond the goal that a servo may show [mA], and for how long it may show more [s]."""
ASKED_CURRENTS = 4
"""Number of the latest goal currents that a servo may still report."""
MAX_PAUSE = 0.03
"""Time between two turns after which the guard trips [s]: the servos' watchdog may have fired meanwhile."""
_log = logging.getLogger(__name__)


@checked
def doglove() -> GloveModel:
    """Return the model of DOGlove on [`jaxgrasp.hand.human_hand`][]: 19 joints are read, and the five MP resist.

    The limits are ours: 0.3 N.m for moments, about half the stall torque of an XL330-M288 at 5 V, and 0.1 N.m for ever.
    """
    return _model("DOGlove", (*FLEXIONS, *(f"{finger} abduction" for finger in FINGERS)))


@checked
def doglove_linkage() -> GloveModel:
    """Return the model of DOGlove on [`jaxgrasp.hand.doglove_hand`][]: all 21 joints of its linkage are read.

    The five joints of the servos resist, thumb CM and the fingers' MP, with the limits of
    [`jaxgrasp.glove.doglove`][].
    """
    thumb = tuple(f"thumb {kind}" for kind in ("rotation", "abduction", "CM", "PIP", "IP"))
    fingers = (f"{finger} {kind}" for finger in FINGERS[1:] for kind in ("abduction", "MP", "PIP", "DIP"))
    return _model("DOGlove linkage", (*thumb, *fingers))


def _model(name: str, joints: tuple[str, ...]) -> GloveModel:
    has_motor = [joint in SERVO_CHANNELS for joint in joints]
    return GloveModel(
        name,
        joints,
        tuple(0.3 if motor else 0.0 for motor in has_motor),
        rate=3.0,
        quantum=1e-4,
        continuous=tuple(0.1 if motor else 0.0 for motor in has_motor),
    )


def doglove_sensors(model: GloveModel) -> Sensors:
    """Return the published zeros and directions of a right DOGlove, for the channels of a model; calibrate your own.

    Raises:
        ValueError: for a channel that no sensor of the glove reads.
    """
    zeros, slopes = zip(*(_nominal_line(joint) for joint in model.joints), strict=True)
    unit = np.ones(len(model.joints))
    return Sensors(Encoders(np.array(zeros), np.array(slopes)), Gauges(0 * unit, unit, unit))


def _nominal_line(joint: str) -> tuple[float, float]:
    """Return angle at count 0 [rad] and angle per count of a joint."""
    check_joint(joint)
    finger, kind = joint.split(" ", 1)
    if joint in SERVO_CHANNELS:
        straight, sign = _SERVO_ZEROS[SERVO_CHANNELS[joint]], 1
        # The thumb's servo and encoder add up: what the encoder reads straight is taken away.
        straight -= _ZERO_DEGREES["PIP"] if joint == "thumb MP" else 0.0
    else:
        # Ring and little finger count abduction away from the thumb.
        is_turned = kind in ("PIP", "rotation") or (kind == "abduction" and finger not in ("ring", "little"))
        straight, sign = _ZERO_DEGREES[kind], -1 if is_turned else 1
    return -sign * math.radians(straight), sign * math.tau / COUNTS


def check_joint(joint: str) -> None:
    """Check that DOGlove reads a joint.

    Raises:
        ValueError: if no sensor reads it.
    """
    if joint not in CHANNELS:
        raise ValueError(f"DOGlove does not read the joint {joint!r}: expected {', '.join(CHANNELS)}")


class DogloveHost(OutlivingDevice):
    """Host of a DOGlove: the main board's frames and the servos' answers in, goal currents out."""

    capability = Capability("torque", measures_torque=True, outlives_host=True)
    acceptance = ACCEPTANCE
    name_and_remedy = ("the servos", "switch off their power")
    silences_second_line = True

    def __init__(
        self,
        model: GloveModel,
        sensors: Sensors,
        open_line: Callable[[], Line],
        open_board: Callable[[], Line],
        guard: Guard,
        *,
        open_angle: float = OPEN_ANGLE,
    ) -> None:
        """Create a host whose lines are not open yet.

        Args:
            model: channels that the glove reads, with a limit of 0 where it has no servo.
            sensors: calibration of its encoders; the gauges are not used.
            open_line: opens the servos' port; called again after each loss.
            open_board: opens the main board's port; likewise.
            guard: of the model.
            open_angle: angle of its joint to which a servo pulls at most [rad].

        Raises:
            ValueError: for a channel that the glove does not read, or a limit where it has no servo, two channels of
                the thumb's servo, and a calibration by which a servo's turn is not about a turn of its joint.
            ImportError: without the extra ``dynamixel``.
        """
        for joint, limit in zip(model.joints, model.limits, strict=True):
            check_joint(joint)
            if limit > 0 and joint not in SERVO_CHANNELS:
                raise ValueError(f"the limit of {joint} is {limit:g}: expected 0, since DOGlove has no servo there")
        if {"thumb MP", "thumb CM"} <= set(model.joints):
            raise ValueError("the model has thumb MP and thumb CM, which are read from one servo: expected one of them")
        super().__init__(model, open_line, guard)
        self.board = BoardReader()
        self.controls: dict[int, Control] = {}
        """Latest state of each servo, by its id."""
        self.commands = self.held_back = self.vibrations = 0
        """Number of commands while armed, of turns in which the servos' line was busy, and of vibration commands."""
        self._open_board, self._open_angle = open_board, open_angle
        self._board: Line | None = None
        self._encoders = sensors.encoders
        self._bus = ServoBus(range(len(FINGERS)))
        self._mixing: np.ndarray = np.zeros((len(model.joints), ENCODERS + len(FINGERS)), int)
        for k, joint in enumerate(model.joints):
            for sensor, sign in CHANNELS[joint]:
                self._mixing[k, sensor] = sign
        self._motors = {SERVO_CHANNELS[joint]: k for k, joint in enumerate(model.joints) if model.is_resisted[k]}
        self._check_slopes()
        self._signs = {servo: 1 if self._encoders.per_count[k] > 0 else -1 for servo, k in self._motors.items()}
        self._identities: dict[int, Identity] = {}
        self._constants: dict[int, float] = {}
        self._encoder_watch = EncoderWatch(model.joints)
        self._passivity = PassivityWatch(model, TURN_TIME)
        self._goal_positions: dict[int, int] = {}
        self._goal_currents: deque[dict[int, int]] = deque(maxlen=ASKED_CURRENTS)
        self._vibration = VibrationSender()
        self._sent_at = self._arming_since = self._next_setup = -math.inf
        self._reset(-math.inf)
        self._may_hold = False

    def arm(self, timestamp: float, accepted: str = "") -> None:
        if accepted != ACCEPTANCE:
            raise ValueError(f"this glove's servos may outlive the host: to arm it, repeat the sentence {ACCEPTANCE!r}")
        if self.state < LinkState.LINKED:
            raise ValueError(f"the glove cannot be armed: {self.trouble}")
        if not timestamp - self.reading.angles_at <= ARMING:
            raise ValueError("the glove cannot be armed: its encoders send no angles")
        for servo, control in self.controls.items():
            if control.hardware_error:
                raise ValueError(f"the glove cannot be armed: {_hardware_error(servo, control)}")
        self.guard.disarm()
        self._encoder_watch.reset()
        self._passivity.reset()
        self.state, self._arming_since, self._next_setup, self._has_mode = LinkState.ARMING, timestamp, timestamp, False
        self._is_mode_sent, self._set_up_at = False, math.inf
        self._goal_positions = {servo: self._open_position(servo) for servo in self._motors}

    def stop(self, timestamp: float) -> None:
        super().stop(timestamp)
        self._send(timestamp, self._bus.write_all(Register.TORQUE_ENABLE, 1, 0))

    def poll(self, timestamp: float) -> Reading:
        try:
            self._connect(timestamp)
            if self._line is not None and self._board is not None:
                for frame in self.board.feed(self._board.read()):
                    self._handle_frame(timestamp, frame)
                for status in self._bus.feed(self._line.read()):
                    self._handle_status(timestamp, status)
                self._update_angles()
        except LineError as error:
            self._drop_line(timestamp, str(error))
        self._check_silence(timestamp)
        return self.reading

    def send(
        self, timestamp: float, requested: Any, measured_at: float, slope: np.ndarray | None = None
    ) -> GuardOutput:
        if self.state == LinkState.ARMED and timestamp - self._sent_at > MAX_PAUSE:
            self.guard.trip(f"this program was held up for {1e3 * (timestamp - self._sent_at):.0f} ms")
        self._sent_at = timestamp
        output = self.guard.step(timestamp, self._passivity.damp(requested), measured_at)
        if self.state == LinkState.ARMED and self.guard.state != GuardState.ARMED:
            self.state = LinkState.LINKED
        if self._line is not None:
            self._send(timestamp, b"".join(self._instructions(timestamp, output)))
        self._vibrate(timestamp)
        return output

    def sense(self, sensations: Sensations) -> None:
        self._vibration.request(sensations.amplitudes)

    def vibrate(self, finger: int, waveform: int, seconds: float) -> None:
        """Let the vibration actuator of a finger, 0 (thumb) to 4, play a waveform at the next turn.

        The board plays it again each time that so many seconds have passed, until a waveform of 0 or a strength of
        [`jaxgrasp.glove.Sensations`][] that changed.

        Raises:
            ValueError: as ``vibration_command``.
        """
        self._vibration.play(finger, waveform, round(1e3 * seconds))

    def close(self, timestamp: float) -> None:
        # Torque ends first, which the board does not need to hear.
        board, self._board = self._board, None
        super().close(timestamp)
        if board is not None:
            with contextlib.suppress(LineError):
                self.silence(board)
            board.close()

    @staticmethod
    def silence(line: Line) -> None:
        # Each several times, since the board answers nothing, and loses a command that comes with another.
        for k, command in enumerate(STOPS * silencing_commands()):
            if k:
                time.sleep(PACE)
            line.write(command)

    @staticmethod
    def free(line: Line) -> bool:
        bus = ServoBus(range(len(FINGERS)))
        off = bus.write_all(Register.TORQUE_ENABLE, 1, 0)
        # No servo answers a sync write, and an answer on its way may spoil one.
        written = [line.write(off) for _ in range(3)]
        return all(written)

    def status_text(self) -> str:
        """Return the servos' present currents [mA]."""
        currents = [str(self.controls[servo].present_current) for servo in sorted(self.controls)]
        return f"servos {' '.join(currents)} mA" if currents else ""

    def report(self) -> dict[str, Any]:
        return {
            "links": self.links,
            "commands": self.commands,
            "held_back": self.held_back,
            "vibrations": self.vibrations,
            "board": {name: getattr(self.board, name) for name in ("accepted", "refused", "implausible")},
            "servos": {"accepted": self._bus.accepted, "refused": self._bus.refused},
        }

    def _drop_line(self, timestamp: float, trouble: str) -> None:
        """Trip the guard, close both lines, and schedule the next attempt to open the ports."""
        if self._line is not None:
            # It may be the board's line that went, and the servos still hear.
            with contextlib.suppress(LineError):
                self._line.write(self._bus.write_all(Register.TORQUE_ENABLE, 1, 0))
        super()._drop_line(timestamp, trouble)

    def _close_line(self) -> None:
        super()._close_line()
        if self._board is not None:
            self._board.close()
        self._board = None

    def _reset(self, timestamp: float) -> None:
        """Forget what the last link said."""
        self._board_at, self._servo_at = -math.inf, dict.fromkeys(range(len(FINGERS)), -math.inf)
        self._counts: np.ndarray = np.zeros(ENCODERS + len(FINGERS), int)
        self._identities.clear()
        self._constants.clear()
        self.controls.clear()
        self._asked_at, self._asked_identity = -math.inf, False
        self._waits_for: set[int] = set()
        self._answered = dict.fromkeys(range(len(FINGERS)), -math.inf)
        """When the question was asked that each servo answered last [s]."""
        self._sent_at = self._arming_since = self._next_setup = timestamp
        self._set_up_at = math.inf
        self._has_mode = self._is_mode_sent = False
        self._may_hold = True
        self._over_since = dict.fromkeys(range(len(FINGERS)), math.inf)
        self._vibration.forget()

    def _connect(self, timestamp: float) -> None:
        if self._line is not None or timestamp < self._next_attempt:
            return
        self._next_attempt = timestamp + REOPEN
        self._line = self._open()
        self._board = self._open_board()
        self._reset(timestamp)
        self.board = BoardReader()
        self.state, self.trouble = LinkState.GREETING, "the main board and the servos send nothing"

    def _handle_frame(self, timestamp: float, frame: BoardFrame) -> None:
        self._board_at = timestamp
        self._counts[:ENCODERS] = frame.counts()

    def _handle_status(self, timestamp: float, status: Status) -> None:
        self._waits_for.discard(status.servo)
        if len(status.parameters) == IDENTITY.length:
            self._identities[status.servo] = read_identity(status.parameters)
            return
        control = read_control(status.parameters)
        self._servo_at[status.servo], self._answered[status.servo] = timestamp, self._asked_at
        self.controls[status.servo] = control
        self._counts[ENCODERS + status.servo] = control.present_position * (COUNTS // TURN)
        self._may_hold = any(control.torque_enable for control in self.controls.values())
        if self.state == LinkState.ARMED and (fault := self._servo_fault(timestamp, status, control)):
            self.guard.trip(fault)

    def _update_angles(self) -> None:
        """Compute the angles once every sensor has been read; they are as old as the oldest."""
        read_at = min(self._board_at, *self._servo_at.values())
        if not math.isfinite(read_at):
            return
        angles = self._encoders.angles(self._mixing @ self._counts)
        # Encoders and servos turn on over a full turn: the joint does not.
        angles = (angles + math.pi) % math.tau - math.pi
        torques = np.zeros(len(angles))
        for servo, k in self._motors.items():
            current = self.controls[servo].present_current
            torques[k] = -self._signs[servo] * 1e-3 * current * self._constants.get(servo, 0.0)
        is_new = read_at > self.reading.angles_at
        self.reading = replace(
            self.reading, angles=angles, angles_at=read_at, torques=torques, torques_at=min(self._servo_at.values())
        )
        if self.state == LinkState.ARMED and is_new:
            fault = self._encoder_watch.fault(read_at, angles) or self._passivity.update(read_at, angles)
            if fault:
                self.guard.trip(fault)

    def _check_silence(self, timestamp: float) -> None:
        """Trip the guard, and later lose the link, if the board or a servo sends nothing."""
        silences = {"the main board": (timestamp - self._board_at, MAX_BOARD_SILENCE)}
        silences |= {f"servo {servo}": (timestamp - at, MAX_SERVO_SILENCE) for servo, at in self._servo_at.items()}
        if self.state == LinkState.GREETING:
            self._greet(timestamp, [name for name, (silence, _) in silences.items() if silence > SILENCE])
            return
        for name, (silence, longest) in silences.items():
            if self.state >= LinkState.LINKED and silence > longest:
                self.guard.trip(f"{name} fell silent")
            if self.state >= LinkState.LINKED and silence > SILENCE:
                self.state, self.trouble = LinkState.GREETING, f"{name} fell silent"
                self._identities.clear()
        if self.state == LinkState.ARMING and timestamp - self._arming_since > ARMING:
            self.state = LinkState.GREETING
            self.trouble = f"the servos did not confirm that they are armed: {self._unconfirmed()}"

    def _greet(self, timestamp: float, silent: list[str]) -> None:
        """Establish the link once the board and all servos are heard, and the servos are of a known type."""
        for servo, identity in self._identities.items():
            if identity.model_number not in SERVO_MODELS:
                known = ", ".join(f"{number} ({model.name})" for number, model in SERVO_MODELS.items())
                self.trouble = f"servo {servo} has the model number {identity.model_number}: expected {known}"
                return
            self._constants[servo] = SERVO_MODELS[identity.model_number].torque_constant
        if silent:
            self.trouble = f"nothing is heard of {', '.join(silent)}"
        elif len(self._identities) == len(FINGERS) and math.isfinite(self.reading.angles_at):
            self.state, self.trouble = LinkState.LINKED, ""
            self.links += 1

    def _instructions(self, timestamp: float, output: GuardOutput) -> Iterable[bytes]:
        """Yield the instruction packets of this turn."""
        bus = self._bus
        if self.state == LinkState.ARMING and timestamp >= self._next_setup:
            yield from self._setup(timestamp)
        elif self.state == LinkState.ARMED:
            currents = self._currents(output)
            self._goal_currents.append(currents)
            self.commands += 1
            self._passivity.commanded(timestamp, output.torques)
            yield bus.write(Register.GOAL_CURRENT, 2, currents)
        elif self.state != LinkState.ARMING:
            yield bus.write_all(Register.TORQUE_ENABLE, 1, 0)
        if not self._waits_for or timestamp - self._asked_at > ASK_AGAIN:
            is_identity_due = len(self._identities) < len(FINGERS)
            is_mode_due = self.state == LinkState.ARMING and not self._has_mode
            # Both blocks in turn, until all is known.
            asks_identity = (is_identity_due or is_mode_due) and not self._asked_identity
            self._asked_identity = asks_identity
            self._asked_at, self._waits_for = timestamp, set(range(len(FINGERS)))
            yield bus.ask(IDENTITY if asks_identity else CONTROL)

    def _setup(self, timestamp: float) -> Iterable[bytes]:
        """Yield what sets the servos up, in two steps; the answers tell when a step is done."""
        bus, motors = self._bus, self._motors
        self._next_setup = timestamp + REPEAT
        if not self._has_mode:
            modes = {identity.operating_mode for identity in self._identities.values()}
            self._has_mode = self._is_mode_sent and modes == {CURRENT_BASED_POSITION}
        if not self._has_mode:
            self._is_mode_sent = True
            # The mode can change only without torque, and 0 clears a watchdog that has fired.
            yield bus.write_all(Register.TORQUE_ENABLE, 1, 0)
            yield bus.write_all(Register.BUS_WATCHDOG, 1, 0)
            yield bus.write_all(Register.OPERATING_MODE, 1, CURRENT_BASED_POSITION)
            return
        if not self._unconfirmed():
            self.state = LinkState.ARMED
            self._goal_currents.clear()
            self._goal_currents.append(dict.fromkeys(motors, 0))
            self._sent_at = timestamp
            self.guard.arm(timestamp)
            _log.warning("armed a glove whose servos may hold their position if their cable is cut")
            return
        self._set_up_at = min(self._set_up_at, timestamp)
        yield bus.write_all(Register.GOAL_CURRENT, 2, 0)
        yield bus.write_all(Register.BUS_WATCHDOG, 1, WATCHDOG)
        yield bus.write(Register.TORQUE_ENABLE, 1, dict.fromkeys(motors, 1))
        # After the torque is on, which sets the goal to the present position; the goal current is zero.
        yield bus.write(Register.GOAL_POSITION, 4, self._goal_positions)

    def _unconfirmed(self) -> str:
        """Return what a servo has not confirmed of its setup; empty if all have."""
        if not self._has_mode:
            return f"a servo is not in the operating mode {CURRENT_BASED_POSITION}"
        for servo in self._motors:
            if not self._answered[servo] >= self._set_up_at:
                return f"servo {servo} has not answered"
            control = self.controls[servo]
            expected = {
                "torque_enable": 1,
                "bus_watchdog": WATCHDOG,
                "goal_current": 0,
                "goal_position": self._goal_positions.get(servo),
                "hardware_error": 0,
            }
            for name, value in expected.items():
                if getattr(control, name) != value:
                    return f"servo {servo} has {name} {getattr(control, name)}: expected {value}"
        return ""

    def _servo_fault(self, timestamp: float, status: Status, control: Control) -> str:
        """Check an answer of a servo that has torque; return the description of a fault."""
        servo = status.servo
        if status.error & ALERT or control.hardware_error:
            return _hardware_error(servo, control)
        if servo not in self._motors:
            return f"servo {servo} has torque, and no channel of the model" if control.torque_enable else ""
        if control.bus_watchdog != WATCHDOG:
            fired = f"the watchdog of servo {servo} fired after {1e3 * WATCHDOG * WATCHDOG_UNIT:.0f} ms"
            return fired if control.bus_watchdog < 0 else f"the watchdog of servo {servo} is {control.bus_watchdog}"
        if not control.torque_enable:
            return f"servo {servo} let go by itself: it may have restarted"
        if control.goal_position != self._goal_positions[servo]:
            return f"servo {servo} has another goal position than it was given"
        largest = max(currents.get(servo, 0) for currents in self._goal_currents)
        if control.goal_current > largest:
            return f"servo {servo} has a goal current of {control.goal_current} mA: expected at most {largest}"
        is_over = abs(control.present_current) > largest + CURRENT_TOLERANCE
        self._over_since[servo] = min(self._over_since[servo], timestamp) if is_over else math.inf
        if timestamp - self._over_since[servo] > CURRENT_PATIENCE:
            return f"servo {servo} draws {control.present_current} mA: expected at most {largest}"
        return ""

    def _currents(self, output: GuardOutput) -> dict[int, int]:
        """Compute the goal current of each servo [mA], rounded down, so that no torque exceeds the guard's."""
        return {
            servo: int(1e3 * output.torques[k] / self._constants[servo]) if output.state == GuardState.ARMED else 0
            for servo, k in self._motors.items()
        }

    def _open_position(self, servo: int) -> int:
        """Compute the position of a servo at its open angle, nearest to where it is now."""
        k = self._motors[servo]
        # From the present angle and position, since a servo may count turns.
        present = self.controls[servo].present_position
        angle = float(self.reading.angles[k])
        for sensor, sign in CHANNELS[self.model.joints[k]]:
            if sensor < ENCODERS:
                # What the thumb's encoder adds is not the servo's.
                part = sign * math.tau * (self._counts[sensor] / COUNTS - _ZERO_DEGREES["PIP"] / 360)
                angle -= (part + math.pi) % math.tau - math.pi
        change = (self._open_angle - angle) / float(self._encoders.per_count[k])
        return present + round(change * TURN / COUNTS)

    def _check_slopes(self) -> None:
        for servo, k in self._motors.items():
            slope = float(self._encoders.per_count[k])
            if not 0.5 < abs(slope) * COUNTS / math.tau < 2:
                raise ValueError(
                    f"the calibration of {self.model.joints[k]} has {slope:g} rad for a count: expected about "
                    f"{math.tau / COUNTS:.3g} or its negative, {COUNTS} counts for a turn of servo {servo}"
                )

    def _send(self, timestamp: float, data: bytes) -> None:
        if self._line is None:
            return
        try:
            # What waits in a line that is stuck would come late, and keep the servos' watchdog quiet.
            if self._line.is_free():
                self._line.write(data)
            else:
                self.held_back += 1
        except LineError as error:
            self._drop_line(timestamp, str(error))

    def _vibrate(self, timestamp: float) -> None:
        if self._board is None:
            return
        if self.guard.state == GuardState.LATCHED:
            self._vibration.request(np.zeros(len(FINGERS)))
        command = self._vibration.due(timestamp)
        if command is None:
            return
        try:
            self._board.write(command)
            self.vibrations += 1
        except LineError as error:
            self._drop_line(timestamp, str(error))


def _hardware_error(servo: int, control: Control) -> str:
    return f"servo {servo} reports the hardware error {control.hardware_error:#04x} (voltage, heat, overload)"
