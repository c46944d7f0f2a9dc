r"""OpenGloves' driver on Windows: limits to its force-feedback pipe, and a glove's joints to its input pipe.

The driver makes both pipes, one for each hand, and reads them:

- ``\\.\pipe\vrapplication\ffb\curl\right``: five int16, thumb to little finger, 0 (free) to 1000 (no curl at all);
- ``\\.\pipe\vrapplication\input\glove\v2\right``: 20 float32 flexions (five fingers of four joints from the palm, 0 to
  1), five float32 splays (-1 to 1), two of the joystick, eight buttons of a byte each, and a float32 trigger.

It tells nobody what its glove reads but SteamVR, and so the applications of an OpenXR runtime: that is where the joints
come from here, as records of [`jaxgrasp.glove.OpenXRHost`][]. **A limit stays in force when its host dies**, as with
LucidGloves, so arming takes the same sentence and a second process frees the fingers.

Formats: https://github.com/LucidVR/opengloves-driver (``input_force_feedback_named_pipe.cpp``,
``named_pipe_communication_manager.cpp``), as published.
"""

import contextlib
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.glove_device import REOPEN, LinkState, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput
from jaxgrasp.glove.line import WINDOWS_PIPES, Line, LineError
from jaxgrasp.glove.model import FINGERS, FIST, GloveModel
from jaxgrasp.glove.other_devices.lucidgloves import REPETITIONS, FingerLimitDevice, position_limits
from jaxgrasp.glove.other_devices.openxr import RecordReader, hand_angles

_CURLS = struct.Struct("<5h")
_INPUT = struct.Struct("<20f5f2f8?f")
MAX_SPLAY = math.radians(20)
"""Abduction that counts as a whole splay [rad]: ours, since the driver does not say."""


def force_pipe(hand: str = "right") -> str:
    r"""Return the name of the force-feedback pipe of a hand, ``"right"`` or ``"left"``."""
    return f"{WINDOWS_PIPES}vrapplication\\ffb\\curl\\{hand}"


def input_pipe(hand: str = "right") -> str:
    r"""Return the name of the input pipe of a hand, ``"right"`` or ``"left"``."""
    return f"{WINDOWS_PIPES}vrapplication\\input\\glove\\v2\\{hand}"


def encode_limits(limits: tuple[int, int, int, int, int]) -> bytes:
    """Encode the limits of thumb to little finger, 0 to 1000, for the force-feedback pipe.

    Raises:
        ValueError: for a limit outside this range.
    """
    for finger, limit in zip(FINGERS, limits, strict=True):
        if not 0 <= limit <= 1000:
            raise ValueError(f"the limit of the {finger} is {limit}: expected 0 to 1000")
    return _CURLS.pack(*limits)


def encode_input(angles: Mapping[str, float]) -> bytes:
    """Encode joint angles for the input pipe; the joystick rests, and no button is pressed.

    Args:
        angles: of joints of [`jaxgrasp.hand.human_hand`][] [rad], by name; one that is missing or not finite is 0.
    """

    def share(joint: str, full: float) -> float:
        angle = angles.get(joint, 0.0)
        return min(max(angle / full, -1.0), 1.0) if math.isfinite(angle) else 0.0

    flexions: list[float] = []
    for finger in FINGERS:
        bends = [max(share(joint, full), 0.0) for joint, full in _fist(finger).items()]
        # The first joint is the metacarpal's, which these gloves do not read; the thumb has one joint less.
        flexions += [0.0, *bends, *[0.0] * (3 - len(bends))]
    splays = [share(f"{finger} abduction", MAX_SPLAY) for finger in FINGERS]
    return _INPUT.pack(*flexions, *splays, 0.0, 0.0, *[False] * 8, 0.0)


def finger_curls(angles: Mapping[str, float]) -> Float[np.ndarray, "5"]:
    """Compute the curls of thumb to little finger, 0 to 1: their joints' flexion as a share of a fist's."""
    curls = []
    for finger in FINGERS:
        fist = _fist(finger)
        curls.append(min(max(sum(angles[joint] for joint in fist) / sum(fist.values()), 0.0), 1.0))
    return np.array(curls)


