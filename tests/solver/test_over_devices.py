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


def outcomes_of(folder: Path, devices: int, *processes: tuple[str, ...]) -> list[dict]:
    """Run the script in processes with these arguments at the same time, and return the outcomes of each."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
    outputs = [folder / f"outcomes-{number}.json" for number in range(len(processes))]
    errors = [output.with_suffix(".errors") for output in outputs]
    started: list[subprocess.Popen] = []
    try:
        for output, path, arguments in zip(outputs, errors, processes, strict=True):
            command = [sys.executable, SCRIPT, output, *arguments]
            with path.open("w") as stream:
                started.append(subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=stream))
        for process, path in zip(started, errors, strict=True):
            assert process.wait(timeout=1000) == 0, path.read_text()[-2000:]
    finally:
        # One that failed leaves the other waiting.
        for process in started:
            process.kill()
            process.wait()
    all_outcomes = [json.loads(output.read_text()) for output in outputs]
    for outcomes in all_outcomes:
        for name, (apart, _, is_same) in outcomes.items():
            assert apart <= 1e-8 and is_same, (name, apart)
    return all_outcomes


@pytest.mark.slow
def test_devices_of_one_machine_say_what_one_says(tmp_path):
    (outcomes,) = outcomes_of(tmp_path, 4, ())
    assert outcomes["230 on 4"][1] == 4 and outcomes["30 on 3"][1] == 3


@pytest.mark.slow
def test_two_processes_say_what_one_says(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    for outcomes in outcomes_of(tmp_path, 2, (port, "0"), (port, "1")):
        assert outcomes["processes"][1] == 4


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
