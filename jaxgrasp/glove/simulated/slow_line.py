"""Line with the speed of a real one: bytes arrive after their transfer time, not by messages."""

from abc import ABC, abstractmethod

from jaxgrasp.glove.line import Line, LineError


class Throttle:
    """Limiter of the bytes that a line carries to its baud rate."""

    def __init__(self, baud: int) -> None:
        """Create the limiter of an idle line of 8N1.

        Args:
            baud: bits a second; ten make a byte.
        """
        self._rate = baud / 10
        self._since: float | None = None
        self._carried = 0

    def pass_on(self, now: float, waiting: int) -> int:
        """Return how many of the waiting bytes come through now; call this often, with the count of all waiting."""
        if waiting == 0:
            self._since = None
            return 0
        if self._since is None:
            # A byte that is first seen now may have been there for a while, but none travels faster for it.
            self._since, self._carried = now, 0
        due = int((now - self._since) * self._rate) - self._carried
        through = min(max(due, 0), waiting)
        self._carried += through
        if through == waiting:
            self._since = None
        return through


class Terminal(ABC):
    """Interface of the device's end of a line."""

    most_waiting: int
    """Largest number of bytes that were on their way to the device."""

    @abstractmethod
    def plug(self) -> None:
        """Connect the line."""

    @abstractmethod
    def unplug(self) -> None:
        """Disconnect the line and discard all bytes on their way."""

    @abstractmethod
    def read(self, now: float) -> bytes:
        """Return the bytes that the line has carried to the device by now."""

    @abstractmethod
    def is_free(self) -> bool:
        """Return True if all queued bytes have left."""

    @abstractmethod
    def queue(self, data: bytes) -> None:
        """Queue bytes to send to the host."""

    @abstractmethod
    def write(self, now: float) -> None:
        """Send the queued bytes that the line has carried from the device by now."""


class MemoryLine(Line):
    """Line in memory with both ends in one program, for virtual time: deterministic and never late.

    A host reads and writes it as a port; a ``Simulation`` has its other end, and is driven by whoever drives time.
    """

    def __init__(self, baud: int) -> None:
        """Create a line that is plugged in and empty."""
        self.far = _FarEnd(self, baud)
        """Device's end of the line."""
        self.to_device, self.to_host = bytearray(), bytearray()
        self.is_plugged = True

    def read(self) -> bytes:
        self._check()
        out = bytes(self.to_host)
        self.to_host.clear()
        return out

    def is_free(self) -> bool:
        self._check()
        return True

    def write(self, data: bytes) -> bool:
        self._check()
        self.to_device += data
        return True

    def close(self) -> None:
        self.to_host.clear()

    def _check(self) -> None:
        if not self.is_plugged:
            raise LineError("the line is unplugged")


class _FarEnd(Terminal):
    def __init__(self, line: MemoryLine, baud: int) -> None:
        self.most_waiting = 0
        self._line, self._out = line, bytearray()
        self._coming, self._going = Throttle(baud), Throttle(baud)

    def plug(self) -> None:
        self._line.is_plugged = True

    def unplug(self) -> None:
        self._line.is_plugged = False
        for buffer in (self._line.to_device, self._line.to_host, self._out):
            buffer.clear()

    def read(self, now: float) -> bytes:
        waiting = self._line.to_device
        through = self._coming.pass_on(now, len(waiting))
        came = bytes(waiting[:through])
        del waiting[:through]
        self.most_waiting = max(self.most_waiting, len(waiting))
        return came

    def is_free(self) -> bool:
        return self._line.is_plugged and not self._out

    def queue(self, data: bytes) -> None:
        self._out += data

    def write(self, now: float) -> None:
        through = self._going.pass_on(now, len(self._out))
        self._line.to_host += self._out[:through]
        del self._out[:through]
