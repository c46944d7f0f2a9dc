"""The host against a device, a line and a hand that share no code with it: for tests, and for the benchmark's page.

Delays drift under each fault, either way, and the device's clock runs apart; what is judged is the torque that the
device holds, each millisecond of virtual time.
"""

import random
import struct
from collections import deque
from collections.abc import Callable

import numpy as np

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.sensors import nominal_sensors
from tests.glove import independent_device as page
from tests.glove.independent_device import IndependentDevice

IN_TIME = 0.055
FRAME = 460 / 115_200
"""Time of 46 bytes [s]."""
RAD_PER_COUNT, TORQUE_PER_COUNT = 5e-6 / 12.5e-3, 0.12 / 4095
"""Of the nominal sensors."""


class LineDirection:
    """Line in one direction: pieces of bytes, each with its transmission time and an additional delay."""

    def __init__(self):
        self.waits = lambda timestamp: 0.0
        self.is_cut = False
        self.spoils = 0.0
        self._rng = random.Random(0)
        self._free_at = self._last = 0.0
        self._pieces: deque[tuple[float, bytes]] = deque()

    def send(self, timestamp: float, data: bytes) -> None:
        self._free_at = max(timestamp, self._free_at) + FRAME * len(data) / 46
        # None overtakes another.
        self._last = max(self._last, self._free_at + self.waits(timestamp))
        if self._rng.random() < self.spoils:
            data = bytes(byte ^ (self._rng.random() < 0.05) for byte in data)
        if not self.is_cut:
            self._pieces.append((self._last, data))

    def came(self, timestamp: float) -> bytes:
        data = b""
        while self._pieces and self._pieces[0][0] <= timestamp:
            data += self._pieces.popleft()[1]
        return b"" if self.is_cut else data


class RigLine(Line):
    def __init__(self, rig: "Rig"):
        self._rig = rig

    def read(self) -> bytes:
        self._check()
        return self._rig.inward.came(self._rig.now)

    def is_free(self) -> bool:
        self._check()
        return True

    def write(self, data: bytes) -> bool:
        self._check()
        self._rig.outward.send(self._rig.now, data)
        return True

    def close(self) -> None:
        return

    def _check(self) -> None:
        if not self._rig.is_plugged:
            raise LineError("it is unplugged")


class Rig:
    """Time, device, line and hand; and the host, which asks for the torques of a spring."""

    def __init__(self, seed: int, drift: float):
        rng = random.Random(seed)
        self.now, self.drift = 50.0, drift
        self.device = IndependentDevice(rng.randrange(2**32))
        self.outward, self.inward = LineDirection(), LineDirection()
        self.is_plugged = self.is_host_alive = self.says_angles = True
        self.jump: int | None = None
        model = lrp_hand_master()
        self.host = GloveHost(model, nominal_sensors(model), lambda: RigLine(self), Guard(model, ramp=0.2))
        self.law = lambda angles: 0.25 * (angles - 0.2)
        self.is_law_old = False
        self.held: list[tuple[float, int]] = []
        self._clock0 = rng.randrange(2**32)
        self._angles, self._turn = np.zeros(14), 0
        self._next_frame, self._next_tick = 0.0, self.now + rng.uniform(0, 0.005)

    @property
    def clock(self) -> int:
        return (self._clock0 + int(self.now * (1 + self.drift) * 1e6)) % 2**32

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.001
            self.device.receive(self.clock, self.outward.came(self.now))
            self.device.step(self.clock)
            torques = np.array(self.device.counts) * 1e-5
            # A hand that wants to be at 0.6 rad, as a spring of 1 N.m/rad would.
            self._angles += 0.1 * (0.6 - torques - self._angles)
            if self.now >= self._next_frame:
                self._next_frame = self.now + 0.004
                self.inward.send(self.now, self._next_words(torques))
            self.held.append((self.now, max(self.device.counts)))
            if self.is_host_alive and self.now >= self._next_tick:
                self._next_tick = self.now + 0.005
                reading = self.host.poll(self.now)
                measured_at = reading.angles_at - 0.2 * self.is_law_old
                self.host.send(self.now, self.law(reading.angles), measured_at)

    def _next_words(self, torques: np.ndarray) -> bytes:
        answer = self.device.answer(self.clock)
        if answer:
            return answer
        self._turn += 1
        if self._turn % 25 == 0 or (self._turn % 3 and not self.says_angles):
            return self.device.status(self.clock)
        if self._turn % 3 == 0:
            return self.device.says(self.clock, page.TENSIONS, [round(torque / TORQUE_PER_COUNT) for torque in torques])
        angles = [round(angle / RAD_PER_COUNT) for angle in self._angles]
        return self.device.says(self.clock, page.ANGLES, angles if self.jump is None else [self.jump, *angles[1:]])

    def armed(self) -> "Rig":
        self.run(0.3)
        self.host.arm(self.now)
        self.run(0.5)
        assert self.host.guard.state == GuardState.ARMED and min(self.device.counts) > 3000
        return self

    def zero_after(self, since: float) -> float:
        return max((at for at, most in self.held if at >= since and most), default=since) - since


