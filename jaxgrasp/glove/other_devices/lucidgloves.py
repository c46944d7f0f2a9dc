"""LucidGloves and OpenGloves: curls in, position limits out, over their text protocols.

A line in "alpha encoding" names each number by a letter; one in "legacy encoding" is thirteen numbers between ``&``.
The host reads either, and answers in the encoding of the glove's last line. A finger without a curl that reads its
joints is as curled as these are in the mean.

A limit is where a servo stops a finger's string, 0 (free) to 1000 (no curl at all). **It is not a force**: the finger
that pulls harder feels more, the one that does not pull feels nothing, and no number makes it otherwise. So a finger is
stopped where the torque asked for begins, by its slope: at the surface of what it touches. The firmware
has no check sum, no sequence and **no watchdog: a limit stays when its host dies or its cable is cut**, until power
is taken away. That is why arming it takes a sentence of its user's. Read from its source: it waits for an answer to
every line it sends, ignores answers shorter than five characters, and takes a finger that is not named for 0.
"""

import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.glove_device import REOPEN, SILENCE, Capability, LinkState, OutlivingDevice, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput, GuardState
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import FINGERS, GloveModel

ACCEPTANCE = "I accept that the limits persist when the host dies"
"""Sentence that a user must repeat exactly to arm such a device."""
BUTTONS = {
    "H": "joystick",
    "I": "trigger",
    "J": "A",
    "K": "B",
    "L": "grab",
    "M": "pinch",
    "N": "menu",
    "O": "calibrate",
}
FREE = b"A0B0C0D0E0\n"
FREE_LEGACY = b"0&0&0&0&0\n"
"""The same line in legacy encoding."""
MAX_INCOMPLETE = 511
"""Largest number of bytes of an incomplete line that are kept."""
REPETITIONS = 3
"""Number of repetitions of the line that frees all fingers, since no check sum protects it."""
MAX_PAUSE = 0.1
"""Time between two turns after which the guard trips [s]: the glove may have been freed meanwhile."""
MAX_DEPTH = 0.2
"""Largest distance from a finger at which its resistance may begin [rad]: the limit for following the law's slope."""
_LEGACY = re.compile(rb"\d{1,5}(?:&\d{1,5}){12}")
LEGACY_BUTTONS = ("joystick", "trigger", "A", "B", "grab", "pinch")
"""Buttons in the order of a line in legacy encoding, after five curls and the joystick's two axes."""
_TOKEN = re.compile(rb"\(([A-E])B\)(\d{1,5})|\(([A-E])A([A-D])\)(\d{1,5})|([A-G]|P)(\d{1,5})|([H-O])(?!\d)")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class LucidReading:
    """Sensor values from one line of the glove."""

    curls: Float[np.ndarray, "5"]
    """Curls of thumb to little finger, 0 (open) to 1."""
    splays: Float[np.ndarray, "5"]
    """Splays of the fingers, 0 to 1; NaN where the glove has none."""
    joints: dict[str, float] = field(default_factory=dict)
    """Angles of single joints, by finger and number from the palm, 0 to 1, where the glove reads them."""
    joystick: tuple[float, float] = (math.nan, math.nan)
    trigger: float = math.nan
    buttons: frozenset[str] = frozenset()
    """Names of the pressed buttons."""
    is_legacy: bool = False
    """True if the line was in legacy encoding."""


