"""The serial line: bytes that come and go without ever waiting for them."""

import contextlib
import errno
import os
from abc import ABC, abstractmethod
from typing import Any

import serial

from jaxgrasp.glove.protocol.frames import LINE_SIZE

WRITE_TIMEOUT = 0 if os.name == "nt" else 0.002
"""How long a full line may hold a write [s]. Without any, pyserial tries for ever, but on Windows, where it then leaves
the bytes to the system."""
_GONE: tuple[Any, ...] = (OSError, TypeError, ValueError, OverflowError)
"""What pyserial raises for ports that are gone; a TypeError where another thread closed one, whose number is None."""
with contextlib.suppress(ImportError):
    import termios

    # It lets this one through, which is no OSError.
    _GONE += (termios.error,)


class LineError(OSError):
    """A line that is gone: unplugged, closed, or never there."""


class Line(ABC):
    """What carries bytes; no call waits longer than two milliseconds."""

    @abstractmethod
    def read(self) -> bytes:
        """All that came.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def is_free(self) -> bool:
        """Whether at most one frame waits in the system's own queue.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def write(self, data: bytes) -> bool:
        """Send; whether all of it was taken.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it; no error where it is gone already."""


class SerialLine(Line):
    """A serial port, or a pseudo-terminal that is one for the programs that open it."""

    def __init__(self, port: str, baud: int, *, exclusive: bool = True) -> None:
        """An open port, for this program alone where the system can, unless it need not be ``exclusive``.

        Raises:
            LineError: if it cannot be opened.
        """
        self.port = port
        try:
            self._serial = serial.Serial(port, baud, timeout=0, write_timeout=WRITE_TIMEOUT, exclusive=exclusive)
        except _GONE as error:
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            if number in (errno.EAGAIN, errno.EBUSY):
                reason = "another program has it"
            raise LineError(f"port {port} cannot be opened: {reason}") from None

    def read(self) -> bytes:
        try:
            return self._serial.read(4096)
        except _GONE as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def is_free(self) -> bool:
        try:
            return self._serial.out_waiting <= LINE_SIZE
        except _GONE as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def write(self, data: bytes) -> bool:
        try:
            return self._serial.write(data) == len(data)
        except serial.SerialTimeoutException:
            return False
        except _GONE as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def close(self) -> None:
        with contextlib.suppress(*_GONE):
            self._serial.close()


class Pace:
    """When a line is free for another frame: none is queued where an older one would go before it."""

    def __init__(self, baud: int, size: int) -> None:
        """A line that is free.

        Args:
            baud: bits a second; ten make a byte (8N1).
            size: bytes of a frame.
        """
        self.frame_time = 10 * size / baud
        """How long a frame takes [s]."""
        self._free_at = 0.0

    def is_free(self, now: float) -> bool:
        """Whether at most one frame is still on its way."""
        return self._free_at - now <= self.frame_time

    def sent(self, now: float) -> None:
        """A frame was given to the line."""
        self._free_at = max(now, self._free_at) + self.frame_time


def check_port(port: str, baud: int) -> None:
    """A port that cannot be opened is said before anything else is done.

    Raises:
        LineError: if it cannot be opened.
    """
    SerialLine(port, baud).close()
