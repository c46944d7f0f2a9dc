"""What a page says of felt torques: asked for and given, none and why, and that a picture is old."""

import re
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import GloveState, Slot, TorqueLaw
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.lab.felt_objects import felt_object
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.view.followed_page import Latency
from jaxgrasp.view.panel_words import STALE_AGE, felt_torques_html, heartbeat_html, notice_html, stale_notice
from jaxgrasp.view.view_slots import TRIAL, TrialState, ViewFrame

MODEL = lrp_hand_master()
CHANNELS = len(MODEL.joints)


def frame(
    timestamp: float, link: int = LinkState.ARMED, guard: int = GuardState.ARMED, cause: str = "", given: float = 0.12
) -> ViewFrame:
    zeros = np.zeros(CHANNELS)
    asked = np.where(np.arange(CHANNELS) == 3, 0.49, 0.05)
    cut_s = np.where(asked > 0.12, 3.24, 0.0)
    felt = np.minimum(asked, given)
    state = GloveState(timestamp, link, guard, 0.0, timestamp, zeros, felt, felt, asked, cut_s, cause)
    law = TorqueLaw(timestamp, True, zeros, asked, np.zeros((CHANNELS, CHANNELS)))
    return ViewFrame.ticked(state, law, TrialState().vector())


def test_a_row_says_what_is_asked_given_and_measured_and_for_how_long_it_was_cut():
    html = felt_torques_html(MODEL.joints, frame(1.0))
    row = re.search(r'data-joint="index PIP".*?</tr>', html)[0]
    assert re.findall(r">([\d.]+)</td>", row) == ["0.490", "0.120", "0.120", "3.2"]
    other = re.search(r'data-joint="index MP".*?</tr>', html)[0]
    assert re.findall(r">([\d.]+)</td>", other) == ["0.050", "0.050", "0.050"], "it was never cut"
    assert "0.000" in felt_torques_html(["index MP"], frame(1.0, given=-0.0)), "zero has no sign"
    assert "\N{MINUS SIGN}0.000" not in felt_torques_html(["index MP"], frame(1.0, given=-0.0))
    again = ViewFrame.of(frame(1.0, cause="why").vector(), CHANNELS)
    assert felt_torques_html(MODEL.joints, again) == html and again.cause == "why" and again.ticked_at == 1.0


@pytest.mark.parametrize(
    ("link", "guard", "cause", "words"),
    [
        (LinkState.LINKED, GuardState.LATCHED, "its emergency stop was pressed", ["its emergency stop", "type arm"]),
        (LinkState.LINKED, GuardState.DISARMED, "", ["the glove is not armed", "type arm"]),
        (LinkState.ARMING, GuardState.DISARMED, "", ["is being armed"]),
        (
            LinkState.CLOSED,
            GuardState.LATCHED,
            "the line is gone",
            ["the glove is gone: the line is gone", "connect it"],
        ),
        (LinkState.GREETING, GuardState.DISARMED, "the device does not answer", ["does not answer", "type arm"]),
    ],
)
def test_without_torque_a_large_notice_says_why_and_what_to_do(link, guard, cause, words):
    html = notice_html(frame(1.0, link, guard, cause, given=0.0))
    assert 'data-felt="none"' in html and "No torque is felt: 0 N" in html and "font-size:24px" in html
    assert all(word in html for word in words)
    assert notice_html(frame(1.0)) == ""


def test_the_subject_is_not_told_a_reason_that_names_torques():
    cause = "channel 3 pulls 0.000 N.m: commanded 0.061 to 0.061"
    shown = frame(1.0, LinkState.LINKED, GuardState.LATCHED, cause)
    assert "0.061" in notice_html(shown)
    assert "0.061" not in notice_html(shown, tells_reason=False) and "No torque is felt" in notice_html(
        shown, tells_reason=False
    )


def silent(ticked_at: float, angles_at: float) -> ViewFrame:
    return replace(frame(angles_at), ticked_at=ticked_at)


