"""Serial line with non-blocking reads and writes."""

import contextlib
import errno
import os
import socket
import stat
from abc import ABC, abstractmethod
from typing import Any

import serial

from jaxgrasp.glove.protocol.frames import LINE_SIZE

WRITE_TIMEOUT = 0 if os.name == "nt" else 0.002
"""Longest time that a write to a full line may take [s]. Without a limit, pyserial tries for ever, except on Windows,
where it leaves the bytes to the system."""
MAX_DATAGRAMS = 65_536
"""Largest number of bytes of datagrams that one call reads, about."""
WINDOWS_PIPES = "\\\\.\\pipe\\"
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


class UdpLine(Line):
    """UDP port of this machine that receives datagrams; each counts as a piece of a stream, and nothing is sent."""

    def __init__(self, host: str, port: int) -> None:
        """Bind the port.

        Raises:
            LineError: if it cannot be bound.
        """
        self.port = f"udp:{host}:{port}"
        self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LineError(f"port {self.port} cannot be opened: {error.strerror or error}") from None
        self._socket.setblocking(False)

    def read(self) -> bytes:
        data = bytearray()
        # What comes faster than it is read is left for the next turn.
        while len(data) < MAX_DATAGRAMS:
            try:
                # Whatever a datagram holds, it spoils no line of the next.
                data += self._socket.recv(MAX_DATAGRAMS) + b"\n"
            except BlockingIOError:
                break
            except OSError as error:
                raise LineError(f"port {self.port} is gone: {error}") from None
        return bytes(data)

    def is_free(self) -> bool:
        return True

    def write(self, data: bytes) -> bool:
        return True

    def close(self) -> None:
        self._socket.close()


class PipeLine(Line):
    """Named pipe: that of a driver on Windows, to which bytes are written, or one of a file system, which is read."""

    def __init__(self, path: str, *, writes: bool = False) -> None:
        """Open a pipe that another program has made.

        Raises:
            LineError: if it cannot be opened, or if nobody reads a pipe to which bytes are to be written.
        """
        self.port = path
        flags = (os.O_WRONLY if writes else os.O_RDONLY) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        try:
            self._descriptor: int | None = os.open(path, flags)
        except OSError as error:
            raise LineError(f"pipe {path} cannot be opened: {error.strerror}") from None

    def read(self) -> bytes:
        try:
            return os.read(self._open_descriptor(), MAX_DATAGRAMS)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LineError(f"pipe {self.port} is gone: {error}") from None

    def is_free(self) -> bool:
        return True

    def write(self, data: bytes) -> bool:
        try:
            return os.write(self._open_descriptor(), data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LineError(f"pipe {self.port} is gone: {error}") from None

    def close(self) -> None:
        if self._descriptor is not None:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)
        self._descriptor = None

    def _open_descriptor(self) -> int:
        if self._descriptor is None:
            raise LineError(f"pipe {self.port} is closed")
        return self._descriptor


def open_port(port: str, baud: int, *, exclusive: bool = True) -> Line:
    r"""Open a port by its name: ``udp:HOST:PORT``, a pipe, or a serial port.

    Args:
        port: its name. A pipe of Windows, whose name begins with ``\\.\pipe``, is written; one of a file system is
            read.
        baud: of a serial port.
        exclusive: whether a serial port is for this program alone.

    Raises:
        LineError: if it cannot be opened.
        ValueError: for an address that is not ``udp:HOST:PORT``.
    """
    if port.startswith("udp:"):
        host, _, number = port[4:].rpartition(":")
        if not (host and number.isdigit() and 0 < int(number) < 65536):
            raise ValueError(f"port is {port!r}: expected udp:HOST:PORT")
        return UdpLine(host.strip("[]"), int(number))
    if port.startswith(WINDOWS_PIPES):
        return PipeLine(port, writes=True)
    return PipeLine(port) if _is_pipe(port) else SerialLine(port, baud, exclusive=exclusive)


def _is_pipe(port: str) -> bool:
    try:
        return stat.S_ISFIFO(os.stat(port).st_mode)
    except (OSError, ValueError):
        return False


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
    if _is_pipe(port):
        # To open and close a pipe would end the program at its other end.
        if not os.access(port, os.R_OK):
            raise LineError(f"pipe {port} cannot be opened: it may not be read")
        return
    open_port(port, baud).close()
