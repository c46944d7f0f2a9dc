"""Link between the engine's computer and the glove's, over UDP or TCP; the latest message replaces earlier ones."""

import contextlib
import socket
from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.network.messages import MAX_NUMBERS, Exchange, Message, draw_session, length_of
from jaxgrasp.glove.protocol.frames import stuff, unstuff

Transport = Literal["udp", "tcp"]
RECONNECT = 0.25
"""Time between attempts to connect [s]."""
MAX_INCOMPLETE = 4096
"""Largest number of bytes of an incomplete message that are kept."""
MAX_PIECES = 16
"""Largest number of pieces read per call, so that a flood of messages does not block the loop."""
MAX_CALLERS = 16
"""Largest number of TCP connections beside the peer's; a further connection closes the oldest of them."""
PROOF_S = 1.0
"""Time within which a TCP caller must send a valid message before its connection is closed [s]."""


class NetworkLink:
    """End of a network link, driven by calls that never wait.

    One side listens, the other connects; either may come, go and come back. Nothing is queued here: a message that the
    network cannot take is dropped, since the next is newer. (What TCP has taken, it keeps until it arrives; what it
    brings late is too old, and not acted on.)

    The side that listens speaks only to its peer: the sender of the latest valid message, of the shared key where there
    is one. Whoever calls without such a message takes nothing from the peer, is sent nothing, and over TCP its
    connection is closed after ``PROOF_S``. The side that connects speaks only to the address that it was given.
    """

    def __init__(
        self,
        host: str,
        port: int,
        size_in: int,
        *,
        listens: bool = False,
        transport: Transport = "udp",
        oldest: float = 0.03,
        key: bytes = b"",
    ) -> None:
        """Create an end that has not met the other.

        Args:
            host: name or address: of the other side, or of the interface to listen on.
            port: number; 0 to listen on a free one (see ``port``).
            size_in: how many numbers the other side's messages hold.
            listens: whether this is the side that waits to be called.
            transport: ``"udp"`` or ``"tcp"``.
            oldest: age beyond which a message is not acted on [s].
            key: that both sides share; without one, anyone on the network can speak.

        Raises:
            ValueError: for another transport, too many numbers, and an age that is not positive.
            OSError: for an address that cannot be listened on.
        """
        if transport not in ("udp", "tcp"):
            raise ValueError(f"transport is {transport!r}: expected 'udp' or 'tcp'")
        if not 1 <= size_in <= MAX_NUMBERS:
            raise ValueError(f"size_in is {size_in}: expected 1 to {MAX_NUMBERS} numbers")
        if not 0 <= port < 65536:
            raise ValueError(f"port is {port}: expected 0 to 65535")
        if len(key) > 64:
            raise ValueError(f"key has {len(key)} bytes: expected at most 64")
        if not (np.isfinite(oldest) and oldest > 0):
            raise ValueError(f"oldest is {oldest}: expected a positive time [s]")
        self.exchange = Exchange(draw_session(), size_in, key)
        self._oldest = oldest
        self._carrier: _Transport = (
            _Datagrams(host, port, listens) if transport == "udp" else _Stream(host, port, listens, length_of(size_in))
        )

    @property
    def port(self) -> int:
        """Number of the port on which it listens, or which it calls."""
        return self._carrier.port

    def send(self, timestamp: float, values: Float[np.ndarray, "size"]) -> None:
        """Send a message; it is dropped if the network cannot take it now."""
        with contextlib.suppress(OSError):
            self._carrier.send(timestamp, self.exchange.outgoing(timestamp, values))

    def receive(self, timestamp: float) -> Message | None:
        """Read the messages that came and return the latest, or None if it is too old; call this often."""
        with contextlib.suppress(OSError):
            for data, sender in self._carrier.receive(timestamp):
                if self.exchange.incoming(timestamp, data) is not None:
                    self._carrier.answer(timestamp, sender)
        return self.exchange.latest if self.exchange.age(timestamp) <= self._oldest else None

    def close(self) -> None:
        """Close the sockets."""
        self._carrier.close()


class _Transport(ABC):
    """Carrier of messages; an OSError means that it cannot send or receive now."""

    port: int

    @abstractmethod
    def send(self, timestamp: float, data: bytes) -> None: ...

    @abstractmethod
    def receive(self, timestamp: float) -> list[tuple[bytes, Any]]:
        """Return the data that came, each with its sender; however much comes, a call takes only so much."""

    @abstractmethod
    def answer(self, timestamp: float, sender: Any) -> None:
        """Make the sender of a valid message the peer, if this side listens."""

    @abstractmethod
    def close(self) -> None: ...


