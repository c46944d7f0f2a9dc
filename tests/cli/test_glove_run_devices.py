"""``jaxgrasp glove run`` with other devices and with vibration, end to end: real processes, simulated devices."""

import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.other_devices.doglove import ACCEPTANCE
from jaxgrasp.glove.other_devices.openxr import openxr

POSIX = pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--substitution"], "substitution is felt in a glove: pass --port or --connect"),
        (["--connect", "127.0.0.1:5600", "--warmest", "40"], "warmest is 40, for --substitution: add --substitution"),
        (["--connect", "127.0.0.1:5600", "--substitution", "--warmest", "50"], "warmest is 50: expected 34 to 42"),
        (
            ["--device", "openxr", "--port", "udp:127.0.0.1:9321", "--substitution"],
            "substitution was given, and the device openxr has no vibration",
        ),
    ],
)
def test_substitution_needs_a_glove_that_vibrates(capsys, arguments, message):
    assert main(["glove", "run", *arguments]) == 1
    assert message in capsys.readouterr().err


def bench(*arguments: str):
    # Imported here, since a test module imports this one's neighbour.
    from tests.cli.test_glove import Bench

    return Bench(*arguments)


def gripped(scene: str = "cylinder", linkage: bool = False):
    """Hand of the scene: names of its joints, its open and its closed angles."""
    from jaxgrasp.grip.scene_file import load_scene, scene_path
    from jaxgrasp.lab.loaded_scene import loaded_scene

    made = loaded_scene(load_scene(scene_path(scene)), linkage)
    return made, np.asarray(made.open), np.asarray(made.closed.angles)


def until(is_so: Callable[[], bool], seconds: float) -> bool:
    end = time.perf_counter() + seconds
    while not is_so() and time.perf_counter() < end:
        time.sleep(0.01)
    return is_so()


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("end", ["quit", "SIGKILL"])
def test_a_doglove_grips_by_its_own_linkage_and_vibrates(tmp_path, end):
    """A person closes the glove on a ball: servos pull and fingers vibrate, and both end with the program."""
    from tests.glove.doglove_hardware import Hardware

    _, opened, closed = gripped("ball", linkage=True)
    hardware = Hardware(tmp_path, "limp")
    began = [np.inf]

    def move(timestamp: float) -> None:
        # So far that the law asks for more than the servos give, which is felt as long as it lasts.
        share = 1.15 * min(max(timestamp - began[0], 0.0) / 2.0, 1.0)
        hardware.pose_linkage(opened + share * (closed - opened))

    hardware.moves = move
    hardware.start()
    ports = ["--port", str(hardware.servos.link), "--joints-from", str(hardware.board.link)]
    board = hardware.glove.board
    try:
        options = ["--linkage", "--substitution", "--law", "closed-form"]
        with bench("ball", "--device", "doglove", *options, *ports) as run:
            assert "ready" in run.line()
            assert f"type: {ACCEPTANCE}" in run.answer("arm")
            run.insist(ACCEPTANCE)
            assert not any(wave for wave, _ in board.waves), "an open hand"
            began[0] = time.perf_counter()
            for _ in range(15):
                # On a busy machine the glove lets go now and then: it is armed anew, with the ball in the hand.
                run.insist("full")
                if until(lambda: hardware.glove.held() > 50 and any(wave for wave, _ in board.waves), 4.0):
                    break
            else:
                raise AssertionError("".join(run._printed))
            vibrated = {channel for _, channel, wave in board.played if wave}
            assert vibrated <= {0, 1, 2}, "thumb, index and middle finger touch"
            if end == "quit":
                run.leave()
            else:
                owner = _owner(str(hardware.servos.link))
                os.kill(owner, 9)
            ended = time.perf_counter()
            assert until(lambda: hardware.glove.held() == 0 and not any(wave for wave, _ in board.waves), 3.0)
            assert time.perf_counter() - ended < 1.0
            time.sleep(0.3)
            assert hardware.glove.held() == 0 and not any(wave for wave, _ in board.waves)
    finally:
        hardware.is_over = True
        hardware.join()


def _owner(port: str) -> int:
    """Process that owns the glove's line."""
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_bytes().decode(errors="ignore")
            if "jaxgrasp.glove.loop.io_process" in command and port in command:
                return int(entry.name)
    raise AssertionError(f"no process owns {port}")


def free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


