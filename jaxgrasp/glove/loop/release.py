"""Release program for a glove whose host has died or hangs: ``python -m jaxgrasp.glove.loop.release``.

A device without a watchdog goes on doing what it was told last. So a host of one starts this program beside it, in a
session of its own, and says at each turn that it is alive. When it falls silent, or its end of the pipe closes, which
no death can keep from happening, this program opens the port and says that nothing is resisted, again and again; a
port that is gone it waits for. It goes when it is told that the glove is free.
"""

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from typing import Any

from jaxgrasp.glove.devices import device_kind
from jaxgrasp.glove.line import LineError, SerialLine

ALIVE, DONE, READY = b".", b"!", "ready"
SILENT = 0.1
"""Time without a message after which the host counts as hung [s]."""
AGAIN = 0.02
"""Time between two attempts [s]."""
TIMES = 25
"""Number of release commands after the host's end: a device may be busy, or wait for its turn."""
LAST = 300.0
"""Time after which a port that cannot be opened is given up [s]: long enough to plug a cable in again."""


class Release:
    """Handle of a host on its release program."""

    def __init__(self, options: dict[str, Any]) -> None:
        """Start the release program, which waits for the host to fall silent.

        Args:
            options: ``device``, ``port`` and ``baud``.

        Raises:
            OSError: if it does not start.
        """
        command = [sys.executable, "-m", "jaxgrasp.glove.loop.release", json.dumps(options)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, bufsize=0
        )
        assert self.process.stdout is not None and self.process.stdin is not None
        if self.process.stdout.readline().decode().strip() != READY:
            raise OSError("the program that frees a glove of a dead host did not start")
        os.set_blocking(self.process.stdin.fileno(), False)

    def is_told(self) -> bool:
        """Send a sign of life to the release program; return True if it receives it."""
        return self._say(ALIVE)

    def close(self, *, is_free: bool) -> None:
        """Let the release program end, at once if the glove is free, else after it has freed the glove."""
        assert self.process.stdin is not None and self.process.stdout is not None
        if is_free:
            self._say(DONE)
        self.process.stdin.close()
        self.process.stdout.close()

    def _say(self, word: bytes) -> bool:
        assert self.process.stdin is not None
        try:
            # A pipe that is full is one that nobody reads.
            return self.process.poll() is None and bool(self.process.stdin.write(word))
        except OSError:
            return False


def main() -> None:
    """Listen to the host, and free the glove when the host is silent or gone."""
    options = json.loads(sys.argv[1])
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    heard = False
    while True:
        if not select.select([0], [], [], SILENT)[0]:
            if heard:
                _free(options)
            continue
        said = os.read(0, 65536)
        heard = heard or bool(said)
        if said.endswith(DONE):
            return
        if not said:
            break
    end, freed = time.perf_counter() + LAST, 0
    while freed < TIMES and time.perf_counter() < end:
        freed += _free(options)
        time.sleep(AGAIN)


def _free(options: dict[str, Any]) -> bool:
    """Send the release command, even beside a hung host that still holds the port; return True if the line took it."""
    with contextlib.suppress(LineError):
        line = SerialLine(options["port"], options["baud"], exclusive=False)
        try:
            return device_kind(options["device"]).free(line)
        finally:
            line.close()
    return False


if __name__ == "__main__":
    main()