def read_line(line: bytes, full_scale: int) -> LucidReading | None:
    """Parse a line without its end; return None if it is malformed, lacks a finger, or has a number out of range."""
    if b"&" in line:
        return _read_legacy_line(line, full_scale)
    curls, splays = np.full(5, np.nan), np.full(5, np.nan)
    values_by_name: dict[str, float] = {}
    joints: dict[str, float] = {}
    buttons = set()
    position = 0
    for token in _TOKEN.finditer(line):
        if token.start() != position:
            return None
        position = token.end()
        splay, number, finger, joint, angle, name, value, button = token.groups()
        if button:
            buttons.add(BUTTONS[button.decode()])
            continue
        share = int(number or angle or value) / full_scale
        if name == b"P":
            # Its trigger goes one count beyond the scale.
            share = min(share, 1.0)
        if share > 1:
            return None
        if splay:
            splays[splay[0] - 65] = share
        elif finger:
            joints[f"{FINGERS[finger[0] - 65]} {joint[0] - 64}"] = share
        elif name in b"ABCDE":
            curls[name[0] - 65] = share
        else:
            values_by_name[name.decode()] = share
    if position != len(line):
        return None
    for k, finger_name in enumerate(FINGERS):
        shares = [joints[name] for name in joints if name.startswith(f"{finger_name} ")]
        if np.isnan(curls[k]) and shares:
            curls[k] = sum(shares) / len(shares)
    if np.any(np.isnan(curls)):
        return None
    stick = (values_by_name.get("F", math.nan), values_by_name.get("G", math.nan))
    return LucidReading(curls, splays, joints, stick, values_by_name.get("P", math.nan), frozenset(buttons))


def _read_legacy_line(line: bytes, full_scale: int) -> LucidReading | None:
    if not _LEGACY.fullmatch(line):
        return None
    numbers = [int(number) for number in line.split(b"&")]
    if max(numbers[:7]) > full_scale or max(numbers[7:]) > 1:
        return None
    shares = np.array(numbers[:7]) / full_scale
    pressed = [name for name, is_pressed in zip(LEGACY_BUTTONS, numbers[7:], strict=True) if is_pressed]
    stick = (float(shares[5]), float(shares[6]))
    return LucidReading(shares[:5], np.full(5, np.nan), {}, stick, math.nan, frozenset(pressed), is_legacy=True)


def stops_at(
    curls: Float[np.ndarray, "5"],
    depths: Float[np.ndarray, "5"],
    shares: Float[np.ndarray, "5"],
    give: float,
) -> tuple[int, int, int, int, int]:
    """Compute limits, 0 to 1000, that stop fingers where resistance begins.

    Args:
        curls: of the fingers, 0 to 1.
        depths: how far each is beyond where its torque begins, in curl.
        shares: part of the requested torque that may leave, 0 to 1: 1 stops a finger where resistance begins, and less
            lets it go on by more of the ``give``. None is free.
        give: how much farther a finger may still curl for next to no torque, in curl.
    """
    stops = np.clip(curls - depths + give * (1 - shares), 0, 1)
    limits = np.where(shares > 0, np.floor(1000 * (1 - stops)), 0)
    thumb, index, middle, ring, little = (int(limit) for limit in limits)
    return thumb, index, middle, ring, little


def position_limits(
    output: GuardOutput,
    requested: Any,
    slope: Float[np.ndarray, "5 5"] | None,
    curls: Float[np.ndarray, "5"],
    spans: Float[np.ndarray, "5"],
    give: float,
) -> tuple[int, int, int, int, int]:
    """Compute limits, 0 to 1000, by which fingers are stopped where the torque asked for begins.

    Args:
        output: of an armed guard, for the torques asked for.
        requested: these torques ``(5,)`` [N.m].
        slope: their derivative by the angles [N.m/rad]; without one, a finger is stopped where it is.
        curls: of the fingers, 0 to 1.
        spans: angle of each finger's joint at full curl [rad].
        give: see ``stops_at``.
    """
    # The guard has seen that these are finite numbers. What it lets out is more where it has not yet come down.
    torques = np.maximum(np.asarray(requested, float), 0)
    allowed = np.clip(output.torques, 0, torques)
    shares = np.divide(allowed, torques, out=np.zeros(len(FINGERS)), where=torques > 0)
    slopes = np.zeros(len(FINGERS)) if slope is None else np.diagonal(slope)
    # Where torque begins within reach; a finger that is deeper is stopped no farther back.
    is_within_reach = torques < MAX_DEPTH * slopes
    depths = np.divide(torques, slopes, out=np.where(slopes > 0, MAX_DEPTH, 0.0), where=is_within_reach)
    return stops_at(curls, depths / spans, shares, give)


