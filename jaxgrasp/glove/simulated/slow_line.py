"""Line with the speed of a real one: bytes arrive after their transfer time, not by messages.

Reproducible fault injection for the bytes of a line.
"""

import random
from abc import ABC, abstractmethod

from jaxgrasp.glove.line import Line, LineError


class FaultInjector:
    """Fault injector for a share of the pieces: flipped bits, lost or inserted bytes, bursts, whole losses."""

    def __init__(self, share: float, seed: int) -> None:
        """Create a fault injector.

        Args:
            share: of the pieces that pass, how many get one fault.
            seed: of what happens to them.

        Raises:
            ValueError: for a share that is none.
        """
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}: expected 0 to 1")
        self.faults = 0
        """Number of spoilt pieces."""
        self._share, self._rng = share, random.Random(seed)

    def inject(self, piece: bytes) -> bytes:
        """Return the piece, changed by one fault if it is drawn for one."""
        rng = self._rng
        if not piece or rng.random() >= self._share:
            return piece
        self.faults += 1
        out, position = bytearray(piece), rng.randrange(len(piece))
        match rng.randrange(6):
            case 0:
                out[position] ^= 1 << rng.randrange(8)
            case 1:
                del out[position]
            case 2:
                out[position:position] = rng.randbytes(rng.randrange(1, 20))
            case 3:
                out[position : position + 8] = rng.randbytes(min(8, len(out) - position))
            case 4:
                out[:0] = rng.randbytes(rng.randrange(1, 60))
            case _:
                out.clear()
        return bytes(out)


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

    def n_passing(self, timestamp: float, waiting: int) -> int:
        """Return how many of the waiting bytes come through now; call this often, with the count of all waiting."""
        if waiting == 0:
            self._since = None
            return 0
        if self._since is None:
            # A byte that is first seen now may have been there for a while, but none travels faster for it.
            self._since, self._carried = timestamp, 0
        due = int((timestamp - self._since) * self._rate) - self._carried
        n_passed = min(max(due, 0), waiting)
        self._carried += n_passed
        if n_passed == waiting:
            self._since = None
        return n_passed


class Terminal(ABC):
    """Interface of the device's end of a line."""

    max_waiting: int
    """Largest number of bytes that were on their way to the device."""

    @abstractmethod
    def plug(self) -> None:
        """Connect the line."""

    @abstractmethod
    def unplug(self) -> None:
        """Disconnect the line and discard all bytes on their way."""

    @abstractmethod
    def read(self, timestamp: float) -> bytes:
        """Return the bytes that the line has carried to the device by now."""

    @abstractmethod
    def is_free(self) -> bool:
        """Return True if all queued bytes have left."""

    @abstractmethod
    def queue(self, data: bytes) -> None:
        """Queue bytes to send to the host."""

    @abstractmethod
    def write(self, timestamp: float) -> None:
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
        self.max_waiting = 0
        self._line, self._queued = line, bytearray()
        self._incoming, self._outgoing = Throttle(baud), Throttle(baud)

    def plug(self) -> None:
        self._line.is_plugged = True

    def unplug(self) -> None:
        self._line.is_plugged = False
        for buffer in (self._line.to_device, self._line.to_host, self._queued):
            buffer.clear()

    def read(self, timestamp: float) -> bytes:
        waiting = self._line.to_device
        n_passed = self._incoming.n_passing(timestamp, len(waiting))
        data = bytes(waiting[:n_passed])
        del waiting[:n_passed]
        self.max_waiting = max(self.max_waiting, len(waiting))
        return data

    def is_free(self) -> bool:
        return self._line.is_plugged and not self._queued

    def queue(self, data: bytes) -> None:
        self._queued += data

    def write(self, timestamp: float) -> None:
        n_passed = self._outgoing.n_passing(timestamp, len(self._queued))
        self._line.to_host += self._queued[:n_passed]
        del self._queued[:n_passed]