@contextlib.contextmanager
def tracked_hand(ports: list[int], joints, opened: np.ndarray, closed: np.ndarray):
    """Yield a function that says to a process beside what its tracked hand does."""
    options = {"ports": ports, "open": dict(zip(joints, opened.tolist())), "closed": dict(zip(joints, closed.tolist()))}
    command = [sys.executable, "-m", "tests.glove.openxr_sender", json.dumps(options)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as sender:

        def say(word: str) -> None:
            sender.stdin.write(word + "\n")
            sender.stdin.flush()

        yield say
        sender.stdin.close()


@pytest.mark.slow
@pytest.mark.realtime
def test_a_tracked_hand_lifts_the_object_over_udp():
    """Sender, line and engine are three processes; what the hand grips comes with it, and forces are asked for."""
    from jaxgrasp.cli.glove_run import Wrist
    from jaxgrasp.glove.line import open_port
    from jaxgrasp.glove.loop.glove_process import GloveProcess
    from jaxgrasp.glove.other_devices.openxr import WristTracker
    from jaxgrasp.lab.haptic_loop import Haptics, pose_at, run_loop

    scene, opened, closed = gripped()
    model, joints = openxr(), scene.scene.hand.joints
    haptics = Haptics(scene.scene, model, closed, scene.placed)
    haptics.warm_up(pose_at(np.zeros(3)))
    first, second = free_ports(2)
    squeezed = closed + 0.04 * (closed - opened)
    tracker = WristTracker(open_port(f"udp:127.0.0.1:{second}", 115_200))
    wrist = Wrist(tracker)
    asked: dict[str, float] = {}
    schedule = {"open": 2.5, "close": 5.0, "lift": 8.0}
    with (
        GloveProcess(f"udp:127.0.0.1:{first}", len(model.joints), device="openxr") as glove,
        tracked_hand([first, second], joints, opened, squeezed) as say,
        contextlib.closing(tracker),
    ):

        def goes_on(timestamp: float) -> bool:
            state = glove.state()
            for word, end in schedule.items():
                if timestamp - started < end:
                    if word not in asked:
                        say(word)
                    now = 0.0 if state is None else float(np.nan_to_num(state.asked).max())
                    # The hand opens first; later, nothing is asked for where a law came too late.
                    asked[word] = now if word == "open" else max(asked.get(word, 0.0), now)
                    return True
            return False

        for _ in range(3):
            # On a busy machine, ticks that are far apart may lose the object.
            haptics.restart(scene.scene, scene.placed)
            asked.clear()
            started = time.perf_counter()
            run_loop(haptics.tick, glove.state, glove.write, wrist, 100.0, goes_on)
            rise = float(haptics.placed.origin[2] - scene.placed.origin[2])
            if rise > 0.03:
                break
    assert asked["open"] < 1e-3, "an open hand touches nothing"
    assert asked["close"] > 0.005 and asked["lift"] > 0.005
    assert rise > 0.03, "lifted by five centimetres, less what slips"


@pytest.mark.slow
@pytest.mark.realtime
def test_the_command_runs_and_shows_a_tracked_hand(folder):
    pytest.importorskip("viser")
    scene, opened, closed = gripped()
    first, second = free_ports(2)
    ports = ["--port", f"udp:127.0.0.1:{first}", "--tracker", f"udp:127.0.0.1:{second}", "--tracker-protocol", "openxr"]
    with (
        tracked_hand([first, second], scene.scene.hand.joints, opened, closed) as say,
        bench("cylinder", "--device", "openxr", *ports, "--view", "--view-port", "0") as run,
    ):
        page = re.search(r"http://\S+", run.line())
        assert page and "ready" in run.line()
        say("close")
        # Right after the start, or on a busy machine, there may be no fresh law.
        answers = (run.answer("arm") for _ in range(40) if not time.sleep(0.1))
        assert any("hand tracking resists nothing: forces are shown instead of felt" in answer for answer in answers)
        with urllib.request.urlopen(page[0], timeout=20) as answer:
            assert answer.status == 200
        time.sleep(2.0)
        output = run.leave()
    assert "the glove let go by itself: never" in output and "no torque was cut" in output
    turns = int(re.search(r"the engine: (\d+) turns", output)[1])
    assert turns > 100


@POSIX
@pytest.mark.slow
@pytest.mark.realtime
def test_a_glove_of_our_protocol_vibrates_where_the_virtual_hand_touches():
    from jaxgrasp.glove import Simulator

    scene, opened, closed = gripped()
    channels = list(lrp_hand_master().joint_indices(scene.scene.hand.joints))
    with Simulator() as simulator, bench("cylinder", "--port", simulator.port, "--substitution") as run:
        simulator.order(bend=opened[channels].tolist(), lasts=0.1)
        assert "ready" in run.line()
        time.sleep(1.0)
        before = len(simulator.vibrations())
        simulator.order(bend=closed[channels].tolist(), lasts=1.0)
        assert until(lambda: len(simulator.vibrations()) > before, 10.0)
        time.sleep(1.0)
        # Each event is the begin of a vibration after silence: contact begins with 600 of 1000.
        largest = np.max([event["amplitudes"] for event in simulator.vibrations()], axis=0)
        assert 300 < largest.max() <= 1000
        run.leave()
