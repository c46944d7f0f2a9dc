"""A device written from PROTOCOL.md alone, for tests of the host: it shares no code with the package.

Rules are numbered as on that page. Its own check sums, stuffing and arithmetic; times are its clock [us].
"""

import struct

COUNT = 14
CAPABILITY, ANGLES, TENSIONS, STATUS = 2, 4, 5, 7
HELLO, COMMAND, ARM, STOP = 1, 3, 6, 8
LIMITS, CONTINUOUS = 9, 10
IDLE, ARMED, LATCHED = 0, 1, 2
WATCHDOG_MS, QUANTUM, MOST, SLEW, HEATING = 50, 100, 11_999, 120, 3000


def check_sum(data: bytes) -> int:
    """Compute the CRC-32, a bit at a time."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            lowest = register & 1
            register >>= 1
            if lowest:
                register ^= 0xEDB88320
    return register ^ 0xFFFFFFFF


def stuffed(data: bytes) -> bytes:
    out, piece = b"", b""
    for byte in data:
        if byte == 0:
            out += bytes([len(piece) + 1]) + piece
            piece = b""
        else:
            piece += bytes([byte])
    return out + bytes([len(piece) + 1]) + piece + b"\0"


def unstuffed(line: bytes) -> bytes:
    out, place = b"", 0
    while place < len(line):
        length = line[place]
        if length == 0 or place + length > len(line):
            return b""
        out += line[place + 1 : place + length]
        place += length
        if place < len(line):
            out += b"\0"
    return out


def wrapped(value: int, bits: int) -> int:
    """Return the number modulo ``2**bits``, as a signed integer."""
    value %= 1 << bits
    return value - (1 << bits) if value >> (bits - 1) else value


class IndependentDevice:
    """The paper's glove: 14 channels, 50 ms."""

    def __init__(self, seed: int):
        self.state, self.cause, self.counts = IDLE, 0, [0] * COUNT
        self.refused = self.accepted = self.missing = self.stale = 0
        self.session = None
        self.is_pressed = False
        self._seed, self._drawn, self._number = seed, 0, 0
        self._wanted, self._rest = [0] * COUNT, 0
        self._warmth, self._rest_of_ms = [0] * COUNT, 0
        self._newest = self._host_clock = self._echo = self._stepped = self._sent = 0
        self._line = b""
        self._answers: list[int] = []
        self._told = 0

    def receive(self, timestamp: int, data: bytes) -> None:
        for byte in data:
            if byte:
                self._line += bytes([byte])
            elif self._line:
                self._take(timestamp, unstuffed(self._line))
                self._line = b""

    def step(self, timestamp: int) -> None:
        """Step the device by rules 6 to 9."""
        elapsed = (timestamp - self._stepped) % 2**32
        self._stepped = timestamp
        total_us = self._rest_of_ms + elapsed
        n, self._rest_of_ms = min(total_us // 1000, 8000), total_us % 1000
        time = 10 * HEATING
        for k in range(COUNT):
            warm = self._warmth[k]
            self._warmth[k] = warm - warm * n // (time + n) + self.counts[k] ** 2 * n
        if self.state == ARMED and (timestamp - self._echo) % 2**32 > 1000 * WATCHDOG_MS:
            self._latch(1)
        if self.is_pressed:
            self._latch(4)
        if self.state != ARMED:
            self._zero()
            return
        change = self._rest + SLEW * min(elapsed, 20_000)
        self._rest = change % 1000
        for k in range(COUNT):
            towards = max(-(change // 1000), min(change // 1000, self._wanted[k] - self.counts[k]))
            self.counts[k] += towards

    def own_fault(self) -> None:
        self._latch(3)

    def says(self, timestamp: int, kind: int, values: list[int]) -> bytes:
        """Return an encoded frame as it goes over the line."""
        self._number = (self._number + 1) % 2**16
        flags = (self.state == ARMED) + 2 * (self.state == LATCHED) + 8 * self.is_pressed
        head = struct.pack("<BBHII", 2 << 4 | kind, flags | self.cause << 4, self._number, timestamp, self._host_clock)
        body = head + b"".join(struct.pack("<h", value) for value in values + [0] * (COUNT - len(values)))
        return stuffed(body + struct.pack("<I", check_sum(body)))

    def answer(self, timestamp: int) -> bytes:
        """Return the pending reply to a HELLO, empty where none is pending."""
        if not self._answers:
            return b""
        kind = self._answers.pop(0)
        if kind != CAPABILITY:
            return self.says(timestamp, kind, [MOST] * COUNT)
        bounds = [COUNT, WATCHDOG_MS, QUANTUM, MOST, SLEW, self.number, HEATING]
        return self.says(timestamp, kind, [self.session, *bounds])

    def status(self, timestamp: int) -> bytes:
        values = [self.session or 0, self.state, self.cause]
        for number in (self.accepted, self.missing, self.stale, self.refused):
            values += [wrapped(number, 16), wrapped(number >> 16, 16)]
        self._told = (self._told + 1) % COUNT
        warmth = self._warmth[self._told] * 1000 // (MOST**2 * 10 * HEATING)
        return self.says(timestamp, STATUS, [*values, wrapped(self._newest, 16), self._told, warmth])

    def _take(self, timestamp: int, data: bytes) -> None:
        if len(data) != 44 or check_sum(data[:40]) != struct.unpack("<I", data[40:])[0] or data[0] >> 4 != 2:
            self.refused += 1
            return
        kind = data[0] & 15
        enabled = bool(data[1] & 1)
        sequence, clock, echo, *values = struct.unpack("<HII14h", data[2:40])
        if not 1 <= kind <= 10:
            self.refused += 1
        elif kind == HELLO:
            self._greeted(timestamp, sequence, clock, values[0])
        elif kind == STOP:
            self._latch(4)
            if self.session is not None and self._is_new(sequence, clock):
                self.accepted += 1
        elif kind in (ARM, COMMAND) and self.session is not None and self._is_new(sequence, clock):
            self._obey(timestamp, kind, enabled, echo, values)

    def _greeted(self, timestamp: int, sequence: int, clock: int, session: int) -> None:
        """Answer a HELLO by rule 1."""
        if self.state == ARMED:
            self._latch(2)
        self.session, self._newest, self._host_clock = session, sequence, clock
        self.accepted = self.missing = self.stale = 0
        self._draw(timestamp)
        self._answers = [CAPABILITY, LIMITS, CONTINUOUS]

    def _is_new(self, sequence: int, clock: int) -> bool:
        """Return True where a frame is new by rule 2."""
        ahead, later = (sequence - self._newest) % 2**16, (clock - self._host_clock) % 2**32
        if not (1 <= ahead <= 64 and 1 <= later <= 1_000_000):
            self.stale += 1
            return False
        self.missing += ahead - 1
        self._newest, self._host_clock = sequence, clock
        return True

    def _obey(self, timestamp: int, kind: int, enabled: bool, echo: int, values: list[int]) -> None:
        """Obey a command by rules 3 to 5."""
        if kind == COMMAND and not enabled:
            self.accepted += 1
            self.state = IDLE if self.state == ARMED else self.state
            self._zero()
        elif (timestamp - echo) % 2**32 > 1000 * WATCHDOG_MS:
            self.stale += 1
        elif kind == ARM:
            self.accepted += 1
            if values[0] == self.session and values[1] == self.number and not self.is_pressed:
                self._zero()
                self.state, self.cause, self._echo = ARMED, 0, echo
                self._draw(timestamp)
        else:
            self.accepted += 1
            if self.state == ARMED:
                self._echo = echo
                self._wanted = [max(0, min(MOST, value)) for value in values]

    def _draw(self, timestamp: int) -> None:
        self._drawn += 1
        self.number = wrapped(check_sum(struct.pack("<III", self._seed, timestamp % 2**32, self._drawn)), 16)

    def _latch(self, cause: int) -> None:
        if self.state == ARMED or cause in (3, 4):
            self.state, self.cause = LATCHED, cause
        self._zero()

    def _zero(self) -> None:
        self.counts, self._wanted, self._rest = [0] * COUNT, [0] * COUNT, 0
