"""``jaxgrasp glove test``: a sound glove has no fault, and each fault is named by its joint."""

import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxgrasp.cli.glove_bench import Listened, judge_motion, judge_pull, judge_rest
from jaxgrasp.cli.main import main
from jaxgrasp.glove.model import FLEXIONS
from jaxgrasp.glove.other_devices.doglove import ACCEPTANCE, doglove

MODEL = doglove()
COUNT = len(MODEL.joints)
POSIX = pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")


def listened(angles: np.ndarray, causes=()) -> Listened:
    times = np.linspace(0, 2, len(angles))
    return Listened(2.0, times, angles, tuple(causes))


def test_a_hand_at_rest():
    rng = np.random.default_rng(0)
    angles = rng.normal(0, 0.1, (200, COUNT))
    assert judge_rest(listened(angles), MODEL) == []
    angles[:, 3] += 55
    angles[:, 5] = np.where(np.arange(200) % 2, 3.0, -3.0)
    angles[:, 7] = math.nan
    findings = judge_rest(listened(angles, ["the cable is out"]), MODEL)
    assert [finding.split(":")[0] for finding in findings] == [
        "the link was lost",
        f"{FLEXIONS[3]} reads 55 degrees on the flat hand",
        f"{FLEXIONS[5]} moves by 3.0 degrees (standard deviation) though the hand rests",
        f"{FLEXIONS[7]} reads no number",
    ]
    assert judge_rest(listened(np.zeros((20, COUNT))), MODEL) == ["angles came 10 times a second: expected at least 30"]
    assert judge_rest(listened(np.zeros((0, COUNT))), MODEL) == ["no angles came"]


def test_a_hand_that_bends():
    phases = np.linspace(0, 20, 500)
    bend = np.where(["abduction" in joint for joint in MODEL.joints], 10.0, 60.0)
    angles = bend * (1 - np.cos(phases))[:, None] / 2
    assert judge_motion(listened(angles), MODEL) == []
    angles[:, 4] = 12.0
    angles[:, 6] *= -1
    angles[:, 15] *= 0.1
    findings = judge_motion(listened(angles), MODEL)
    assert len(findings) == 3 and findings[0].startswith(
        f"{MODEL.joints[4]} moved by 0.0 degrees: expected at least 25"
    )
    assert findings[1].startswith(f"{MODEL.joints[6]} counts down as it bends, to -60 degrees")
    assert findings[2].startswith(f"{MODEL.joints[15]} moved by 1.0 degrees: expected at least 5")


def test_a_motor_that_pulls():
    commanded = np.zeros((50, COUNT))
    commanded[:, 2] = 0.015
    assert judge_pull(MODEL, 2, commanded, commanded * 0.9) == []
    assert "pulled 0.0000 N.m: commanded 0.0150" in judge_pull(MODEL, 2, commanded, 0 * commanded)[0]
    swapped = np.roll(commanded, 3, axis=1)
    assert judge_pull(MODEL, 2, commanded, swapped)[1] == (
        "middle MP pulled 0.0150 N.m as index MP was to pull: are they swapped?"
    )
    assert "is not measured" in judge_pull(MODEL, 2, commanded, commanded * math.nan)[0]


def test_pull_needs_motors_with_torque(folder, capsys):
    for device, message in (
        ("openxr", "pull was given, and OpenXR hand tracking has no motor"),
        ("lucidgloves", "pull was given, and LucidGloves resists by position limit, not by torque"),
    ):
        assert main(["glove", "test", "--device", device, "--port", "udp:127.0.0.1:9310", "--pull"]) == 1
        assert message in capsys.readouterr().err
    assert main(["glove", "test", "--device", "doglove"]) == 1
    assert "joints_from is None for the device doglove" in capsys.readouterr().err


@POSIX
@pytest.mark.slow
@pytest.mark.always
@pytest.mark.realtime
@pytest.mark.parametrize("fault", ["", "encoder"])
def test_a_simulated_doglove_at_the_bench(tmp_path, fault):
    from tests.glove.doglove_hardware import Hardware

    hardware = Hardware(tmp_path, "limp")
    begin = math.inf

    def move(timestamp: float) -> None:
        flexion = 40 * (1 - math.cos(4 * max(timestamp - begin, 0.0)))
        hardware.glove.bend(flexion)
        for k in (2, 6, 9, 12, 15):
            hardware.glove.board.degrees[k] = 180 + flexion / 4
        if fault:
            hardware.glove.board.degrees[8] = 270.0

    hardware.moves = move
    hardware.start()
    arguments = ["--device", "doglove", "--port", str(hardware.servos.link), "--joints-from", str(hardware.board.link)]
    command = [sys.executable, "-m", "jaxgrasp.cli.main", "glove", "test", *arguments, "--seconds", "4", "--pull"]
    lines = []
    try:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            for line in process.stdout:
                lines.append(line)
                if line.startswith("bend and stretch"):
                    begin = time.perf_counter()
                elif line.startswith("keep the fingers"):
                    hardware.moves = lambda timestamp: hardware.glove.bend(30.0)
                elif "type: " in line:
                    process.stdin.write(ACCEPTANCE + "\n")
                    process.stdin.flush()
    finally:
        hardware.is_over = True
        hardware.join()
    text = "".join(lines)
    assert process.returncode == (1 if fault else 0), text
    wrong = [line for line in lines if line.startswith("wrong")]
    assert [line.split(" moved")[0] for line in wrong] == (["wrong: middle PIP"] if fault else []), text
    assert "index MP: commanded 0.0150 N.m, measured 0.01" in text
