"""Orders that a person at a glove's bench types, and immediate messages on what happens to the glove."""

import contextlib
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from jaxgrasp.cli.terminal import read_until, show, standard_lines
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import GloveState
from jaxgrasp.glove.loop.glove_process import GloveProcess

FULL = 1.0
FIRST = 0.05
GOES_ON = "this glove goes on with what it was told last when its line is cut"
LOOKS_EVERY = 0.05
"""Time between two looks at what happened to the glove [s]."""
NOT_CONFIRMED = "the glove did not say that it is armed"
AGREES = 1.0
"""Time in which a glove must confirm that it is armed [s]."""
FRESH = 0.5
"""Time that an order to arm waits for fresh forces [s]: the first ones, or those after a pause of the machine."""


def until_armed(glove: GloveProcess, accepted: str, patience: float) -> None:
    """Ask for torque until it is not refused: there may be no link yet, or no fresh law.

    Args:
        glove: to be armed.
        accepted: what the user said, of a device that needs words.
        patience: how long [s].

    Raises:
        ValueError: where it is refused still.
        OSError: where the process has ended.
    """
    end = time.perf_counter() + patience
    while True:
        try:
            return glove.arm(accepted)
        except ValueError:
            if time.perf_counter() > end:
                raise
            time.sleep(LOOKS_EVERY)


def arm_and_confirm(glove: GloveProcess, accepted: str, patience: float) -> None:
    """Ask for torque until it is not refused, and return when the glove has confirmed that it is armed.

    A glove may be armed and let go in one turn of its process, which reports only the second: its cause is told.

    Args:
        glove: to be armed.
        accepted: what the user said, of a device that needs words.
        patience: how long it may be refused [s].

    Raises:
        ValueError: where it is refused still.
        NotArmedError: where it let go as it was armed, or did not confirm in time.
        OSError: where the process has ended.
    """
    started = time.perf_counter()
    until_armed(glove, accepted, patience)
    end = time.perf_counter() + AGREES
    while True:
        is_over = time.perf_counter() > end or not glove.is_alive()
        events = [event for event in glove.events() if event["at"] >= started]
        asked_at = next((k for k, event in enumerate(events) if event["link"] == LinkState.ARMING.name), len(events))
        for event in events[asked_at:]:
            if event["link"] == LinkState.ARMING.name:
                continue
            if event["guard"] == GuardState.ARMED.name:
                return
            raise NotArmedError(_reason(event), has_let_go=event["guard"] == GuardState.LATCHED.name)
        if any(event["guard"] == GuardState.ARMED.name for event in events):
            return
        if is_over:
            raise NotArmedError(_reason(events[-1]) if events else NOT_CONFIRMED)
        time.sleep(LOOKS_EVERY / 5)


CUT_AGAIN = 5.0
"""Time after which a torque that is still cut is told again [s]."""


class CutTorques:
    """Torques that the law asks for and the glove does not give, told as they begin and while they last."""

    def __init__(self, joints: Sequence[str]) -> None:
        """Create a record of a glove with these joints, whose torques were never cut."""
        self._joints = tuple(joints)
        self._cut_s = np.zeros(len(joints))
        self._told_at = np.full(len(joints), -np.inf)
        self._looked_at = -np.inf

    def line(self, timestamp: float, state: GloveState | None) -> str:
        """Return a line on the torques that are cut since the last call; empty where none has to be told.

        Args:
            timestamp: on a clock that never runs backwards [s].
            state: of the glove.
        """
        if state is None or not np.all(np.isfinite(state.cut_s)):
            return ""
        is_cut = (state.cut_s > self._cut_s) & (state.guard == GuardState.ARMED)
        self._cut_s = state.cut_s
        is_due = is_cut & (timestamp - self._told_at > CUT_AGAIN)
        self._told_at = np.where(is_due, timestamp, self._told_at)
        torques = [
            f"{self._joints[k]} asked {state.asked[k]:.3f}, given {state.torques[k]:.3f}, "
            f"cut for {state.cut_s[k]:.1f} s"
            for k in np.flatnonzero(is_due).tolist()
        ]
        return f"the glove gives less than the law asks [N.m]: {'; '.join(torques)}" if torques else ""


class NotArmedError(ValueError):
    """Glove that let go as it was armed, or that did not confirm in time; the message holds the cause."""

    def __init__(self, reason: str, *, has_let_go: bool = False) -> None:
        """Create the error; ``has_let_go`` is True where the glove was armed for a moment."""
        super().__init__(reason)
        self.has_let_go = has_let_go


def _reason(event: dict[str, Any]) -> str:
    """Return the reason why a glove is not armed: the lost link's, or else the cause of the guard's latch."""
    is_linked = LinkState[event["link"]] >= LinkState.LINKED
    return (event["cause"] if is_linked else event["trouble"]) or event["trouble"] or NOT_CONFIRMED


