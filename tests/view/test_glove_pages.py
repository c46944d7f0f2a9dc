"""Pages beside a glove, in a real browser: a DOGlove worn as its own linkage, and a teleoperated robot hand."""

import contextlib
import os
import re
import time

import numpy as np
import pytest

from jaxgrasp.glove import Simulator
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.other_devices.doglove import ACCEPTANCE
from jaxgrasp.hand import closing_kinematics, human_hand
from jaxgrasp.report.look import SKIN_COLOUR
from tests.cli.test_glove import Bench
from tests.cli.test_glove_run_devices import gripped, until
from tests.glove.doglove_hardware import Hardware
from tests.view.conftest import of_colour, picture_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals"),
]


def test_the_page_draws_the_caps_follows_the_joints_and_says_the_torques(browser, tmp_path):
    """`glove run --linkage --view`: caps drawn and moved by the glove's angles, torques by the linkage's joints."""
    made, opened, closed = gripped("ball", linkage=True)
    hardware = Hardware(tmp_path, "limp")
    share = [0.0]

    def move(timestamp: float) -> None:
        hardware.pose_linkage(opened + share[0] * (closed - opened))

    hardware.moves = move
    hardware.start()
    ports = ["--port", str(hardware.servos.link), "--joints-from", str(hardware.board.link)]
    options = ["--device", "doglove", "--linkage", "--law", "closed-form", "--view", "--view-port", "0"]
    try:
        with Bench("ball", *options, *ports) as run:
            address = re.search(r"http://\S+", run.line())
            assert address and "ready" in run.line()
            browser.open(address[0])
            browser.waits_for(lambda: of_colour(picture_of(browser, tmp_path / "a.png"), SKIN_COLOUR) > 3_000)
            assert browser.says("No torque is felt: 0 N")
            browser.close_notes()
            before = picture_of(browser, tmp_path / "open.png")
            again = picture_of(browser, tmp_path / "again.png")
            run.insist(ACCEPTANCE)
            # Half way to the ball nothing touches yet, and the caps have moved.
            share[0] = 0.4
            browser.page.wait_for_timeout(2000)
            after = picture_of(browser, tmp_path / "moved.png")
            assert np.abs(after - before).mean() > 5 * np.abs(again - before).mean()
            share[0] = 1.1
            for _ in range(15):
                # On a busy machine the glove lets go now and then.
                run.insist("full")
                if until(lambda: hardware.glove.held() > 50, 4.0):
                    break
            browser.waits_for(lambda: browser.page.locator('[data-felt="none"]').count() == 0, 20.0)
            rows = browser.page.locator("[data-joint]").evaluate_all("rows => rows.map(row => row.dataset.joint)")
            assert rows == list(made.scene.hand.joints)
            run.leave()
    finally:
        hardware.is_over = True
        hardware.join()
    time.sleep(0.2)
    assert hardware.glove.held() == 0
    assert browser.errors == [] or all("WebSocket" in error for error in browser.errors)


def test_a_teleoperated_robot_is_drawn_and_its_page_says_why_nothing_is_felt(browser, tmp_path):
    """`teleop --glove --view`: browser, page, robot, line and glove are five processes; the robot's hand follows."""
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics")
    wearer, model = human_hand(), lrp_hand_master()
    closing = closing_kinematics(wearer)
    opened, closed = (np.asarray(angles)[list(model.joint_indices(wearer.joints))] for angles in closing[:2])
    with contextlib.ExitStack() as stack:
        glove = stack.enter_context(Simulator())
        options = ["--scene", "peg", "--glove", glove.port, "--view", "--view-port", "0"]
        run = stack.enter_context(Bench(*options, command=("teleop",)))
        address = re.search(r"http://\S+", run.line())
        assert address and "ready" in run.line()
        glove.order(bend=(opened + 0.25 * (closed - opened)).tolist(), lasts=0.1)
        browser.open(address[0])
        browser.waits_for(lambda: browser.says("No torque is felt: 0 N"))
        browser.waits_for(lambda: browser.says("the robot follows"))
        browser.close_notes()
        before = picture_of(browser, tmp_path / "open.png")
        glove.order(bend=(opened + 0.56 * (closed - opened)).tolist(), lasts=0.5)
        browser.page.wait_for_timeout(4000)
        after = picture_of(browser, tmp_path / "closed.png")
        assert np.abs(after - before).mean() > 1e-3, "the robot's hand has closed"
        glove.close()
        browser.waits_for(lambda: browser.says("the glove is gone"), 20.0)
        assert browser.says("No torque is felt: 0 N")
