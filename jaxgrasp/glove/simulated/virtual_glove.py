"""Simulated glove with its line and host in virtual time: no clock, no process, reproducible."""

from typing import Any

import numpy as np

from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.peers import Peer
from jaxgrasp.glove.loop.rendering import IOController
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.glove.simulated.simulation import Simulation
from jaxgrasp.glove.simulated.slow_line import MemoryLine

MILLISECOND = 0.001
TURN = 0.005
"""Time between two turns of the I/O side [s]."""


class HeldPeer(Peer):
    """Peer in the same program, which holds the last law and the last state."""

    def __init__(self) -> None:
        """Create a peer without a law and without a state."""
        self.latest_law: TorqueLaw | None = None
        self.state: GloveState | None = None

    def law(self, timestamp: float) -> TorqueLaw | None:
        return self.latest_law

    def publish(self, timestamp: float, state: GloveState) -> None:
        self.state = state

    def close(self) -> None:
        self.latest_law = None


class VirtualGlove:
    """Complete I/O side with a simulated glove in virtual time, with a record of every millisecond at the device."""

    def __init__(
        self, model: GloveModel, sensors: Sensors, *, scale: float = 1.0, baud: int = 115_200, friction: bool = False
    ) -> None:
        """Create a glove that has just been switched on, at time 0.

        Args:
            model: the glove.
            sensors: its calibration, exact.
            scale: of all torques.
            baud: of its line.
            friction: of the cables.
        """
        self.time = 0.0
        self.line = MemoryLine(baud)
        self.events: list[dict[str, Any]] = []
        self.simulation = Simulation({"friction": friction}, self.line.far, 0.0, self.events.append, model, sensors)
        self.peer = HeldPeer()
        host = GloveHost(model, sensors, lambda: self.line, Guard(model, scale=scale), baud=baud)
        self.controller = IOController(host, self.peer)
        self.record: list[tuple[float, np.ndarray, np.ndarray]] = []
        """Rows of time [s], counts of torque at the device, and angles [rad]."""
        self._next_step = 0.0

    def order(self, **fields: Any) -> None:
        """Give the simulation an order, as for ``Simulation.obey``."""
        self.simulation.obey(fields, self.time)

    def run(self, until: float) -> None:
        """Advance the simulation to the time ``until`` [s]."""
        while self.time < until - MILLISECOND / 2:
            self.time += MILLISECOND
            self.simulation.step(self.time)
            glove = self.simulation.glove
            self.record.append((self.time, np.array(glove.device.counts), glove.angles.copy()))
            if self.time >= self._next_step:
                self._next_step += TURN
                self.controller.step(self.time)
