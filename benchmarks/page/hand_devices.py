"""The whole hand's tick on one device and on two, each with a core of its own: in a process of its own.

    python -m benchmarks.page.hand_devices 10000

Prints microseconds a pose by number of devices, as JSON.
"""

import json
import os
import subprocess
import sys

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

import jaxgrasp
from benchmarks import virtual_hand
from benchmarks.page.clock import interleaved
from benchmarks.page.devices import CORES, REPEATS


def compared(count: int) -> dict[str, float]:
    """Microseconds a pose on one device and on two; on one alone where this machine has a single core."""
    command = [sys.executable, "-m", "benchmarks.page.hand_devices", str(count)]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(said.splitlines()[-1])


def main() -> None:
    count = int(sys.argv[1])
    # Importing the benchmark pinned this process to one core.
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    cores = min(CORES, len(os.sched_getaffinity(0)))
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", cores)
    scene, *poses = virtual_hand.cases(virtual_hand.Plan(sizes=(), batch=count))[virtual_hand.WHOLE]
    rows = PartitionSpec("pose")

    def on(number: int):
        mesh = Mesh(np.array(jax.devices()[:number]), ("pose",))
        # The poses never talk to each other, so there is nothing for the checker to check.
        tick = jax.jit(
            jax.shard_map(
                lambda posture, placed: jaxgrasp.observe(scene, posture, placed),
                mesh=mesh,
                in_specs=rows,
                out_specs=rows,
                check_vma=False,
            )
        )
        given = jax.device_put(tuple(poses), jax.sharding.NamedSharding(mesh, rows))
        return lambda: jax.block_until_ready(tick(*given))

    calls = {str(number): on(number) for number in range(1, cores + 1)}
    print(json.dumps({number: seconds / count * 1e6 for number, seconds in interleaved(calls, REPEATS, 60.0).items()}))


if __name__ == "__main__":
    main()
