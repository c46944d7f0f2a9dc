"""A host and a simulated glove in virtual time: no clock, no thread, the same every time."""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.host import GloveHost, LinkState
from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.simulation import MemoryLine, Simulation

MODEL = lrp_hand_master()
SENSORS = nominal_sensors(MODEL)
TICK, MILLISECOND = 0.005, 0.001


class DelayedLine(MemoryLine):
    """A line on which bytes wait, either way, for times that may change; none overtakes another."""

    def __init__(self, baud: int, clock: Callable[[], float]):
        super().__init__(baud)
        self.outward = self.inward = lambda timestamp: 0.0
        self._clock, self._out, self._in = clock, deque(), deque()

    def write(self, data: bytes) -> bool:
        self._check()
        self._out.append((self._clock() + self.outward(self._clock()), data))
        return True

    def read(self) -> bytes:
        self._check()
        came = bytearray()
        while self._in and self._in[0][0] <= self._clock():
            came += self._in.popleft()[1]
        return bytes(came)

    def carry(self) -> None:
        """Pass on the data that have waited for their delay."""
        timestamp = self._clock()
        if not self.is_plugged:
            self._out.clear()
            self._in.clear()
            return
        if came := super().read():
            self._in.append((timestamp + self.inward(timestamp), came))
        while self._out and self._out[0][0] <= timestamp:
            super().write(self._out.popleft()[1])


class World:
    """Time, a glove and its host, which asks for the torques of a spring from 0.2 rad on."""

    def __init__(self, model: GloveModel = MODEL, baud: int = 115_200, **options: Any):
        self.now = 100.0
        self.line = DelayedLine(baud, lambda: self.now)
        self.events: list[dict[str, Any]] = []
        options = {"clock": 2**32 - 3_000_000, **options}
        self.simulation = Simulation(options, self.line.far, self.now, self.events.append, model, SENSORS)
        self.host = GloveHost(model, SENSORS, lambda: self.line, Guard(model, ramp=0.2), baud=baud)
        self.stiffness = 0.25
        self.is_host_alive = True
        self.history: list[tuple[float, np.ndarray]] = []
        self._next_tick = self.now

    @property
    def device(self):
        return self.simulation.glove.device

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += MILLISECOND
            self.line.carry()
            self.simulation.step(self.now)
            self.history.append((self.now, np.array(self.device.counts)))
            if self.is_host_alive and self.now >= self._next_tick:
                self._next_tick = self.now + TICK
                reading = self.host.poll(self.now)
                self.host.send(self.now, self.stiffness * (reading.angles - 0.2), reading.angles_at)

    def armed(self, angle: float = 0.6) -> "World":
        """Arm it and wait for torque."""
        self.bend(angle)
        self.run(0.5)
        self.host.arm(self.now)
        self.run(0.6)
        assert self.host.state == LinkState.ARMED and self.host.guard.state == GuardState.ARMED
        assert min(self.device.counts) > 3000
        return self

    def bend(self, angle: float, lasts: float = 0.3) -> None:
        self.simulation.obey({"bend": [angle] * 14, "lasts": lasts}, self.now)

    def zero_after(self, since: float) -> float:
        """Return the seconds until the device held nothing, for good."""
        return max([t for t, counts in self.history if t >= since and counts.any()], default=since) - since
