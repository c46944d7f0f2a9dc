"""A DOGlove made from what is published of it alone: nothing here is shared with the driver, not even a check sum.

The main board as its firmware's ``main.c`` and ``lra_control.c`` say; the servos as ROBOTIS's e-Manual says of
protocol 2.0 and of the XL330's control table. Time is an argument, so that it runs in virtual time or by a clock.
"""

FINGERS = ["thumb", "index", "middle", "ring", "little"]
# Readings of the straight hand and directions, from the published ``udp_receiver.py``, in degrees.
ENCODER_ZERO = [90, 270, 180, 270] + [90, 270, 180] * 4
SERVO_ZERO = [182.2, 165.2, 150.29, 151.44, 145.9]


def crc_of_byte(byte: int) -> int:
    """CRC-16 of polynomial 0x8005, bit by bit, high bit first, from zero."""
    register = byte << 8
    for _ in range(8):
        register = (register << 1 ^ (0x8005 if register & 0x8000 else 0)) & 0xFFFF
    return register


OF_BYTE = [crc_of_byte(byte) for byte in range(256)]


def crc(data: bytes) -> int:
    register = 0
    for byte in data:
        register = register << 8 & 0xFF00 ^ OF_BYTE[register >> 8 ^ byte]
    return register


def packet(servo: int, content: bytes) -> bytes:
    """Packet of protocol 2.0: FD FD for each FD that ends FF FF FD in the content."""
    stuffed = bytearray()
    for byte in content:
        stuffed.append(byte)
        if bytes(stuffed[-3:]) == b"\xff\xff\xfd":
            stuffed.append(0xFD)
    size = len(stuffed) + 2
    head = bytes([0xFF, 0xFF, 0xFD, 0, servo, size % 256, size // 256]) + bytes(stuffed)
    check = crc(head)
    return head + bytes([check % 256, check // 256])


class Servo:
    """An XL330: its control table, a finger that turns it, and its watchdog."""

    def __init__(self, number: int, degrees: float, model: int = 1200, stops: str = "limp"):
        self.number, self.degrees, self.stops = number, degrees, stops
        self.table = bytearray(147)
        self.put(0, 2, model)
        self.put(7, 1, number)
        self.put(11, 1, 3)
        self.put(38, 2, 1750)
        self.heard_at = 0.0
        self.is_alive = True
        self.rejected = 0
        self.watchdog_sticks = False

    def put(self, address: int, size: int, value: int) -> None:
        for k in range(size):
            self.table[address + k] = value >> 8 * k & 255

    def get(self, address: int, size: int) -> int:
        value = sum(self.table[address + k] << 8 * k for k in range(size))
        return value - (1 << 8 * size) if value >> (8 * size - 1) else value

    @property
    def current(self) -> int:
        """Motor current [mA]: towards the goal position, at most the goal current."""
        if not self.is_alive or not self.table[64] or self.table[11] != 5:
            return 0
        fired = self.get(98, 1) == -1
        if fired and self.stops == "limp":
            return 0
        if fired:
            # It holds its place against whoever pulls, with what it was allowed last.
            return self.get(102, 2)
        error = self.get(116, 4) - round(self.degrees / 360 * 4096)
        size = min(abs(error) * 20, abs(self.get(102, 2)))
        return size if error > 0 else -size

    def tick(self, time: float) -> None:
        unit = self.get(98, 1)
        if self.table[64] and unit > 0 and time - self.heard_at > 0.02 * unit and not self.watchdog_sticks:
            self.put(98, 1, 255)

    def write(self, address: int, data: bytes) -> None:
        if not self.is_alive:
            return
        if address < 64 and self.table[64]:
            self.rejected += 1
            return
        if 100 <= address < 120 and self.get(98, 1) == -1:
            self.rejected += 1
            return
        if address == 98 and self.get(98, 1) == -1 and data[0] != 0:
            self.rejected += 1
            return
        if address == 102 and abs(int.from_bytes(data[:2], "little", signed=True)) > self.get(38, 2):
            self.rejected += 1
            return
        if address == 64 and data[0] == 1 and not self.table[64]:
            self.put(116, 4, round(self.degrees / 360 * 4096))
        self.table[address : address + len(data)] = data

    def read(self, address: int, size: int) -> bytes:
        self.put(126, 2, self.current)
        self.put(132, 4, round(self.degrees / 360 * 4096))
        return bytes(self.table[address : address + size])


class ServoChain:
    """Five servos on a half-duplex bus."""

    def __init__(self, **options):
        self.servos = [Servo(k, SERVO_ZERO[k], **options) for k in range(5)]
        self.waiting = bytearray()
        self.alert = 0

    def exchange(self, time: float, data: bytes) -> bytes:
        """Take what the host sent, and return what the servos answer."""
        for servo in self.servos:
            servo.tick(time)
        self.waiting += data
        answers = b""
        while True:
            start = self.waiting.find(b"\xff\xff\xfd\x00")
            if start < 0 or len(self.waiting) < start + 7:
                return answers
            size = self.waiting[start + 5] + 256 * self.waiting[start + 6]
            end = start + 7 + size
            if size > 500:
                del self.waiting[: start + 1]
                continue
            if len(self.waiting) < end:
                return answers
            whole = bytes(self.waiting[start:end])
            if crc(whole[:-2]) != whole[-2] + 256 * whole[-1]:
                del self.waiting[: start + 1]
                continue
            del self.waiting[:end]
            content = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            if content[0] != 0x55:
                answers += self.instruction(time, whole[4], content[0], content[1:])

    def instruction(self, time: float, to: int, kind: int, rest: bytes) -> bytes:
        for servo in self.servos:
            servo.heard_at = time
        address, size = rest[0] + 256 * rest[1], rest[2] + 256 * rest[3] if len(rest) > 3 else 0
        if kind == 0x83:
            for at in range(4, len(rest), size + 1):
                servo = next((one for one in self.servos if one.number == rest[at]), None)
                if servo is not None:
                    servo.write(address, rest[at + 1 : at + 1 + size])
            return b""
        if kind == 0x82:
            answers = b""
            for number in rest[4:]:
                servo = self.servos[number]
                # One that is dead ends the chain of answers for those after it, as each waits for the one before.
                if not servo.is_alive:
                    break
                answers += packet(number, bytes([0x55, self.alert]) + servo.read(address, size))
            return answers
        return b""


class Board:
    """The main board: 16 encoders and five vibration actuators."""

    def __init__(self, supply: float = 3.3, period: float = 0.008):
        self.supply, self.period, self.next_at = supply, period, 0.0
        self.degrees = [float(zero) for zero in ENCODER_ZERO]
        self.waves = [(0, 0)] * 5
        self.is_silent = False
        # Milliseconds until each waveform is played again, and what was played when.
        self.counters, self.ticked_at = [0] * 5, None
        self.played: list[tuple[float, int, int]] = []
        self.messages: list[tuple[float, bytes]] = []
        self.loses = 0

    def frame(self, time: float) -> bytes:
        words = [round(self.supply * 1e6)]
        for degrees in self.degrees:
            volts = degrees / 360 * self.supply
            words.append(int(volts / 5.0 * 0x7FFFFF) & 0xFFFFFFFF)
        total = sum(words) & 0xFFFF
        words.append(total << 16 | round(1e3 * time) & 0xFFFF)
        out = b"\xaa\x55\x00\x00"
        for word in words:
            out += bytes(word >> shift & 255 for shift in (0, 8, 16, 24))
        return out

    def exchange(self, time: float, data: bytes) -> bytes:
        """Take what the host sent, as the firmware's interrupt does: one message of ten bytes at most."""
        data = data[:10]
        if data:
            self.messages.append((time, data))
            if self.loses > 0:
                self.loses, data = self.loses - 1, b""
        if len(data) >= 7 and data[0] == 0x55 and data[1] == 0xAA and sum(data[2:6]) & 255 == data[6] and data[2] < 5:
            self.waves[data[2]] = data[3], data[4] * 256 + data[5]
            self.counters[data[2]] = 0
        elapsed = 0 if self.ticked_at is None else round(1e3 * (time - self.ticked_at))
        if self.ticked_at is None or elapsed:
            self.ticked_at = time
        self.counters = [max(0, counter - elapsed) for counter in self.counters]
        out = b""
        while time >= self.next_at:
            self.next_at = max(self.next_at + self.period, time - self.period)
            self.play(time)
            out += b"" if self.is_silent else self.frame(time)
        return out

    def play(self, time: float) -> None:
        """Part of the main loop: each waveform of 1 to 123 is played again after its duration; others stop."""
        for channel, (wave, duration) in enumerate(self.waves):
            if not 0 < wave < 124:
                if self.strength(channel, time):
                    self.played.append((time, channel, 0))
            elif self.counters[channel] == 0:
                self.counters[channel] = duration
                self.played.append((time, channel, wave))

    def strength(self, channel: int, time: float, lasts: float = 0.2) -> float:
        """Strength of a channel's vibration, 0 to 1; a buzz is taken to last so long [s]."""
        last = next(((at, wave) for at, which, wave in reversed(self.played) if which == channel), (0.0, 0))
        return {47: 1.0, 48: 0.8, 49: 0.6, 50: 0.4, 51: 0.2}.get(last[1], 0.0) * (time - last[0] <= lasts)


class Glove:
    """A whole glove on a person's hand, whose joints bend [degrees of flexion]."""

    def __init__(self, **options):
        self.board, self.chain = Board(), ServoChain(**options)

    def bend(self, flexion: float) -> None:
        """Bend all joints by as much; abductions stay."""
        for k in range(16):
            kind = (0, 1, 2, 3)[k] if k < 4 else (k - 4) % 3
            # The distal joint's reading grows with flexion, the middle one's falls.
            self.board.degrees[k] = ENCODER_ZERO[k] + {0: flexion, 1: -flexion}.get(kind, 0.0)
        for servo, zero in zip(self.chain.servos, SERVO_ZERO):
            servo.degrees = zero + flexion

    def held(self) -> float:
        """Largest current of a servo [mA]."""
        return max(abs(servo.current) for servo in self.chain.servos)
