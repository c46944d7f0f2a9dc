"""The whole hand's tick on one device and on two, each with a core of its own: in a process of its own.

    python -m benchmarks.page.hand_devices 10000

Prints microseconds a pose by number of devices, as JSON.
"""

import sys

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

import jaxgrasp
from benchmarks import virtual_hand
from benchmarks.page.devices import say, take_cores


def main() -> None:
    count, cores = int(sys.argv[1]), take_cores()
    scene, *poses = virtual_hand.cases(virtual_hand.Plan(sizes=(), batch=count))[virtual_hand.WHOLE_HAND]
    rows = PartitionSpec("pose")

    def on(number: int):
        mesh = Mesh(np.array(jax.devices()[:number]), ("pose",))
        # The poses never talk to each other, so there is nothing for the checker to check.
        tick = jax.jit(
            jax.shard_map(
                lambda posture, placed: jaxgrasp.grip.observe(scene, posture, placed),
                mesh=mesh,
                in_specs=rows,
                out_specs=rows,
                check_vma=False,
            )
        )
        arguments = jax.device_put(tuple(poses), jax.sharding.NamedSharding(mesh, rows))
        return lambda: jax.block_until_ready(tick(*arguments))

    calls = {str(number): on(number) for number in range(1, cores + 1)}
    say(calls, count)


if __name__ == "__main__":
    main()
