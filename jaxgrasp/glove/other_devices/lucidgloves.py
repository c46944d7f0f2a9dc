"""LucidGloves and OpenGloves: curls in, position limits out, over their text protocol ("alpha encoding").

A limit is where a servo stops a finger's string, 0 (free) to 1000 (no curl at all). **It is not a force**: the finger
that pulls harder feels more, the one that does not pull feels nothing, and no number makes it otherwise. The firmware
has no check sum, no sequence and **no watchdog: a limit stays when its host dies or its cable is cut**, until power
is taken away. That is why arming it takes a sentence of its user's. Read from its source: it waits for an answer to
every line it sends, ignores answers shorter than five characters, and takes a finger that is not named for 0.
"""

import logging
import math
import re
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
ACCEPTANCE = "I accept that the limits persist when the host dies"
"""What a user says to arm such a device, letter by letter."""
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
LONGEST = 511
"""Bytes of a line that are kept at most."""
SEVERAL = 3
"""How often what frees all fingers is said, since no check sum guards it."""
_TOKEN = re.compile(rb"\(([A-E])B\)(\d{1,5})|\(([A-E])A([A-D])\)(\d{1,5})|([A-G]|P)(\d{1,5})|([H-O])(?!\d)")
_log = logging.getLogger(__name__)


@checked
def lucidgloves() -> GloveModel:
    """Five fingers, each by the torque on its MP joint; 0.12 N.m count as the whole range. That number is ours."""
    return GloveModel("LucidGloves", tuple(f"{finger} MP" for finger in FINGERS), (0.12,) * 5, rate=1.2, quantum=1.2e-4)


@dataclass(frozen=True, eq=False)
class LucidReading:
    """What such a glove says in one line."""

    curls: Float[np.ndarray, "5"]
    """Curls of thumb to little finger, 0 (open) to 1."""
    splays: Float[np.ndarray, "5"]
    """Splays of the fingers, 0 to 1; NaN where the glove has none."""
    joints: dict[str, float] = field(default_factory=dict)
    """Angles of single joints, by finger and number from the palm, 0 to 1, where the glove reads them."""
    joystick: tuple[float, float] = (math.nan, math.nan)
    trigger: float = math.nan
    buttons: frozenset[str] = frozenset()
    """Buttons that are pressed."""


def read_line(line: bytes, full_scale: int) -> LucidReading | None:
    """What a line without its end says; None where it is none, or lacks a finger, or a number is out of range."""
    curls, splays = np.full(5, np.nan), np.full(5, np.nan)
    others: dict[str, float] = {}
    joints: dict[str, float] = {}
    buttons = set()
    place = 0
    for token in _TOKEN.finditer(line):
        if token.start() != place:
            return None
        place = token.end()
        splay, number, finger, joint, angle, name, value, button = token.groups()
        if button:
            buttons.add(BUTTONS[button.decode()])
            continue
        share = int(number or angle or value) / full_scale
        if share > 1:
            return None
        if splay:
            splays[splay[0] - 65] = share
        elif finger:
            joints[f"{FINGERS[finger[0] - 65]} {joint[0] - 64}"] = share
        elif name in b"ABCDE":
            curls[name[0] - 65] = share
        else:
            others[name.decode()] = share
    if place != len(line) or np.any(np.isnan(curls)):
        return None
    stick = (others.get("F", math.nan), others.get("G", math.nan))
    return LucidReading(curls, splays, joints, stick, others.get("P", math.nan), frozenset(buttons))


def limits_for(
    shares: Float[np.ndarray, "5"], curls: Float[np.ndarray, "5"], give: float
) -> tuple[int, int, int, int, int]:
    """Limits, 0 to 1000, that stop fingers the nearer to where they are the larger their torques should be.

    Args:
        shares: of the largest torque, 0 to 1. None is free; 1 stops a finger where it is.
        curls: of the fingers, 0 to 1.
        give: how much farther a finger may still curl for the smallest torque.
    """
    stops = np.clip(curls + give * (1 - shares), 0, 1)
    limits = np.where(shares > 0, np.floor(1000 * (1 - stops)), 0)
    thumb, index, middle, ring, little = (int(limit) for limit in limits)
    return thumb, index, middle, ring, little


