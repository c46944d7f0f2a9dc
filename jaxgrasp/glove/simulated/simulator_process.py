"""Process of a simulated glove behind a pseudo-terminal: run as a module.

It reads orders as lines of JSON from its standard input, and says what happens as lines of JSON; ``Simulator`` in
``simulator.py`` runs one. Only systems with pseudo-terminals can (Linux, macOS).
"""

import json
import os
import select
import signal
import sys
import time
from pathlib import Path

from jaxgrasp.glove.calibrate import load_model
from jaxgrasp.glove.loop.child import tell
from jaxgrasp.glove.simulated.pseudo_terminal import PseudoTerminal
from jaxgrasp.glove.simulated.simulation import Simulation

PERIOD = 0.001
"""Period of the simulator's loop [s]."""


def main() -> None:
    """Run until the standard input ends."""
    # An interrupt at the terminal is for whoever started it, and ends its input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    options = json.loads(sys.argv[1])
    terminal = PseudoTerminal(Path(options["port"]), options.get("baud", 115_200))
    simulation = Simulation(options, terminal, time.perf_counter(), tell, *load_model(options))
    terminal.plug()
    tell({"port": options["port"], "at": time.perf_counter()})
    orders, next_step = b"", time.perf_counter()
    try:
        while True:
            if select.select([0], [], [], max(0.0, next_step - time.perf_counter()))[0]:
                data = os.read(0, 65536)
                if not data:
                    return
                *lines, orders = (orders + data).split(b"\n")
                for line in lines:
                    simulation.obey(json.loads(line), time.perf_counter())
            timestamp = time.perf_counter()
            if timestamp >= next_step:
                simulation.step(timestamp)
                next_step = max(next_step + PERIOD, timestamp)
    finally:
        simulation.close()


if __name__ == "__main__":
    main()
