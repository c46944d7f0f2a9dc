"""Two devices against one, each with a core of its own, in a process of its own since the page's has one core.

    python -m benchmarks.page.devices 100000

Prints microseconds a problem by number of devices, as JSON.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial

import jax

import jaxgrasp
from benchmarks.page.clock import interleaved
from jaxgrasp import Grasp
from jaxgrasp.testing.problems import problems

CORES = 2
REPEATS = 9
CONTACTS = 5


def compared(count: int, module: str = "benchmarks.page.devices") -> dict[str, float]:
    """Return the microseconds a problem on one device and on two, as a module prints them; on one alone where this
    machine has a single core."""
    output = subprocess.run(
        [sys.executable, "-m", module, str(count)], check=True, capture_output=True, text=True
    ).stdout
    return json.loads(output.splitlines()[-1])


def take_cores() -> int:
    """Make each of this process's cores a device; how many there are."""
    # The page pins itself, and its children inherit that.
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    cores = min(CORES, len(os.sched_getaffinity(0)))
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", cores)
    return cores


def say(calls: dict[str, Callable], count: int) -> None:
    """Print microseconds a problem of each call."""
    print(json.dumps({number: seconds / count * 1e6 for number, seconds in interleaved(calls, REPEATS, 60.0).items()}))


def main() -> None:
    count, cores = int(sys.argv[1]), take_cores()
    drawn = problems("ordinary", CONTACTS, count, seed=0)
    grasps = Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)

    calls = {
        str(number): partial(jaxgrasp.evaluate, grasps, drawn.wrench, methods=("B-optimum",), devices=number)
        for number in range(1, cores + 1)
    }
    say(calls, count)


if __name__ == "__main__":
    main()
