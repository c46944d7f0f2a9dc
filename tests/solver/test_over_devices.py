"""Batches that are spread over devices by ``devices=``, and over processes, have the answers that they have on one."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxgrasp
from tests.batch.conftest import make_sets

SCRIPT = Path(__file__).with_name("over_devices.py")
ROOT = SCRIPT.parents[2]


def started_process(devices: int, *arguments: str) -> subprocess.Popen:
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, SCRIPT, *arguments], env=environment, **pipes)


def check(process: subprocess.Popen) -> dict:
    with process:
        try:
            shown, errors = process.communicate(timeout=1000)
        finally:
            process.kill()
    assert process.returncode == 0, errors[-2000:]
    # What carries data between processes says on stdout, as it ends, that it was connected.
    outcomes = json.loads(next(line for line in shown.splitlines() if line.startswith("{")))
    for name, (apart, _, is_same) in outcomes.items():
        assert apart <= 1e-8 and is_same, (name, apart)
    return outcomes


@pytest.mark.slow
def test_devices_of_one_machine_say_what_one_says():
    outcomes = check(started_process(4))
    assert outcomes["230 on 4"][1] == 4 and outcomes["30 on 3"][1] == 3


@pytest.mark.slow
def test_two_processes_say_what_one_says():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    processes = [started_process(2, port, str(number)) for number in range(2)]
    try:
        for process in processes:
            assert check(process)["processes"][1] == 4
    finally:
        for process in processes:
            process.kill()


def test_devices_that_are_not_there_are_said():
    sets = make_sets([3])
    grasp, wrench = sets.padded(3), sets.wrench[:, 0]
    device_count = len(jax.local_devices())
    for devices in (0, device_count + 1):
        with pytest.raises(ValueError, match=f"devices is {devices}: expected 1 to {device_count}"):
            jaxgrasp.closed_form(grasp, wrench, devices=devices)
    with pytest.raises(ValueError, match="devices is given inside jit, vmap or grad"):
        jax.jit(lambda w: jaxgrasp.closed_form(grasp, w, devices=1).forces)(wrench)
    alone, on_one = jaxgrasp.closed_form(grasp, wrench), jaxgrasp.closed_form(grasp, wrench, devices=1)
    np.testing.assert_allclose(on_one.forces, alone.forces, rtol=1e-12)