@pytest.mark.parametrize(
    ("shown", "newest", "words"),
    [
        (silent(10.0, 10.0), silent(10.0, 10.0), ""),
        (silent(9.8, 9.75), silent(9.8, 9.75), ""),
        (silent(5.0, 5.0), silent(5.0, 5.0), "the engine has computed nothing since"),
        (silent(10.0, 5.0), silent(10.0, 5.0), "the glove has sent no angles since"),
        (silent(5.0, 5.0), silent(10.0, 10.0), "this page does not keep up with the engine"),
        (silent(0.0, 0.0), silent(0.0, 0.0), ""),
    ],
)
def test_a_picture_is_old_after_0_3_s_and_the_page_says_why_and_since_when(shown, newest, words):
    html = stale_notice(10.0, shown, newest)
    assert words in html and bool(html) == bool(words)
    if words:
        assert "Old picture: 5.0 s" in html and re.search(r"since \d\d:\d\d:\d\d", html)
        # What engine and glove do goes on, where the page alone is slow.
        assert ("0 N" in html) == ("page" not in words)


def test_the_page_is_covered_by_the_browser_alone_unless_it_is_renewed():
    first, second = heartbeat_html(1000.0), heartbeat_html(1000.1)
    assert first != second, "or the browser would not begin anew"
    assert (
        f"{STALE_AGE:g}s forwards" in first and "visibility:hidden" in first and "nothing new has come since" in first
    )


class NoServer:
    def get_clients(self) -> dict:
        return {}


def test_the_rate_of_frames_is_that_of_the_last_second():
    latency = Latency(NoServer())
    for k in range(60):
        latency._times.append(time.perf_counter() - 5.0 + 0.01 * k)
        latency._sent.append(0.01)
    assert latency.text() == "", "none came in the last second"
    for k in range(50):
        latency._times.append(time.perf_counter() - 0.5 + 0.01 * k)
        latency._sent.append(0.01)
    assert latency.text().startswith("50 frames a second")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Run both pages of an experiment in a thread; yield them with the slot of their frames."""
    pytest.importorskip("viser", reason="the live scene needs viser")
    from jaxgrasp.view.experiment_pages import ExperimentPages
    from jaxgrasp.view.viewer_server import serving

    slot = Slot(tmp_path_factory.mktemp("pages") / "slot", ViewFrame.size(CHANNELS, TRIAL), create=True)
    over = threading.Event()
    with serving(port=0) as first, serving(port=0) as second:
        made = ExperimentPages((first, second), felt_object(StimulusPlan("torque"), MODEL), MODEL, "torque", slot)
        made.show_initial()
        running = threading.Thread(target=made.run, args=(lambda: not over.is_set(),))
        running.start()
        yield made, slot
        over.set()
        running.join()


def send(slot: Slot, seconds: float) -> float:
    """Write frames like an engine for some seconds; return the time of the last."""
    end = time.perf_counter() + seconds
    while (timestamp := time.perf_counter()) < end:
        slot.write(frame(timestamp).vector())
        time.sleep(0.01)
    return timestamp


def becomes(condition, seconds: float) -> bool:
    end = time.perf_counter() + seconds
    while not (is_so := condition()) and time.perf_counter() < end:
        time.sleep(0.01)
    return is_so


def test_pages_of_a_frozen_engine_grey_out_and_say_since_when(pages):
    made, slot = pages
    send(slot, 0.5)
    assert becomes(lambda: not any(viewer._is_stale for viewer in made._viewers), 2.0)
    assert "0.490" in made._torques.content and not any(notice.html for notice in made._felt)
    last = send(slot, 0.3)
    assert becomes(lambda: all(viewer._is_stale for viewer in made._viewers), STALE_AGE + 1.0)
    assert time.perf_counter() - last > STALE_AGE
    assert becomes(lambda: all("Old picture" in notice.html for notice in made._felt), 1.0)
    assert becomes(lambda: "frames a second" not in made._glove.content, 2.5), "of a second ago"
    send(slot, 0.5)
    assert becomes(
        lambda: not any(viewer._is_stale or part.html for viewer, part in zip(made._viewers, made._felt)), 2.0
    )