class _Datagrams(_Transport):
    def __init__(self, host: str, port: int, listens: bool) -> None:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._listens = listens
        self._peer = None if listens else address
        if listens:
            self._socket.bind(address)
        self.port = self._socket.getsockname()[1] if listens else port

    def send(self, timestamp: float, data: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(data, self._peer)

    def receive(self, timestamp: float) -> list[tuple[bytes, Any]]:
        received = []
        # A refusal of what was sent comes as an error of one call (and so does, on Windows, a datagram of more than
        # LARGEST bytes); the datagrams that have come are still there.
        for _ in range(MAX_PIECES):
            try:
                received.append(self._socket.recvfrom(MAX_INCOMPLETE))
            except BlockingIOError:
                break
            except OSError:
                continue
        return received

    def answer(self, timestamp: float, sender: Any) -> None:
        # The side that connects has the other's address from its user. If it followed senders, a recording played back
        # while the other is silent would lead it away for good: the other waits to be called.
        if self._listens:
            self._peer = sender

    def close(self) -> None:
        self._socket.close()


class _Connection:
    """A TCP connection, with the halves of messages that wait at its two ends."""

    def __init__(self, opened: socket.socket, since: float) -> None:
        opened.setblocking(False)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.since = since
        """Time at which it was made, or ceased to be the peer's [s]."""
        self._socket = opened
        self._received, self._unsent = bytearray(), b""

    def is_established(self) -> bool:
        try:
            self._socket.getpeername()
        except OSError:
            return False
        return True

    def send(self, line: bytes) -> None:
        """Send a line, or nothing of it while the network takes none; OSError where the connection has ended."""
        with contextlib.suppress(BlockingIOError):
            # The rest of a message goes first, or the other side would take two halves for one.
            if self._unsent:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
            if not self._unsent:
                self._unsent = line[self._socket.send(line) :]

    def receive(self, max_bytes: int) -> list[bytes] | None:
        """Return the lines that the next ``max_bytes`` bytes end; None where no bytes wait.

        Raises:
            OSError: the connection has ended.
        """
        try:
            data = self._socket.recv(max_bytes)
        except BlockingIOError:
            return None
        if not data:
            raise ConnectionResetError
        *lines, incomplete = (bytes(self._received) + data).split(b"\0")
        # More than a message without an end is none.
        self._received = bytearray(incomplete[-MAX_INCOMPLETE:])
        return lines

    def close(self) -> None:
        self._socket.close()


class _Stream(_Transport):
    def __init__(self, host: str, port: int, listens: bool, length: int) -> None:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        # Of what comes between two zeros, only what is as long as a message is looked at any further.
        self._lengths = range(length + 1, len(stuff(b"\1" * length)) + 1)
        self._family, self._address = family, address
        self._server: socket.socket | None = None
        if listens:
            self._server = socket.create_server(self._address, family=self._family, reuse_port=False)
            self._server.setblocking(False)
        self.port = self._server.getsockname()[1] if self._server else port
        self._peer: _Connection | None = None
        self._callers: list[_Connection] = []
        """Connections without a valid message since ``since``, the oldest first; only where this side listens."""
        self._next_call = -np.inf

    def send(self, timestamp: float, data: bytes) -> None:
        self._call(timestamp)
        if self._peer is None or not self._peer.is_established():
            return
        try:
            self._peer.send(stuff(data) + b"\0")
        except OSError:
            self._drop(self._peer)

    def receive(self, timestamp: float) -> list[tuple[bytes, Any]]:
        self._call(timestamp)
        if self._server is not None:
            self._accept(self._server, timestamp)
        received: list[tuple[bytes, Any]] = []
        if self._peer is not None and (self._server is not None or self._peer.is_established()):
            received += self._read(self._peer, MAX_PIECES, MAX_INCOMPLETE)
        for caller in list(self._callers):
            # Two messages at a time: a caller that sends as often as we ask keeps up, and no flood takes long to read.
            received += self._read(caller, 1, 2 * (self._lengths[-1] + 1))
        for caller in [connection for connection in self._callers if not 0 <= timestamp - connection.since <= PROOF_S]:
            self._drop(caller)
        return received

    def answer(self, timestamp: float, sender: Any) -> None:
        if sender not in self._callers:
            return
        self._callers.remove(sender)
        if self._peer is not None:
            # It may be the true one, whose place a recording takes while it is silent: its next message takes it back.
            self._peer.since = timestamp
            self._callers.append(self._peer)
        self._peer = sender

    def _read(self, connection: _Connection, pieces: int, max_bytes: int) -> list[tuple[bytes, Any]]:
        """Return waiting messages, at most ``pieces`` reads of ``max_bytes``; drop a connection that has ended."""
        received: list[tuple[bytes, Any]] = []
        for _ in range(pieces):
            try:
                lines = connection.receive(max_bytes)
            except OSError:
                self._drop(connection)
                break
            if lines is None:
                break
            messages = [unstuff(line) for line in lines if len(line) in self._lengths]
            received += [(message, connection) for message in messages if message is not None]
        return received

    def _accept(self, server: socket.socket, timestamp: float) -> None:
        """Take new callers beside the peer, MOST_CALLERS at most: the oldest makes room for the newest."""
        for _ in range(MAX_CALLERS):
            try:
                accepted, _ = server.accept()
            except OSError:
                break
            try:
                self._callers.append(_Connection(accepted, timestamp))
            except OSError:
                accepted.close()
        while len(self._callers) > MAX_CALLERS:
            self._drop(self._callers[0])

    def _call(self, timestamp: float) -> None:
        """Call the other side, if this side connects and the connection is not there."""
        if (
            self._server is not None
            or timestamp < self._next_call
            or (self._peer is not None and self._peer.is_established())
        ):
            return
        self._next_call = timestamp + RECONNECT
        if self._peer is not None:
            self._drop(self._peer)
        opened = socket.socket(self._family, socket.SOCK_STREAM)
        self._peer = _Connection(opened, timestamp)
        opened.connect_ex(self._address)

    def _drop(self, connection: _Connection) -> None:
        connection.close()
        if connection is self._peer:
            self._peer = None
        else:
            self._callers.remove(connection)

    def close(self) -> None:
        for connection in [*self._callers, *([self._peer] if self._peer is not None else [])]:
            self._drop(connection)
        if self._server is not None:
            self._server.close()
