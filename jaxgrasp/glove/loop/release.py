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

from jaxgrasp.glove.devices import find_device_class
from jaxgrasp.glove.line import LineError, open_port
from jaxgrasp.glove.other_devices.doglove import BOARD_BAUD

ALIVE, DONE, READY = b".", b"!", "ready"
MAX_SILENCE = 0.1
"""Time without a message after which the host counts as hung [s]."""
RETRY_INTERVAL = 0.02
"""Time between two attempts [s]."""
ATTEMPTS = 25
"""Number of release commands after the host's end: a device may be busy, or wait for its turn."""
GIVE_UP = 300.0
"""Time after which a port that cannot be opened is given up [s]: long enough to plug a cable in again."""


class Release:
    """Handle of a host on its release program."""

    def __init__(self, options: dict[str, Any]) -> None:
        """Start the release program, which waits for the host to fall silent.

        Args:
            options: ``device``, ``port`` and ``baud``, and ``joints_from`` of a device that vibrates by that line.

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

    def signal_alive(self) -> bool:
        """Send a sign of life to the release program; return True if it receives it."""
        return self._write(ALIVE)

    def close(self, *, is_free: bool) -> None:
        """Let the release program end, at once if the glove is free, else after it has freed the glove."""
        assert self.process.stdin is not None and self.process.stdout is not None
        if is_free:
            self._write(DONE)
        self.process.stdin.close()
        self.process.stdout.close()

    def _write(self, word: bytes) -> bool:
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
    was_heard = False
    while True:
        if not select.select([0], [], [], MAX_SILENCE)[0]:
            if was_heard:
                _release(options)
            continue
        data = os.read(0, 65536)
        was_heard = was_heard or bool(data)
        if data.endswith(DONE):
            return
        if not data:
            break
    end, n_written = time.perf_counter() + GIVE_UP, 0
    while n_written < ATTEMPTS and time.perf_counter() < end:
        n_written += _release(options)
        time.sleep(RETRY_INTERVAL)


def _release(options: dict[str, Any]) -> bool:
    """Send the release command, even beside a hung host that still holds the port; return True if the line took it."""
    device, is_freed = find_device_class(options["device"]), False
    with contextlib.suppress(LineError):
        line = open_port(options["port"], options["baud"], exclusive=False)
        try:
            is_freed = device.free(line)
        finally:
            line.close()
    if device.silences_second_line and options.get("joints_from"):
        with contextlib.suppress(LineError):
            line = open_port(options["joints_from"], BOARD_BAUD, exclusive=False)
            try:
                device.silence(line)
            finally:
                line.close()
    return is_freed


if __name__ == "__main__":
    main()