def hangs(rig: Rig) -> None:
    rig.is_host_alive = False
    rig.run(0.3)
    rig.is_host_alive = True


def unplugged(rig: Rig) -> None:
    rig.is_plugged = False
    rig.outward.is_cut = rig.inward.is_cut = True


def greeted_by_another(rig: Rig) -> None:
    body = struct.pack("<BBHII14h", 2 << 4 | page.HELLO, 0, 7, 12345, 0, 99, *(0,) * 13)
    rig.device.receive(rig.clock, b"\0" + page.stuffed(body + struct.pack("<I", page.check_sum(body))))


def late(name: str, seconds: float):
    return lambda rig: setattr(getattr(rig, name), "waits", lambda timestamp: seconds)


def sets(path: str, value):
    def fault(rig: Rig) -> None:
        *parents, last = path.split(".")
        owner = rig
        for name in parents:
            owner = getattr(owner, name)
        setattr(owner, last, value)

    return fault


FAULTS: dict[str, Callable[[Rig], object]] = {
    "the host dies": sets("is_host_alive", False),
    "the host hangs and goes on": hangs,
    "the cable is unplugged": unplugged,
    "nothing reaches the device": sets("outward.is_cut", True),
    "nothing reaches the host": sets("inward.is_cut", True),
    "the way out takes 0.3 s": late("outward", 0.3),
    "the way back takes 0.3 s": late("inward", 0.3),
    "every frame out is spoilt": sets("outward.spoils", 1.0),
    "torques are no numbers": sets("law", lambda angles: np.full(14, np.nan)),
    "torques answer old angles": sets("is_law_old", True),
    "an encoder jumps": sets("jump", 32767),
    "the encoders fall silent": sets("says_angles", False),
    "a fault of the device": lambda rig: rig.device.own_fault(),
    "the button is pressed": sets("device.is_pressed", True),
    "a stop is typed": lambda rig: rig.host.stop(rig.now),
    "another host greets": greeted_by_another,
}
WAYS = ("outward", "inward", "both")


def drifting(direction: str, since: float):
    """Return a delay that grows by 10 ms/s up to 10 ms (5 ms in each direction), which a host may bear."""
    most = 0.005 if direction == "both" else 0.01
    return lambda timestamp: min(0.01 * (timestamp - since), most)


def one_fault(name: str, direction: str, seed: int, drift: float, runs: float) -> float:
    """Return the seconds for which the device holds torque after a fault, ``runs`` after delays began to drift."""
    world = Rig(seed, drift).armed()
    for name_of_line in ("outward", "inward") if direction == "both" else (direction,):
        getattr(world, name_of_line).waits = drifting(direction, world.now)
    world.run(runs)
    assert world.host.guard.state == GuardState.ARMED, world.host.guard.cause
    since = world.now
    FAULTS[name](world)
    world.run(0.4)
    assert world.device.state != page.ARMED
    return world.zero_after(since)
