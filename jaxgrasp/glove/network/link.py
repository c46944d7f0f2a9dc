"""Two hosts: the engine's computer and the glove's, over UDP or TCP; the latest state wins."""

import contextlib
import socket
from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.network.messages import MOST_NUMBERS, Exchange, Message, draw_session, length_of
from jaxgrasp.glove.protocol.cobs import stuff, unstuff

Transport = Literal["udp", "tcp"]
RECONNECT = 0.25
"""Time between attempts to connect [s]."""
LARGEST = 4096
"""Bytes of a message that are kept at most before its end."""
MOST = 16
"""Pieces that are taken at a time, so that nobody who sends without end keeps the loop from its work."""


class NetworkLink:
    """One end of a link, driven by calls that never wait.

    One side listens, the other connects; either may come, go and come back. Nothing is queued here: a message that the
    network cannot take is dropped, since the next is newer. (What TCP has taken, it keeps until it arrives; what it
    brings late is too old, and not acted on.)
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
        """An end that has not met the other.

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
        if not 1 <= size_in <= MOST_NUMBERS:
            raise ValueError(f"size_in is {size_in}: expected 1 to {MOST_NUMBERS} numbers")
        if not 0 <= port < 65536:
            raise ValueError(f"port is {port}: expected 0 to 65535")
        if len(key) > 64:
            raise ValueError(f"key has {len(key)} bytes: expected 64 at most")
        if not (np.isfinite(oldest) and oldest > 0):
            raise ValueError(f"oldest is {oldest}: expected a positive time [s]")
        self.exchange = Exchange(draw_session(), size_in, key)
        self._oldest = oldest
        self._carrier: _Transport = (
            _Datagrams(host, port, listens) if transport == "udp" else _Stream(host, port, listens, length_of(size_in))
        )

    @property
    def port(self) -> int:
        """The port that it listens on, or calls."""
        return self._carrier.port

    def send(self, now: float, values: Float[np.ndarray, "size"]) -> None:
        """Say something; what the network cannot take now is dropped."""
        with contextlib.suppress(OSError):
            self._carrier.send(now, self.exchange.outgoing(now, values))

    def receive(self, now: float) -> Message | None:
        """The latest message, if it is not too old to act on; call it often."""
        with contextlib.suppress(OSError):
            for data, sender in self._carrier.receive(now):
                if self.exchange.incoming(now, data) is not None:
                    self._carrier.answer(sender)
        return self.exchange.latest if self.exchange.age(now) <= self._oldest else None

    def close(self) -> None:
        """Let go of the sockets."""
        self._carrier.close()


class _Transport(ABC):
    """What carries messages; an OSError means not now."""

    port: int

    @abstractmethod
    def send(self, now: float, data: bytes) -> None: ...

    @abstractmethod
    def receive(self, now: float) -> list[tuple[bytes, Any]]:
        """What came, each with its sender; however much comes, a call takes only so much."""

    def answer(self, sender: Any) -> None:  # noqa: B027
        """Speak from now on to the sender of a message that was understood."""

    @abstractmethod
    def close(self) -> None: ...


class _Datagrams(_Transport):
    def __init__(self, host: str, port: int, listens: bool) -> None:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer = None if listens else address
        if listens:
            self._socket.bind(address)
        self.port = self._socket.getsockname()[1] if listens else port

    def send(self, now: float, data: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(data, self._peer)

    def receive(self, now: float) -> list[tuple[bytes, Any]]:
        found = []
        # A refusal of what was sent comes as an error of one call; what has come is still there.
        for _ in range(MOST):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                break
            except ConnectionError:
                continue
            found.append((data, sender))
        return found

    def answer(self, sender: Any) -> None:
        self._peer = sender

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
        self._socket: socket.socket | None = None
        self._is_ready = False
        self._next = -np.inf
        self._kept, self._rest = bytearray(), b""

    def send(self, now: float, data: bytes) -> None:
        self._connect(now)
        if self._socket is None or not self._is_ready:
            return
        try:
            # The rest of a message goes first, or the other side would take two halves for one.
            if self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
            if not self._rest:
                line = stuff(data) + b"\0"
                self._rest = line[self._socket.send(line) :]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def receive(self, now: float) -> list[tuple[bytes, Any]]:
        self._connect(now)
        found: list[tuple[bytes, Any]] = []
        for _ in range(MOST):
            if self._socket is None or not self._is_ready:
                break
            try:
                data = self._socket.recv(LARGEST)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._drop()
                break
            *lines, rest = (bytes(self._kept) + data).split(b"\0")
            # More than a message without an end is none.
            self._kept = bytearray(rest[-LARGEST:])
            candidates = [unstuff(line) for line in lines if len(line) in self._lengths]
            found += [(message, None) for message in candidates if message is not None]
        return found

    def _connect(self, now: float) -> None:
        """Take a caller, the newest one, or call."""
        if self._server is not None:
            with contextlib.suppress(BlockingIOError):
                caller, _ = self._server.accept()
                self._drop()
                self._use(caller)
        elif now >= self._next and not self._is_ready:
            self._next = now + RECONNECT
            self._drop()
            called = socket.socket(self._family, socket.SOCK_STREAM)
            called.setblocking(False)
            called.connect_ex(self._address)
            self._use(called)
        if self._socket is not None and not self._is_ready:
            with contextlib.suppress(OSError):
                self._socket.getpeername()
                self._is_ready = True

    def _use(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connected

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._is_ready = None, False
        self._kept.clear()
        self._rest = b""

    def close(self) -> None:
        self._drop()
        if self._server is not None:
            self._server.close()
