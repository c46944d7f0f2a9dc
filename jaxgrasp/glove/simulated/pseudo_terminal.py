"""Pseudo-terminal with the speed of a serial line, for programs that open it as a port."""

import contextlib
import fcntl
import math
import os
import secrets
import struct
import termios
import tty
from pathlib import Path

from jaxgrasp.glove.simulated.slow_line import Terminal, Throttle

PROMPT = 0.002
"""Longest time between two reads of a simulator that is not held up [s]."""


class PseudoTerminal(Terminal):
    """A pseudo-terminal under a name of its own, that can be unplugged and come back."""

    def __init__(self, link: Path, baud: int) -> None:
        self.link = link
        self.most_waiting = 0
        """Bytes that were on their way to the device at most, but for those that wait only since nobody read."""
        self._read_at, self._overdue = math.inf, 0.0
        self._coming, self._going, self._baud = Throttle(baud), Throttle(baud), baud
        self._out = bytearray()
        self._ends: tuple[int, int] | None = None

    def plug(self) -> None:
        """Open a pseudo-terminal under the name, in place of a link that is there.

        Raises:
            OSError: the folder takes no link.
        """
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self._ends = ours, theirs
        # A random name: several terminals in one process, and links that a killed one left, have others.
        beside = self.link.with_name(f".{self.link.name}.{secrets.token_hex(8)}")
        try:
            beside.symlink_to(os.ttyname(theirs))
            os.replace(beside, self.link)
        finally:
            beside.unlink(missing_ok=True)

    def unplug(self) -> None:
        """Close the pseudo-terminal, and remove its name unless another one has taken it."""
        if self._ends is not None:
            with contextlib.suppress(OSError):
                if os.readlink(self.link) == os.ttyname(self._ends[1]):
                    self.link.unlink()
            for end in self._ends:
                os.close(end)
            self._ends = None
            self._out.clear()
            self._read_at, self._overdue = math.inf, 0.0

    def read(self, now: float) -> bytes:
        """Return the bytes that the line has carried to the device by now."""
        if self._ends is None:
            return b""
        waiting = struct.unpack("i", fcntl.ioctl(self._ends[0], termios.FIONREAD, b"\0" * 4))[0]
        through = self._coming.pass_on(now, waiting)
        # A real line carries on while a simulator sleeps; here, what it would have carried waits until all is through.
        self._overdue += max(0.0, now - self._read_at - PROMPT) * self._baud / 10
        self._read_at = now
        self.most_waiting = max(self.most_waiting, waiting - through - math.ceil(self._overdue))
        if through == waiting:
            self._overdue = 0.0
        return os.read(self._ends[0], through) if through else b""

    def is_free(self) -> bool:
        return self._ends is not None and not self._out

    def queue(self, data: bytes) -> None:
        self._out += data

    def write(self, now: float) -> None:
        """Let out what the line has carried from the device by now; a host that does not read loses it."""
        through = self._going.pass_on(now, len(self._out))
        if through and self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], self._out[:through])
            del self._out[:through]
