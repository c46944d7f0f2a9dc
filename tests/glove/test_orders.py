"""What a person at the bench reads: the true cause why a glove is not armed, and that a lost one is back."""

import io
import sys
import time

import numpy as np
import pytest

from jaxgrasp.cli.glove_orders import CutTorques, NotArmedError, Orders, arm_and_confirm
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import GloveState
from jaxgrasp.glove.loop.glove_process import GloveProcess

CAUSE = "the line's round trip takes 25 ms: expected at most 21 ms"


class FakeGlove(GloveProcess):
    """Process of a glove whose events are scripted: those of each order to arm, and those that ``happen``."""

    def __init__(self, *armings: list[tuple[str, str, str, str]]):
        self._events: list[dict] = []
        self._armings = list(armings)

    def happen(self, *events: tuple[str, str, str, str]) -> None:
        for event in events:
            time.sleep(1e-4)
            self._events.append(dict(zip(("link", "guard", "trouble", "cause"), event), at=time.perf_counter()))

    def arm(self, accepted: str = "") -> None:
        self.happen(*self._armings.pop(0))

    def events(self) -> list[dict]:
        return list(self._events)

    def disarm(self) -> None:
        pass

    def rescale(self, scale: float) -> None:
        pass

    def is_alive(self) -> bool:
        return True


IN_ONE_TURN = [("ARMING", "DISARMED", "", ""), ("LINKED", "LATCHED", "", CAUSE)]
AGAIN = [("ARMING", "LATCHED", "", CAUSE), ("LINKED", "LATCHED", "", CAUSE)]
UNCONFIRMED = [
    ("ARMING", "LATCHED", "", "an older cause"),
    ("GREETING", "LATCHED", "the device did not confirm that it is armed", "an older cause"),
]
UNPLUGGED = [("ARMING", "DISARMED", "", ""), ("CLOSED", "DISARMED", "the port is gone", "")]
ARMED = [("ARMING", "LATCHED", "", CAUSE), ("ARMED", "ARMED", "", "")]


@pytest.mark.parametrize(
    ("events", "reason", "has_let_go"),
    [
        (IN_ONE_TURN, CAUSE, True),
        (AGAIN, CAUSE, True),
        (UNCONFIRMED, "the device did not confirm that it is armed", True),
        (UNPLUGGED, "the port is gone", False),
    ],
)
def test_the_reason_why_it_is_not_armed_is_the_true_one_and_comes_at_once(events, reason, has_let_go):
    started = time.perf_counter()
    with pytest.raises(NotArmedError) as raised:
        arm_and_confirm(FakeGlove(events), "", 0.0)
    assert str(raised.value) == reason and time.perf_counter() - started < 0.5


def test_a_glove_that_is_armed_is_and_one_that_says_nothing_is_not():
    arm_and_confirm(FakeGlove(ARMED), "", 0.0)
    # Armed for a moment, and released in a turn of its own: that is told as it happens.
    arm_and_confirm(FakeGlove([*ARMED, ("LINKED", "LATCHED", "", CAUSE)]), "", 0.0)
    with pytest.raises(NotArmedError, match="did not say that it is armed"):
        arm_and_confirm(FakeGlove([]), "", 0.0)


@pytest.fixture
def orders(monkeypatch):
    """Return the orders of a person who types nothing, for a glove, and the lines that the person reads."""
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    monkeypatch.setattr("jaxgrasp.cli.glove_orders.Orders._listen", lambda self: None)
    lines: list[str] = []
    monkeypatch.setattr("jaxgrasp.cli.glove_orders.show", lambda text: lines.append(str(text)))
    started: list[Orders] = []

    def start(glove: FakeGlove, joints: tuple[str, ...] = ()) -> tuple[Orders, list[str]]:
        started.append(Orders(glove, joints=joints))
        return started[-1], lines

    yield start
    for each in started:
        each.is_over = True


def wait_for(lines: list[str], words: str) -> None:
    end = time.perf_counter() + 5.0
    while not any(words in line for line in lines):
        assert time.perf_counter() < end, lines
        time.sleep(0.01)


def test_an_order_to_arm_tells_the_cause_and_counts_the_release(orders):
    made, _ = orders(FakeGlove(IN_ONE_TURN, ARMED))
    answer = made._obey("arm")
    assert "torque is zero" in answer and CAUSE in answer and "type arm" in answer
    assert CAUSE in made.summary() and "1 times" in made.summary()
    assert made._obey("full") == "the first time power is on, it is a twentieth: arm, feel it, and then say full"
    assert made._obey("arm") == "armed, 5% of the torque"


def test_the_return_of_a_lost_glove_is_told_and_its_first_answer_is_not(orders):
    glove = FakeGlove()
    _, lines = orders(glove)
    glove.happen(("GREETING", "DISARMED", "the device does not answer", ""), ("LINKED", "DISARMED", "", ""))
    glove.happen(("GREETING", "DISARMED", "the device fell silent", ""))
    wait_for(lines, "the glove is gone: the device fell silent")
    assert not any("answers again" in line for line in lines)
    glove.happen(("GREETING", "DISARMED", "the device has not reported all of its limits", ""))
    glove.happen(("LINKED", "DISARMED", "", ""))
    wait_for(lines, "the glove answers again; type arm")
    assert len(lines) == 2


def test_a_torque_that_is_cut_is_told_as_it_begins_and_while_it_lasts():
    joints, zeros = ("a", "b"), np.zeros(2)

    def state(cut_s: float, guard: int = GuardState.ARMED) -> GloveState:
        asked, given, cut = np.array([0.49, 0.05]), np.array([0.12, 0.05]), np.array([cut_s, 0.0])
        return GloveState(1.0, 4, guard, 0.37, 1.0, zeros, given, zeros, asked, cut)

    told = CutTorques(joints)
    assert told.line(0.0, None) == "" and told.line(0.0, GloveState(1.0, 4, 1, 0.0, 1.0, zeros, zeros, zeros)) == ""
    assert told.line(0.0, state(0.0)) == ""
    assert "a asked 0.490, given 0.120, cut for 0.1 s" in told.line(0.1, state(0.1))
    assert [told.line(0.1 * k, state(0.1 * k)) for k in range(2, 50)] == [""] * 48
    assert "cut for 5.2 s" in told.line(5.2, state(5.2))
    assert told.line(20.0, state(5.2)) == "", "no longer"
    assert "cut for 5.3 s" in told.line(20.1, state(5.3))


def test_the_terminal_says_what_is_cut(orders):
    glove = FakeGlove()
    asked, given, zeros = np.full(2, 0.49), np.full(2, 0.12), np.zeros(2)
    glove.state = lambda: GloveState(1.0, 4, 1, 0.37, 1.0, zeros, given, zeros, asked, np.full(2, 0.5))
    _, lines = orders(glove, ("index MP", "index PIP"))
    wait_for(lines, "the glove gives less than the law asks [N.m]: index MP asked 0.490, given 0.120")
