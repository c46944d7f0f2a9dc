"""Batches that are spread over devices by ``devices=``, and over processes, have the answers that they have on one."""

import json
import os
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxgrasp
from tests.batch.conftest import make_sets

SCRIPT = Path(__file__).with_name("over_devices.py")
ROOT = SCRIPT.parents[2]


def outcomes_of(folder: Path, devices: int, *processes: tuple[str, ...]) -> list[dict]:
    """Run the script in processes with these arguments at the same time, and return what each found."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
    outputs = [folder / f"outcomes-{number}.json" for number in range(len(processes))]
    with ThreadPoolExecutor() as pool:
        runs = pool.map(
            lambda output, arguments: subprocess.run(
                [sys.executable, SCRIPT, output, *arguments],
                env=environment,
                text=True,
                capture_output=True,
                timeout=1000,
            ),
            outputs,
            processes,
        )
    for run in runs:
        assert run.returncode == 0, run.stderr[-2000:]
    found = [json.loads(output.read_text()) for output in outputs]
    for outcomes in found:
        for name, (apart, _, is_same) in outcomes.items():
            assert apart <= 1e-8 and is_same, (name, apart)
    return found


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