class LucidHost:
    """Such a glove on a line: it answers each line once, so that the firmware never waits and nothing queues."""

    def __init__(self, line: Line, guard: Guard, *, full_scale: int = 4095, give: float = 0.3) -> None:
        """A glove that is free, and not armed.

        Args:
            line: an open port.
            guard: of a model of five channels; its torques become limits.
            full_scale: of the glove's numbers: 4095 with an ESP32, 1023 with an AVR.
            give: see ``limits_for``.

        Raises:
            ValueError: for another number of channels, a scale that is not positive, or a give outside 0 to 1.
        """
        if len(guard.model.joints) != 5:
            raise ValueError(f"the model has {len(guard.model.joints)} channels: expected 5, one for each finger")
        if full_scale < 1:
            raise ValueError(f"full_scale is {full_scale}: expected 1 or more")
        if not 0 <= give <= 1:
            raise ValueError(f"give is {give}: expected 0 to 1")
        self.guard = guard
        self.reading: LucidReading | None = None
        self.read_at = -math.inf
        self.refused = 0
        """Lines that said nothing."""
        self._line, self._full_scale, self._give = line, full_scale, give
        self._kept = b""
        self._owed = self._holds = self._was_cut = False

    def arm(self, now: float, accepted: str) -> None:
        """Let limits through.

        Args:
            now: time [s].
            accepted: ``ACCEPTANCE``, as its user typed it.

        Raises:
            ValueError: for anything else, and before the glove has said anything.
        """
        if accepted != ACCEPTANCE:
            raise ValueError(f"this glove's limits outlive their host; to arm it, its user says: {ACCEPTANCE!r}")
        if self.reading is None:
            raise ValueError("the glove cannot be armed: it says nothing")
        _log.warning("armed a glove without a watchdog; its limits are positions, not forces, and outlive this program")
        self.guard.arm(now)

    def poll(self, now: float) -> LucidReading | None:
        """Take what came; the newest reading.

        Raises:
            LineError: if the line is gone.
        """
        *lines, rest = (self._kept + self._line.read()).split(b"\n")
        # What is longer than any line is none, and neither is what follows it up to the next end.
        self._kept = rest if len(rest) <= LONGEST else rest[:1] * (LONGEST + 1)
        for line in lines:
            found = read_line(line.strip(b"\r"), self._full_scale)
            self._owed = True
            if found is None:
                self.refused += 1
            else:
                self.reading, self.read_at = found, now
        return self.reading

    def send(self, now: float, wanted: Float[np.ndarray, "5"]) -> tuple[int, int, int, int, int]:
        """Answer the glove if it waits for that; the limits that are to hold from now on.

        Limits that are to end are said at once and again, until the glove speaks and its answer says so too: the last
        answer may have been lost, and then the glove holds them and waits.

        Args:
            now: time [s].
            wanted: torques by which to resist flexion [N.m].

        Raises:
            LineError: if the line is gone; its limits stay as they were, which no host can change.
        """
        output = self.guard.step(now, wanted, self.read_at)
        limits = (0, 0, 0, 0, 0)
        if output.state == GuardState.ARMED and self.reading is not None:
            limits = limits_for(output.torques / np.array(self.guard.model.limits), self.reading.curls, self._give)
        if self._owed or (self._holds and not any(limits)):
            text = "".join(f"{name}{limit}" for name, limit in zip("ABCDE", limits, strict=True))
            # After what may be half an answer, an end of line makes it a bad one, and the next a good one.
            begin = b"" if self._owed and not self._was_cut else b"\n"
            self._was_cut = not self._line.write(begin + text.encode() + b"\n")
            if self._owed and not self._was_cut:
                self._holds, self._owed = any(limits), False
        return limits

    def close(self) -> None:
        """Free all fingers, if the line still is there, and let go of it."""
        self.guard.disarm()
        try:
            for _ in range(SEVERAL):
                self._line.write(b"\n" + FREE)
        except LineError as error:
            _log.error("the glove could not be freed: %s; take its power away", error)
        self._line.close()
