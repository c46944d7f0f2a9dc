"""Process of a simulated glove behind a pseudo-terminal: run as a module.

It reads orders as lines of JSON from its standard input, and says what happens as lines of JSON; ``Simulator`` in
``simulator.py`` runs one. Only systems with pseudo-terminals can (Linux, macOS).

Pseudo-terminal with the speed of a serial line, for programs that open it as a port.
"""

import contextlib
import fcntl
import json
import math
import os
import secrets
import select
import signal
import struct
import sys
import termios
import time
import tty
from pathlib import Path

from jaxgrasp.glove.devices import load_model
from jaxgrasp.glove.loop.child import tell
from jaxgrasp.glove.simulated.simulation import Simulation, Terminal, Throttle

PROMPT = 0.002
"""Longest time between two reads of a simulator that is not held up [s]."""


class PseudoTerminal(Terminal):
    """A pseudo-terminal under a name of its own, that can be unplugged and come back."""

    def __init__(self, link: Path, baud: int) -> None:
        self.link = link
        self.max_waiting = 0
        """Bytes that were on their way to the device at most, but for those that wait only since nobody read."""
        self._read_at, self._overdue = math.inf, 0.0
        self._incoming, self._outgoing, self._baud = Throttle(baud), Throttle(baud), baud
        self._queued = bytearray()
        self._descriptors: tuple[int, int] | None = None

    def plug(self) -> None:
        """Open a pseudo-terminal under the name, in place of a link that is there.

        Raises:
            OSError: the folder takes no link.
        """
        device_fd, host_fd = os.openpty()
        tty.setraw(host_fd)
        os.set_blocking(device_fd, False)
        self._descriptors = device_fd, host_fd
        # A random name: several terminals in one process, and links that a killed one left, have others.
        temporary = self.link.with_name(f".{self.link.name}.{secrets.token_hex(8)}")
        try:
            temporary.symlink_to(os.ttyname(host_fd))
            os.replace(temporary, self.link)
        finally:
            temporary.unlink(missing_ok=True)

    def unplug(self) -> None:
        """Close the pseudo-terminal, and remove its name unless another one has taken it."""
        if self._descriptors is not None:
            with contextlib.suppress(OSError):
                if os.readlink(self.link) == os.ttyname(self._descriptors[1]):
                    self.link.unlink()
            for end in self._descriptors:
                os.close(end)
            self._descriptors = None
            self._queued.clear()
            self._read_at, self._overdue = math.inf, 0.0

    def read(self, timestamp: float) -> bytes:
        """Return the bytes that the line has carried to the device by now."""
        if self._descriptors is None:
            return b""
        waiting = struct.unpack("i", fcntl.ioctl(self._descriptors[0], termios.FIONREAD, b"\0" * 4))[0]
        n_passed = self._incoming.n_passing(timestamp, waiting)
        # A real line carries on while a simulator sleeps; here, what it would have carried waits until all is through.
        self._overdue += max(0.0, timestamp - self._read_at - PROMPT) * self._baud / 10
        self._read_at = timestamp
        self.max_waiting = max(self.max_waiting, waiting - n_passed - math.ceil(self._overdue))
        if n_passed == waiting:
            self._overdue = 0.0
        return os.read(self._descriptors[0], n_passed) if n_passed else b""

    def is_free(self) -> bool:
        return self._descriptors is not None and not self._queued

    def queue(self, data: bytes) -> None:
        self._queued += data

    def write(self, timestamp: float) -> None:
        """Let out what the line has carried from the device by now; a host that does not read loses it."""
        n_passed = self._outgoing.n_passing(timestamp, len(self._queued))
        if n_passed and self._descriptors is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._descriptors[0], self._queued[:n_passed])
            del self._queued[:n_passed]


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