class Orders:
    """Threads that pass typed orders to the glove and print its events, without blocking the caller."""

    def __init__(self, glove: GloveProcess, acceptance: str = "", joints: Sequence[str] = ()) -> None:
        """Start both threads.

        Args:
            glove: that the orders are for.
            acceptance: sentence to type, letter by letter, before the glove is armed.
            joints: names of its channels, to tell which torques are cut; nothing is told of them without names.
        """
        self.is_over = False
        self.losses: Counter[str] = Counter()
        """Number of times that torque ended by itself, by cause."""
        self._glove = glove
        self._cut_torques = CutTorques(joints) if joints else None
        self._acceptance, self._accepted = acceptance, ""
        self._felt_first = False
        """True while the glove is armed by an order, first at a twentieth of the torque: ``full`` needs that."""
        self._order_lock = threading.Lock()
        self._told_at = -1.0
        self._link, self._guard = LinkState.CLOSED.name, GuardState.DISARMED.name
        self._is_lost = False
        """True from the loss of a glove until it answers again."""
        for job in (self._listen, self._look):
            threading.Thread(target=job, daemon=True).start()

    def summary(self) -> str:
        """Format the number of times that torque ended by itself, with the causes."""
        if not self.losses.total():
            return "the glove let go by itself: never"
        causes = ", ".join(f"{cause} ({count})" for cause, count in self.losses.most_common() if count)
        return f"the glove let go by itself: {self.losses.total()} times: {causes}"

    def _listen(self) -> None:
        for line in self._lines():
            if self._acceptance and line.strip() == self._acceptance:
                self._accepted = self._acceptance
                show(self._obey("arm"))
                continue
            order = line.strip().lower()
            if order == "quit":
                break
            if order:
                show(self._obey(order))
        self.is_over = True

    def _lines(self) -> Iterator[str]:
        """Yield the typed lines until the end of the input, or of the run: no read may hold up the program's end."""
        lines = standard_lines()
        if lines is None:
            yield from sys.stdin
            return
        with contextlib.suppress(KeyboardInterrupt):
            while (line := read_until(lines, lambda: self.is_over)) is not None:
                yield line

    def _obey(self, order: str) -> str:
        try:
            if order == "stop":
                self._felt_first = False
                self._glove.stop()
                return "emergency stop: no torque, here and in the glove; type arm to go on"
            if order == "disarm":
                with self._order_lock:
                    self._felt_first = False
                    self._glove.disarm()
                return "no torque"
            if order in ("arm", "full"):
                return self._arm(FIRST if order == "arm" else FULL)
        except (ValueError, OSError) as error:
            return str(error)
        return f"{order!r} is no order: expected arm, full, disarm, stop or quit"

    def _arm(self, scale: float) -> str:
        if self._accepted != self._acceptance:
            return f"{GOES_ON}; type: {self._acceptance}"
        if scale == FULL and not self._felt_first:
            return "the first time power is on, it is a twentieth: arm, feel it, and then say full"
        with self._order_lock:
            self._felt_first = False
            self._glove.disarm()
            self._glove.rescale(scale)
            try:
                arm_and_confirm(self._glove, self._accepted, FRESH)
            except NotArmedError as error:
                # Torque that ended in the turn in which it began is in no event of its own.
                self.losses[str(error)] += error.has_let_go
                return f"torque is zero, the glove could not be armed: {error}; type arm to try again"
            self._felt_first = True
        return f"armed, {scale:.0%} of the torque"

    def _look(self) -> None:
        while not self.is_over:
            for event in self._glove.events():
                if event["at"] > self._told_at:
                    self._told_at = event["at"]
                    self._tell(event)
            if self._cut_torques is not None:
                line = self._cut_torques.line(time.perf_counter(), self._glove.state())
                if line:
                    show(line)
            time.sleep(LOOKS_EVERY)

    def _tell(self, event: dict[str, str]) -> None:
        """Print a message where an event says that torque ended, or that the glove went or came."""
        was_there, is_there = (LinkState[name] >= LinkState.LINKED for name in (self._link, event["link"]))
        let_go = self._guard == GuardState.ARMED.name and event["guard"] == GuardState.LATCHED.name
        self._link, self._guard = event["link"], event["guard"]
        if let_go:
            self._felt_first = False
            self.losses[event["cause"]] += 1
            then = "type arm to go on" if is_there else "reconnect it, then type arm"
            show(f"torque is zero: {event['cause']}; {then}")
        elif was_there and not is_there:
            show(f"the glove is gone: {event['trouble']}")
        elif is_there and self._is_lost:
            show("the glove answers again; type arm")
        self._is_lost = (self._is_lost or was_there) and not is_there
