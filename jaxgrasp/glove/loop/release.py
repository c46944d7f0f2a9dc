"""Frees a glove whose host has died: ``python -m jaxgrasp.glove.loop.release``.

A device without a watchdog goes on doing what it was told last. So a host of one starts this program beside it, in a
session of its own, and holds the other end of its standard input. The end of that input, which no death can keep from
coming, makes it open the port and say that nothing is resisted, unless a line before it said that all is done.
"""

import contextlib
import json
import subprocess
import sys
import time
from typing import Any

from jaxgrasp.glove.devices import device_kind
from jaxgrasp.glove.line import LineError, SerialLine

DONE = "done"
READY = "ready"
AGAIN = 0.02
"""Time between two attempts [s]."""
TIMES = 25
"""How often it is said: a device may be busy, or wait for its turn."""
LAST = 5.0
"""Time after which a port that cannot be opened is given up [s]."""


class Release:
    """The program, started beside its host."""

    def __init__(self, options: dict[str, Any]) -> None:
        """One that waits.

        Args:
            options: ``device``, ``port`` and ``baud``.

        Raises:
            OSError: if it does not start.
        """
        command = [sys.executable, "-m", "jaxgrasp.glove.loop.release", json.dumps(options)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self.process.stdout is not None
        if self.process.stdout.readline().strip() != READY:
            raise OSError("the program that frees a glove of a dead host did not start")

    def is_there(self) -> bool:
        """Whether it would notice."""
        return self.process.poll() is None

    def close(self) -> None:
        """Let it go: the glove is free."""
        assert self.process.stdin is not None and self.process.stdout is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(DONE + "\n")
            self.process.stdin.close()
        self.process.wait(LAST)
        self.process.stdout.close()


def main() -> None:
    """Wait for the end of the input, and free the glove."""
    options = json.loads(sys.argv[1])
    kind = device_kind(options["device"])
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    if sys.stdin.read().strip() == DONE:
        return
    end = time.perf_counter() + LAST
    said = 0
    while said < TIMES and time.perf_counter() < end:
        try:
            line = SerialLine(options["port"], options["baud"])
            try:
                kind.free(line)
                said += 1
            finally:
                line.close()
        except LineError:
            pass
        time.sleep(AGAIN)


if __name__ == "__main__":
    main()
