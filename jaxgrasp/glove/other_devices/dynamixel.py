"""Dynamixel servos of protocol 2.0 on one bus: instruction packets to bytes and status packets back; no call waits.

Packets are built and checked by ROBOTIS's ``dynamixel-sdk`` (extra ``dynamixel``). Its own calls wait for answers, up
to 34 ms each, so that it is given complete packets here, and the bytes travel by a [`Line`][jaxgrasp.glove.Line].

Registers and units: the control tables of XL330 and XC330 in the ROBOTIS e-Manual.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxgrasp.validation.optional_library import optional_library

MISSING = "Dynamixel servos need dynamixel-sdk: pip install 'jaxgrasp[dynamixel]'"
HEADER = b"\xff\xff\xfd\x00"
STATUS_INSTRUCTION = 0x55
ALERT = 0x80
"""Bit of a status packet's error byte: the servo's hardware reports an error."""
TURN = 4096
"""Counts of a servo's position for one turn."""
CURRENT_BASED_POSITION = 5
"""Operating mode in which a servo goes to its goal position with at most its goal current."""
WATCHDOG_UNIT = 0.02
"""Unit of the bus watchdog [s]."""


class Register:
    """Addresses in a servo's control table."""

    MODEL_NUMBER = 0
    OPERATING_MODE = 11
    TORQUE_ENABLE = 64
    HARDWARE_ERROR = 70
    BUS_WATCHDOG = 98
    GOAL_CURRENT = 102
    GOAL_POSITION = 116
    PRESENT_CURRENT = 126
    PRESENT_POSITION = 132


class Block(NamedTuple):
    """Part of the control table that is read at once."""

    address: int
    length: int


IDENTITY = Block(Register.MODEL_NUMBER, 12)
"""Model number to operating mode."""
CONTROL = Block(Register.TORQUE_ENABLE, 72)
"""Torque enable to present position."""


class ServoModel(NamedTuple):
    """Type of servo."""

    name: str
    torque_constant: float
    """Torque for each ampere [N.m/A]: stall torque over stall current at 5 V, by the manual."""


SERVO_MODELS = {
    1190: ServoModel("XL330-M077", 0.215 / 1.47),
    1200: ServoModel("XL330-M288", 0.52 / 1.47),
    1230: ServoModel("XC330-M181", 0.60 / 1.80),
    1240: ServoModel("XC330-M288", 0.93 / 1.80),
}
"""Servos of 5 V, whose current counts in milliamperes, by model number."""


@dataclass(frozen=True)
class Identity:
    """Type and operating mode of a servo."""

    model_number: int
    operating_mode: int


@dataclass(frozen=True)
class Control:
    """State of a servo, from its control table."""

    torque_enable: int
    hardware_error: int
    bus_watchdog: int
    """Watchdog in units of 20 ms; 0 if it is off, -1 after it fired."""
    goal_current: int
    """[mA]"""
    goal_position: int
    """[counts]"""
    present_current: int
    """[mA]"""
    present_position: int
    """[counts]"""


class Status(NamedTuple):
    """Status packet of a servo."""

    servo: int
    error: int
    parameters: bytes


def load_sdk() -> Any:
    """Import the SDK's packet handler of protocol 2.0.

    Raises:
        ImportError: without the extra ``dynamixel``; the message names the command that installs it.
    """
    return optional_library("dynamixel_sdk.protocol2_packet_handler", missing=MISSING).Protocol2PacketHandler()


def read_identity(parameters: bytes) -> Identity:
    """Decode the block ``IDENTITY``."""
    return Identity(struct.unpack_from("<H", parameters)[0], parameters[Register.OPERATING_MODE])


def read_control(parameters: bytes) -> Control:
    """Decode the block ``CONTROL``."""
    at = lambda register: register - CONTROL.address  # noqa: E731
    return Control(
        parameters[at(Register.TORQUE_ENABLE)],
        parameters[at(Register.HARDWARE_ERROR)],
        struct.unpack_from("<b", parameters, at(Register.BUS_WATCHDOG))[0],
        struct.unpack_from("<h", parameters, at(Register.GOAL_CURRENT))[0],
        struct.unpack_from("<i", parameters, at(Register.GOAL_POSITION))[0],
        struct.unpack_from("<h", parameters, at(Register.PRESENT_CURRENT))[0],
        struct.unpack_from("<i", parameters, at(Register.PRESENT_POSITION))[0],
    )