class FingerLimitDevice(OutlivingDevice):
    """A glove of five fingers that stops each where it is told to, and goes on doing so when its host dies."""

    capability = Capability("position limit", measures_torque=False, outlives_host=True)
    acceptance = ACCEPTANCE

    def __init__(self, model: GloveModel, open_line: Callable[[], Line], guard: Guard, *, give: float) -> None:
        """Create a host whose line is not open yet.

        Args:
            model: five channels, one for each finger, with ``spans``.
            open_line: opens the line of the limits; called again after each loss.
            guard: of the model; its torques become limits.
            give: see ``stops_at``.

        Raises:
            ValueError: for another number of channels, a model without spans, or a give outside 0 to 1.
        """
        if len(model.joints) != len(FINGERS):
            raise ValueError(f"the model has {len(model.joints)} channels: expected 5, one for each finger")
        if model.spans is None:
            raise ValueError(f"{model.name} has no spans: expected the angles of all five joints at full curl [rad]")
        if not 0 <= give <= 1:
            raise ValueError(f"give is {give}: expected 0 to 1")
        super().__init__(model, open_line, guard)
        self.limits = (0, 0, 0, 0, 0)
        """Position limits in force from now on."""
        self._spans, self._give, self._sent_at = np.array(model.spans), give, math.inf

    def arm(self, timestamp: float, accepted: str = "") -> None:
        if accepted != ACCEPTANCE:
            raise ValueError(f"this glove's limits outlive the host: to arm it, repeat the sentence {ACCEPTANCE!r}")
        if self.state < LinkState.LINKED:
            raise ValueError(f"the glove cannot be armed: {self.trouble}")
        _log.warning("armed a glove without a watchdog: its limits are not forces, and persist if its cable is cut")
        self.guard.arm(timestamp)
        self.state = LinkState.ARMED

    def _step_guard(self, timestamp: float, requested: Any, measured_at: float) -> GuardOutput:
        """Return the guard's output for a command; trip the guard first where this program was held up."""
        if timestamp - self._sent_at > MAX_PAUSE:
            self.guard.trip(f"this program was held up for {timestamp - self._sent_at:.1f} s")
        self._sent_at = timestamp
        output = self.guard.step(timestamp, requested, measured_at)
        if output.state != GuardState.ARMED:
            self.state = min(self.state, LinkState.LINKED)
        return output

    def _check_silence(self, timestamp: float, trouble: str) -> None:
        """Trip the guard and lose the link where no angles have come for long."""
        if self.state >= LinkState.LINKED and timestamp - self.reading.angles_at > SILENCE:
            self.guard.trip(trouble)
            self.state, self.trouble = LinkState.GREETING, trouble

    def _take_curls(self, timestamp: float, curls: Float[np.ndarray, "5"]) -> None:
        """Take the curls of the fingers as the newest angles, and establish the link by the first ones."""
        self.reading = replace(self.reading, angles=curls * self._spans, angles_at=timestamp)
        if self.state < LinkState.LINKED:
            self.state, self.trouble = LinkState.LINKED, ""
            self.links += 1


