"""Serial line with non-blocking reads and writes."""

import contextlib
import errno
import os
from abc import ABC, abstractmethod
from typing import Any

import serial

from jaxgrasp.glove.protocol.frames import LINE_SIZE

WRITE_TIMEOUT = 0 if os.name == "nt" else 0.002
"""Longest time that a write to a full line may take [s]. Without a limit, pyserial tries for ever, except on Windows,
where it leaves the bytes to the system."""
_LINE_ERRORS: tuple[Any, ...] = (OSError, TypeError, ValueError, OverflowError)
"""Exceptions of pyserial for a lost port; a TypeError if another thread closed it, so that its descriptor is None."""
with contextlib.suppress(ImportError):
    import termios

    # pyserial passes this exception on; it is not an OSError.
    _LINE_ERRORS += (termios.error,)


class LineError(OSError):
    """Error of a line that is unplugged, closed or absent."""


class Line(ABC):
    """Interface of a byte line; no call takes longer than two milliseconds."""

    @abstractmethod
    def read(self) -> bytes:
        """Read all bytes that have arrived.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def is_free(self) -> bool:
        """Return True if at most one frame waits in the system's output queue.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def write(self, data: bytes) -> bool:
        """Send bytes; return True if the line took all of them.

        Raises:
            LineError: if the line is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the line; a line that is gone already raises nothing."""


class SerialLine(Line):
    """A serial port, or a pseudo-terminal that is one for the programs that open it."""

    def __init__(self, port: str, baud: int, *, exclusive: bool = True) -> None:
        """Open a port, if ``exclusive`` for this program alone where the system supports that.

        Raises:
            LineError: if it cannot be opened.
        """
        self.port = port
        try:
            self._serial = serial.Serial(port, baud, timeout=0, write_timeout=WRITE_TIMEOUT, exclusive=exclusive)
        except _LINE_ERRORS as error:
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            if number in (errno.EAGAIN, errno.EBUSY):
                reason = "another program has it"
            raise LineError(f"port {port} cannot be opened: {reason}") from None

    def read(self) -> bytes:
        try:
            return self._serial.read(4096)
        except _LINE_ERRORS as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def is_free(self) -> bool:
        try:
            return self._serial.out_waiting <= LINE_SIZE
        except _LINE_ERRORS as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def write(self, data: bytes) -> bool:
        try:
            return self._serial.write(data) == len(data)
        except serial.SerialTimeoutException:
            return False
        except _LINE_ERRORS as error:
            raise LineError(f"port {self.port} is gone: {error}") from None

    def close(self) -> None:
        with contextlib.suppress(*_LINE_ERRORS):
            self._serial.close()


class Pace:
    """Estimator of when a line is free for another frame, so that no frame waits behind an older one."""

    def __init__(self, baud: int, size: int) -> None:
        """Create the estimator of a line that is free.

        Args:
            baud: bits a second; ten make a byte (8N1).
            size: bytes of a frame.
        """
        self.frame_time = 10 * size / baud
        """Transfer time of a frame [s]."""
        self._free_at = 0.0

    def is_free(self, timestamp: float) -> bool:
        """Return True if at most one frame is still on its way at a time [s]."""
        return self._free_at - timestamp <= self.frame_time

    def sent(self, timestamp: float) -> None:
        """Record that a frame was given to the line at a time [s]."""
        self._free_at = max(timestamp, self._free_at) + self.frame_time


def check_port(port: str, baud: int) -> None:
    """Check that a port can be opened: open and close it.

    Raises:
        LineError: if it cannot be opened.
    """
    SerialLine(port, baud).close()