class ServoBus:
    """Encoder of instruction packets to several servos, and decoder of their status packets."""

    def __init__(self, servos: Sequence[int]) -> None:
        """Create a bus of servos with these ids, 0 to 252.

        Raises:
            ImportError: without the extra ``dynamixel``.
        """
        self.servos = tuple(servos)
        self.accepted = self.refused = 0
        """Number of valid status packets, and of packets that were not."""
        self._sdk = load_sdk()
        self._buffer = bytearray()
        self._length = 0

    def write(self, register: int, size: int, values: Mapping[int, int]) -> bytes:
        """Encode a sync write of a register of ``size`` bytes: a number for each servo.

        Raises:
            ValueError: for numbers whose bytes look like a header, which version 4.1 of the SDK does not stuff.
        """
        parameters: list[int] = []
        for servo, value in values.items():
            parameters += [servo, *value.to_bytes(size, "little", signed=value < 0)]
        port = _PacketPort()
        if HEADER[:3] in bytes(parameters):
            raise ValueError(f"values are {dict(values)}: expected numbers without the bytes of a header")
        self._sdk.syncWriteTxOnly(port, register, size, parameters, len(parameters))
        return port.written

    def write_all(self, register: int, size: int, value: int) -> bytes:
        """Encode a sync write of one number to all servos."""
        return self.write(register, size, dict.fromkeys(self.servos, value))

    def ask(self, block: Block) -> bytes:
        """Encode a sync read of a block, and discard what came before: only its answers are accepted from now on."""
        self._buffer.clear()
        self._length = block.length
        port = _PacketPort()
        self._sdk.syncReadTx(port, block.address, block.length, list(self.servos), len(self.servos), False)
        return port.written

    def feed(self, data: bytes) -> list[Status]:
        """Take bytes; return the status packets that they complete, each of the block that was asked for last."""
        self._buffer += data
        statuses: list[Status] = []
        while (start := self._buffer.find(HEADER)) >= 0:
            del self._buffer[:start]
            if len(self._buffer) < 7:
                return statuses
            length = int.from_bytes(self._buffer[5:7], "little")
            # Instruction, error, parameters, CRC, and one stuffed byte for each three at most.
            least = self._length + 4
            if not least <= length <= least + self._length // 3:
                self._skip()
                continue
            if len(self._buffer) < 7 + length:
                return statuses
            status = self._decode(bytes(self._buffer[: 7 + length]))
            if status is None:
                self._skip()
                continue
            self.accepted += 1
            statuses.append(status)
            del self._buffer[: 7 + length]
        # The header's first bytes may have come already.
        del self._buffer[: max(0, len(self._buffer) - 3)]
        return statuses

    def _skip(self) -> None:
        """Refuse what begins like a packet: a false start costs one byte, or a packet within it would be lost too."""
        self.refused += 1
        del self._buffer[:1]

    def _decode(self, packet: bytes) -> Status | None:
        # The echo of an instruction is no answer.
        if packet[7] != STATUS_INSTRUCTION or packet[4] not in self.servos:
            return None
        plain, result = self._sdk.rxPacket(_PacketPort(packet), False)
        length = plain[5] | plain[6] << 8
        if result != 0 or length != self._length + 4:
            return None
        return Status(plain[4], plain[8], bytes(plain[9 : 9 + self._length]))


class _PacketPort:
    """Port for the SDK that holds one packet, so that none of its calls waits."""

    is_using = False

    def __init__(self, packet: bytes = b"") -> None:
        self.written = b""
        self._packet = packet

    def clearPort(self) -> None:
        return

    def writePort(self, packet: list[int]) -> int:
        self.written += bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        data, self._packet = self._packet[:length], self._packet[length:]
        return data

    def setPacketTimeout(self, length: int) -> None:
        return

    def isPacketTimeout(self) -> bool:
        return True