class LucidHost(FingerLimitDevice):
    """Host of a LucidGloves device: it answers each line once, so that the firmware never waits and nothing queues."""

    name_and_remedy = ("the glove", "plug it in again, or switch off its power")

    def __init__(
        self,
        model: GloveModel,
        open_line: Callable[[], Line],
        guard: Guard,
        *,
        full_scale: int = 4095,
        give: float = 0.3,
    ) -> None:
        """Create a host whose line is not open yet.

        Args:
            model: five channels, one for each finger, with ``spans``.
            open_line: opens the port; called again after each loss.
            guard: of the model; its torques become limits.
            full_scale: of the glove's numbers: 4095 with an ESP32, 1023 with an AVR.
            give: see ``stops_at``.

        Raises:
            ValueError: for another number of channels, a model without spans, a scale that is not positive, or a give
                outside 0 to 1.
        """
        super().__init__(model, open_line, guard, give=give)
        if full_scale < 1:
            raise ValueError(f"full_scale is {full_scale}: expected 1 or more")
        self.latest: LucidReading | None = None
        """Latest sensor values."""
        self.refused = 0
        """Number of malformed lines."""
        self._full_scale = full_scale
        self._buffer = b""
        self._owes_answer = self._was_cut = False

    def poll(self, timestamp: float) -> Reading:
        try:
            self._connect(timestamp)
            if self._line is not None:
                self._handle_data(timestamp, self._line.read())
        except LineError as error:
            self._drop_line(timestamp, str(error))
        self._check_silence(timestamp, "the glove fell silent")
        return self.reading

    def send(
        self, timestamp: float, requested: Any, measured_at: float, slope: np.ndarray | None = None
    ) -> GuardOutput:
        """Send position limits as the answer that the glove waits for; return the guard's output.

        Limits that are to end are said at once and again, until the glove speaks and its answer says so too: the last
        answer may have been lost, and then the glove holds them and waits.
        """
        output = self._step_guard(timestamp, requested, measured_at)
        self.limits = self._limits(output, requested, slope)
        if self._line is None:
            return output
        try:
            self._answer(self._line)
        except LineError as error:
            self._drop_line(timestamp, str(error))
        return output

    @staticmethod
    def free(line: Line) -> bool:
        # In both encodings, since nobody knows the glove's: either takes the other's line for one without numbers.
        written = [line.write(b"\n" + text) for _ in range(REPETITIONS) for text in (FREE_LEGACY, FREE)]
        return all(written)

    def status_text(self) -> str:
        return "" if self.latest is None else ", ".join(sorted(self.latest.buttons))

    def report(self) -> dict[str, Any]:
        return {"links": self.links, "refused": self.refused}

    def _connect(self, timestamp: float) -> None:
        if self._line is not None or timestamp < self._next_attempt:
            return
        self._next_attempt = timestamp + REOPEN
        self._line = self._open()
        self.state, self.trouble = LinkState.GREETING, "the glove sends nothing"
        # Nobody knows what it was told before.
        self._buffer, self._owes_answer, self._may_hold, self._was_cut = b"", False, True, False

    def _handle_data(self, timestamp: float, data: bytes) -> None:
        *lines, incomplete = (self._buffer + data).split(b"\n")
        # What is longer than any line is none, and neither is what follows it up to the next end.
        self._buffer = incomplete if len(incomplete) <= MAX_INCOMPLETE else incomplete[:1] * (MAX_INCOMPLETE + 1)
        for line in lines:
            reading = read_line(line.strip(b"\r"), self._full_scale)
            self._owes_answer = True
            if reading is None:
                self.refused += 1
                if self.state == LinkState.GREETING:
                    self.trouble = f"{self.refused} lines arrived, none with five curls up to {self._full_scale}"
                continue
            self.latest = reading
            self._take_curls(timestamp, reading.curls)

    def _limits(self, output: GuardOutput, requested: Any, slope: np.ndarray | None) -> tuple[int, int, int, int, int]:
        if output.state != GuardState.ARMED or self.latest is None:
            return (0, 0, 0, 0, 0)
        return position_limits(output, requested, slope, self.latest.curls, self._spans, self._give)

    def _answer(self, line: Line) -> None:
        if not (self._owes_answer or (self._may_hold and not any(self.limits))):
            return
        if self.latest is not None and self.latest.is_legacy:
            text = "&".join(str(limit) for limit in self.limits)
        else:
            text = "".join(f"{name}{limit}" for name, limit in zip("ABCDE", self.limits, strict=True))
        # After what may be half an answer, an end of line makes it a bad one, and the next a good one.
        prefix = b"" if self._owes_answer and not self._was_cut else b"\n"
        self._was_cut = not line.write(prefix + text.encode() + b"\n")
        if self._owes_answer and not self._was_cut:
            self._may_hold, self._owes_answer = any(self.limits), False