def _fist(finger: str) -> dict[str, float]:
    """Return the flexions of a finger in a fist [rad], by joint, from the palm."""
    joints = [f"{finger} {kind}" for kind in (("MP", "IP") if finger == "thumb" else ("MP", "PIP", "DIP"))]
    return {joint: math.radians(FIST.get(joint, FIST.get(joint.split()[1], 0))) for joint in joints}


class OpenGlovesHost(FingerLimitDevice):
    """Host of a glove behind OpenGloves' driver: hand-tracking records in, limits out."""

    name_and_remedy = ("the glove", "switch off its power")

    def __init__(
        self,
        model: GloveModel,
        open_line: Callable[[], Line],
        open_records: Callable[[], Line],
        guard: Guard,
        *,
        hand: str = "right",
        give: float = 0.3,
    ) -> None:
        """Create a host whose lines are not open yet.

        Args:
            model: five channels, one for each finger, with ``spans``, as of LucidGloves.
            open_line: opens the force-feedback pipe; called again after each loss.
            open_records: opens the port of the hand-tracking records; likewise.
            guard: of the model; its torques become limits.
            hand: whose records count, ``"right"`` or ``"left"``.
            give: how much farther a finger may still curl for next to no torque, in curl, 0 to 1.

        Raises:
            ValueError: for another number of channels, a model without spans, a give outside 0 to 1, and another hand.
        """
        super().__init__(model, open_line, guard, give=give)
        self.records = RecordReader(hand)
        self._open_records = open_records
        self._records_line: Line | None = None
        self._curls = np.zeros(len(FINGERS))

    def poll(self, timestamp: float) -> Reading:
        try:
            self._connect(timestamp)
            if self._records_line is not None:
                record = self.records.feed(timestamp, self._records_line.read())
                angles = None if record is None else hand_angles(record)
                if angles is not None and all(math.isfinite(angle) for angle in angles.values()):
                    self._curls = finger_curls(angles)
                    self._take_curls(timestamp, self._curls)
        except LineError as error:
            self._drop_line(timestamp, str(error))
        self._check_silence(timestamp, "the hand is not tracked")
        return self.reading

    def send(
        self, timestamp: float, requested: Any, measured_at: float, slope: np.ndarray | None = None
    ) -> GuardOutput:
        output = self._step_guard(timestamp, requested, measured_at)
        self.limits = (0, 0, 0, 0, 0)
        if self.state == LinkState.ARMED:
            self.limits = position_limits(output, requested, slope, self._curls, self._spans, self._give)
        if self._line is not None:
            try:
                was_written = self._line.write(encode_limits(self.limits))
                self._may_hold = any(self.limits) or (self._may_hold and not was_written)
            except LineError as error:
                self._drop_line(timestamp, str(error))
        return output

    @staticmethod
    def free(line: Line) -> bool:
        written = [line.write(encode_limits((0, 0, 0, 0, 0))) for _ in range(REPETITIONS)]
        return all(written)

    def report(self) -> dict[str, Any]:
        return {"links": self.links, "accepted": self.records.accepted, "refused": self.records.refused}

    def _drop_line(self, timestamp: float, trouble: str) -> None:
        if self._line is not None:
            # It may be the records' line that went, and the driver still hears.
            with contextlib.suppress(LineError):
                self._may_hold = not self._line.write(encode_limits((0, 0, 0, 0, 0)))
        super()._drop_line(timestamp, trouble)

    def _close_line(self) -> None:
        super()._close_line()
        if self._records_line is not None:
            self._records_line.close()
        self._records_line = None

    def _connect(self, timestamp: float) -> None:
        if self._line is not None or timestamp < self._next_attempt:
            return
        self._next_attempt = timestamp + REOPEN
        self._line = self._open()
        self._records_line = self._open_records()
        self.state, self.trouble, self._may_hold = LinkState.GREETING, "no record of the hand has come", True
