"""Messages between two computers: the latest numbers and their age, so that old data is never used.

A message, little-endian: session (uint64, which the sender drew when it began), answers (uint64, the session that it
has heard; 0 before any), number (uint32), sent (float64, sender's clock [s]), echo (float64, the newest ``sent`` that
the sender knows of the other side; NaN before any), held (float64, how long it has had that [s]), the numbers (float32
each), and a BLAKE2b of 16 bytes of all before, keyed if both sides have a key.

A message that does not answer the receiver's session is heard, so that it can be answered, and never acted on: a
recording of an earlier session does not count in the current one, whichever side began anew.

Shared key of two hosts, from a file that others cannot read or from the environment; never from a command line.
"""

import hashlib
import hmac
import math
import os
import secrets
import stat
import struct
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

VARIABLE = "JAXGRASP_GLOVE_KEY"
"""Environment variable of the key."""
MIN_BYTES, MAX_BYTES = 16, 64
"""Range of the number of bytes of a key."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_EXPECTED = f"expected {2 * MIN_BYTES} to {2 * MAX_BYTES} hexadecimal digits"


def load_key(path: str | os.PathLike | None = None) -> bytes:
    """Load the key from a file, or without a path from the environment's ``JAXGRASP_GLOVE_KEY``; empty if it is unset.

    A key does not belong on a command line, which every user of a machine can read.

    Raises:
        ValueError: for what is no key, and a file that others than its owner can read or write.
        OSError: for a file that cannot be read.
    """
    if path is None:
        text = os.environ.get(VARIABLE, "")
        return _key(VARIABLE, text) if text else b""
    with open(path, encoding="ascii", errors="replace") as file:
        if os.name == "posix" and stat.S_IMODE(os.fstat(file.fileno()).st_mode) & _OTHERS:
            raise ValueError(f"key file {path} can be read by others: restrict it to its owner (chmod 600 {path})")
        return _key(f"key file {path}", file.read(4 * MAX_BYTES).strip())


def _key(source: str, text: str) -> bytes:
    try:
        key = bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"{source} is not hexadecimal: {_EXPECTED}") from None
    if not MIN_BYTES <= len(key) <= MAX_BYTES:
        raise ValueError(f"{source} holds {len(key)} bytes: {_EXPECTED}")
    return key


_HEAD = struct.Struct("<QQIddd")
CHECK = 16
NUMBER_MODULUS = 2**32
NOBODY = 0
"""Session number that stands for no session."""
MAX_NUMBERS = 340
"""Largest count of numbers in a message, so that it fits in a datagram of the usual 1,500 bytes."""
TAKEOVER_DELAY = 0.25
"""Time for which a side that falls silent still keeps another from taking its place [s]."""
WINDOW = 4.0
"""Time for which the shortest exchange determines the clock offset [s]."""


@dataclass(frozen=True, eq=False)
class Message:
    """Content of a message between two hosts."""

    session: int
    answers: int
    number: int
    sent: float
    echo: float
    held: float
    values: Float[np.ndarray, "size"]


def encode(message: Message, key: bytes) -> bytes:
    """Encode a message into bytes, with its check sum."""
    numbers = message.session, message.answers, message.number
    head = _HEAD.pack(*numbers, message.sent, message.echo, message.held)
    body = head + message.values.astype("<f4").tobytes()
    return body + _check(body, key)


def length_of(size: int) -> int:
    """Return the number of bytes of a message with ``size`` numbers."""
    return _HEAD.size + 4 * size + CHECK


def decode(data: bytes, size: int, key: bytes) -> Message | None:
    """Decode a message from bytes; return None unless they are a valid message of ``size`` numbers."""
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
    """Draw a random session number that cannot be guessed and does not repeat."""
    return 1 + secrets.randbelow(2**64 - 1)


class Exchange:
    """State of an exchange on one side: numbers of sent messages, order of received ones, estimated clock offset.

    The offset of the clocks is that of the exchange with the shortest round trip in the last seconds; half of that
    round trip bounds the error of an age.
    """

    def __init__(self, session: int, size_in: int, key: bytes = b"") -> None:
        """Create a side that has heard nothing.

        Args:
            session: a number that ``draw_session`` drew, anew each time.
            size_in: how many numbers the other side's messages hold.
            key: that both sides share; without one, anyone on the network can speak.
        """
        self.refused = self.stale = self.missing = self.accepted = 0
        self.latest: Message | None = None
        self._session, self._size, self._key = session, size_in, key
        self._number = 0
        self._arrived_at = -math.inf
        self._round_trips: list[tuple[float, float, float]] = []

    def outgoing(self, timestamp: float, values: Float[np.ndarray, "size"]) -> bytes:
        """Encode the next message, which carries these values, into bytes."""
        self._number = (self._number + 1) % NUMBER_MODULUS
        last = self.latest
        reply = (NOBODY, math.nan, 0.0) if last is None else (last.session, last.sent, timestamp - self._arrived_at)
        answers, echo, held = reply
        return encode(Message(self._session, answers, self._number, timestamp, echo, held, values), self._key)

    def incoming(self, timestamp: float, data: bytes) -> Message | None:
        """Decode bytes; return the message if it is newer than all before, else None; ``age`` tells its age."""
        message = decode(data, self._size, self._key)
        if message is None or message.session == self._session:
            self.refused += 1
            return None
        last = self.latest
        if last is not None and last.session == message.session:
            ahead = (message.number - last.number) % NUMBER_MODULUS
            if not 0 < ahead < NUMBER_MODULUS // 2:
                self.stale += 1
                return None
            self.missing += ahead - 1
        elif self._is_answered and timestamp - self._arrived_at < TAKEOVER_DELAY:
            # Two that speak at once would take turns; but only who answers us keeps others away, no recording.
            self.stale += 1
            return None
        else:
            # Another program on the other side: another clock.
            self._round_trips.clear()
        self.accepted += 1
        self.latest, self._arrived_at = message, timestamp
        round_trip = timestamp - message.echo - message.held
        if self._is_answered and round_trip >= 0:
            self._round_trips = [
                entry for entry in self._round_trips if entry[0] >= timestamp - WINDOW and entry[1] < round_trip
            ]
            # offset = t_sent - (t_arrived - round trip / 2)
            self._round_trips.append((timestamp, round_trip, message.sent - (timestamp - round_trip / 2)))
        return message

    @property
    def _is_answered(self) -> bool:
        """True if the latest message answers this session, and so was sent after it began."""
        return self.latest is not None and self.latest.answers == self._session

    @property
    def round_trip(self) -> float:
        """Shortest round trip of the last seconds [s]; infinite before the first."""
        return min((round_trip for _, round_trip, _ in self._round_trips), default=math.inf)

    @property
    def offset(self) -> float:
        """Other side's clock minus the local clock [s]; NaN before any answer has come back."""
        return min(self._round_trips, key=lambda entry: entry[1])[2] if self._round_trips else math.nan

    def age(self, timestamp: float) -> float:
        """Return an upper bound on the age of the latest message [s]; infinite while it is unknown."""
        if self.latest is None or not self._is_answered or not self._round_trips:
            return math.inf
        return timestamp - (self.latest.sent - self.offset) + self.round_trip / 2
