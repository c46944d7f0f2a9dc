"""Orders that a person at a glove's bench types, and immediate messages on what happens to the glove."""

import sys
import threading
import time
from collections import Counter

from jaxgrasp.cli.terminal import show
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.glove_process import GloveProcess

FULL = 1.0
FIRST = 0.05
GOES_ON = "this glove goes on with what it was told last when its line is cut"
LOOKS_EVERY = 0.05
"""Time between two looks at what happened to the glove [s]."""
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


class Orders:
    """Threads that pass typed orders to the glove and print its events, without blocking the caller."""

    def __init__(self, glove: GloveProcess, acceptance: str = "") -> None:
        """Start both threads; ``acceptance`` is the sentence to type, letter by letter, before the glove is armed."""
        self.is_over = False
        self.losses: Counter[str] = Counter()
        """Number of times that torque ended by itself, by cause."""
        self._glove = glove
        self._acceptance, self._accepted = acceptance, ""
        self._felt_first = False
        """True while the glove is armed by an order, first at a twentieth of the torque: ``full`` needs that."""
        self._order_lock = threading.Lock()
        self._told_at = -1.0
        self._link, self._guard = LinkState.CLOSED.name, GuardState.DISARMED.name
        for job in (self._listen, self._look):
            threading.Thread(target=job, daemon=True).start()

    def summary(self) -> str:
        """Format the number of times that torque ended by itself, with the causes."""
        if not self.losses:
            return "the glove let go by itself: never"
        causes = ", ".join(f"{cause} ({count})" for cause, count in self.losses.most_common())
        return f"the glove let go by itself: {self.losses.total()} times: {causes}"

    def _listen(self) -> None:
        for line in sys.stdin:
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
            self._arm_soon()
            self._felt_first = True
        return f"armed, {scale:.0%} of the torque"

    def _arm_soon(self) -> None:
        started = time.perf_counter()
        until_armed(self._glove, self._accepted, FRESH)
        end = time.perf_counter() + AGREES
        while not any(
            event["at"] >= started and event["guard"] == GuardState.ARMED.name for event in self._glove.events()
        ):
            if time.perf_counter() > end:
                raise ValueError("the glove did not say that it is armed")
            time.sleep(LOOKS_EVERY / 5)

    def _look(self) -> None:
        while not self.is_over:
            for event in self._glove.events():
                if event["at"] > self._told_at:
                    self._told_at = event["at"]
                    self._tell(event)
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
        elif is_there and not was_there and self.losses:
            show("the glove answers again; type arm")
