"""Robot, network and both hosts as processes: torque at the glove is gone in time, whichever of them dies or stalls.

As for the glove's own processes, what is judged is what holds torque by the device's own clock.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.simulated.simulator import Simulator, read_record
from jaxgrasp.hand import human_hand
from jaxgrasp.teleop.follower import PalmPose
from jaxgrasp.teleop.live import OLDEST, RobotElsewhere, run_person
from jaxgrasp.teleop.session import PersonSide, RobotMessage

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals"),
]
HERE = Path(__file__).parent


def start(name, *arguments):
    """Start a process of this folder; return it with the port that it prints."""
    command = [sys.executable, str(HERE / name), *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(HERE.parent.parent)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    return process, int(process.stdout.readline())


@pytest.mark.parametrize("end", ["robot killed", "robot stalled", "network killed", "person's side ends"])
def test_torque_is_gone_in_time(tmp_path, end):
    robot, robot_port = start("robot_process.py")
    relay, relay_port = start("relay_process.py", robot_port)
    over = threading.Event()
    model, person = lrp_hand_master(), human_hand()
    link = NetworkLink("127.0.0.1", relay_port, RobotMessage.size(14), oldest=OLDEST)
    near, pose = PersonSide(person, model, 0.004), PalmPose(np.zeros(3), np.eye(3))
    record = tmp_path / "record"
    try:
        with (
            Simulator(record=str(record), record_every=0.001) as simulator,
            GloveProcess(simulator.port, 14, scale=1.0, ramp=0.2) as glove,
        ):
            # The hand flexes on, so that the port has energy to give.
            simulator.order(bend=[0.6] * 14, lasts=0.3)
            side = (near, RobotElsewhere(link), glove.state, glove.write, lambda _: pose, np.zeros(19), 250.0)
            loop = threading.Thread(target=run_person, args=(*side, lambda _: not over.is_set()))
            loop.start()
            hold(glove)
            since = time.perf_counter()
            if end == "person's side ends":
                over.set()
            elif end == "robot stalled":
                robot.send_signal(signal.SIGSTOP)
            else:
                (robot if end.startswith("robot") else relay).kill()
            time.sleep(0.3)
            record_now = read_record(record)
            last = record_now["time"][record_now["counts"].any(axis=1)][-1]
            assert last - since <= 0.055 + 0.02, "20 ms for processes that must wait their turn"
            assert glove.state().guard == GuardState.LATCHED
            if end != "person's side ends":
                assert "silent" in near.trouble
            over.set()
            loop.join()
    finally:
        over.set()
        for process in (robot, relay):
            process.kill()
            process.wait()
            process.stdout.close()
        link.close()


def hold(glove):
    """Arm until torque flows."""
    end = time.perf_counter() + 20
    while time.perf_counter() < end:
        state = glove.state()
        if state is not None and state.link == LinkState.LINKED:
            try:
                glove.arm()
            except ValueError:
                time.sleep(0.05)
                continue
            until = time.perf_counter() + 2
            while time.perf_counter() < until:
                if glove.state().torques.max() > 0.02:
                    return
                time.sleep(0.002)
        time.sleep(0.01)
    raise AssertionError(f"never armed: {glove.events()[-4:]}")
