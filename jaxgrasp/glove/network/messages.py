"""Messages between two computers: the latest numbers, how old they are, and nothing acted on that is too old.

A message, little-endian: session (uint64, which the sender drew when it began), answers (uint64, the session that it
has heard; 0 before any), number (uint32), sent (float64, sender's clock [s]), echo (float64, the newest ``sent`` that
the sender knows of the other side; NaN before any), held (float64, how long it has had that [s]), the numbers (float32
each), and a BLAKE2b of 16 bytes of all before, keyed if both sides have a key.

What does not answer the receiver's own session is heard, so that it can be answered, and never acted on: a recording of
an earlier session is none of this one, whichever side began anew.
"""

import hashlib
import hmac
import math
import secrets
import struct
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_HEAD = struct.Struct("<QQIddd")
CHECK = 16
NUMBERS = 2**32
NOBODY = 0
"""Session of nobody."""
MOST_NUMBERS = 340
"""Numbers in a message at most, so that one fits in a datagram of the usual 1,500 bytes."""
TAKEN = 0.25
"""How long a side that falls silent still keeps another from taking its place [s]."""
WINDOW = 4.0
"""For how long the shortest exchange sets the clocks [s]."""


@dataclass(frozen=True, eq=False)
class Message:
    """What the other side said."""

    session: int
    answers: int
    number: int
    sent: float
    echo: float
    held: float
    values: Float[np.ndarray, "size"]


def encode(message: Message, key: bytes) -> bytes:
    """Its bytes."""
    numbers = message.session, message.answers, message.number
    head = _HEAD.pack(*numbers, message.sent, message.echo, message.held)
    body = head + message.values.astype("<f4").tobytes()
    return body + _check(body, key)


def length_of(size: int) -> int:
    """Bytes of a message of so many numbers."""
    return _HEAD.size + 4 * size + CHECK


def decode(data: bytes, size: int, key: bytes) -> Message | None:
    """The message of bytes; None where they are none of so many numbers."""
    if len(data) != length_of(size) or not hmac.compare_digest(_check(data[:-CHECK], key), data[-CHECK:]):
        return None
    session, answers, number, sent, echo, held = _HEAD.unpack_from(data)
    if not math.isfinite(sent):
        return None
    values = np.frombuffer(data, "<f4", size, _HEAD.size).astype(float)
    return Message(session, answers, number, sent, echo, held, values)


def _check(body: bytes, key: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=CHECK, key=key).digest()


def draw_session() -> int:
    """A number that nobody can guess, and none has drawn before."""
    return 1 + secrets.randbelow(2**64 - 1)


class Exchange:
    """One side's bookkeeping: numbers what it sends, orders what it hears, and knows the other's clock.

    The offset of the clocks is that of the exchange with the shortest way there and back in the last seconds; half
    that way is the most by which an age may be wrong.
    """

    def __init__(self, session: int, size_in: int, key: bytes = b"") -> None:
        """A side that has heard nothing.

        Args:
            session: a number that ``draw_session`` drew, anew each time.
            size_in: how many numbers the other side's messages hold.
            key: that both sides share; without one, anyone on the network can speak.
        """
        self.refused = self.stale = self.missing = self.accepted = 0
        self.latest: Message | None = None
        self._session, self._size, self._key = session, size_in, key
        self._number = 0
        self._arrived = -math.inf
        self._ways: list[tuple[float, float, float]] = []

    def outgoing(self, now: float, values: Float[np.ndarray, "size"]) -> bytes:
        """Bytes of the next message."""
        self._number = (self._number + 1) % NUMBERS
        last = self.latest
        heard = (NOBODY, math.nan, 0.0) if last is None else (last.session, last.sent, now - self._arrived)
        answers, echo, held = heard
        return encode(Message(self._session, answers, self._number, now, echo, held, values), self._key)

    def incoming(self, now: float, data: bytes) -> Message | None:
        """The message, if it is newer than all before; ``age`` says whether it may be acted on."""
        message = decode(data, self._size, self._key)
        if message is None or message.session == self._session:
            self.refused += 1
            return None
        last = self.latest
        if last is not None and last.session == message.session:
            ahead = (message.number - last.number) % NUMBERS
            if not 0 < ahead < NUMBERS // 2:
                self.stale += 1
                return None
            self.missing += ahead - 1
        elif self._is_answered and now - self._arrived < TAKEN:
            # Two that speak at once would take turns; but only who answers us keeps others away, no recording.
            self.stale += 1
            return None
        else:
            # Another program on the other side: another clock.
            self._ways.clear()
        self.accepted += 1
        self.latest, self._arrived = message, now
        way = now - message.echo - message.held
        if self._is_answered and way >= 0:
            self._ways = [one for one in self._ways if one[0] >= now - WINDOW and one[1] < way]
            self._ways.append((now, way, message.sent - (now - way / 2)))
        return message

    @property
    def _is_answered(self) -> bool:
        """Whether the latest message comes from who has heard us, and so was said since we began."""
        return self.latest is not None and self.latest.answers == self._session

    @property
    def way(self) -> float:
        """Shortest time there and back of the last seconds [s]; infinite before any."""
        return min((way for _, way, _ in self._ways), default=math.inf)

    @property
    def offset(self) -> float:
        """The other's clock less ours [s]; NaN before any answer has come back."""
        return min(self._ways, key=lambda one: one[1])[2] if self._ways else math.nan

    def age(self, now: float) -> float:
        """How old the latest message is at most [s]; infinite while that cannot be told."""
        if self.latest is None or not self._is_answered or not self._ways:
            return math.inf
        return now - (self.latest.sent - self.offset) + self.way / 2
