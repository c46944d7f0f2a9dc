"""Simulated glove with its host on a line as slow as a real one, with faults and a record; any clock drives it.

No clock and no process are needed: in virtual time all is reproducible, the faults of the line's bytes too. On the line
bytes arrive after their transfer time, not by messages.
"""

import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.peers import Peer
from jaxgrasp.glove.loop.rendering import IOController, turn_rate
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.protocol.device import N_FINGERS, Cause
from jaxgrasp.glove.protocol.frames import LINE_SIZE, TICKS, encode
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.glove.simulated.simulated_glove import Cable, Fingers, SimulatedGlove


class FaultInjector:
    """Fault injector for a share of the pieces: flipped bits, lost or inserted bytes, bursts, whole losses."""

    def __init__(self, share: float, seed: int) -> None:
        """Create a fault injector.

        Args:
            share: of the pieces that pass, how many get one fault.
            seed: of what happens to them.

        Raises:
            ValueError: for a share that is none.
        """
        if not 0 <= share <= 1:
            raise ValueError(f"share is {share}: expected 0 to 1")
        self.faults = 0
        """Number of spoilt pieces."""
        self._share, self._rng = share, random.Random(seed)

    def inject(self, piece: bytes) -> bytes:
        """Return the piece, changed by one fault if it is drawn for one."""
        rng = self._rng
        if not piece or rng.random() >= self._share:
            return piece
        self.faults += 1
        out, position = bytearray(piece), rng.randrange(len(piece))
        match rng.randrange(6):
            case 0:
                out[position] ^= 1 << rng.randrange(8)
            case 1:
                del out[position]
            case 2:
                out[position:position] = rng.randbytes(rng.randrange(1, 20))
            case 3:
                out[position : position + 8] = rng.randbytes(min(8, len(out) - position))
            case 4:
                out[:0] = rng.randbytes(rng.randrange(1, 60))
            case _:
                out.clear()
        return bytes(out)


class Throttle:
    """Limiter of the bytes that a line carries to its baud rate."""

    def __init__(self, baud: int) -> None:
        """Create the limiter of an idle line of 8N1.

        Args:
            baud: bits a second; ten make a byte.
        """
        self._rate = baud / 10
        self._since: float | None = None
        self._carried = 0

    def n_passing(self, timestamp: float, waiting: int) -> int:
        """Return how many of the waiting bytes come through now; call this often, with the count of all waiting."""
        if waiting == 0:
            self._since = None
            return 0
        if self._since is None:
            # A byte that is first seen now may have been there for a while, but none travels faster for it.
            self._since, self._carried = timestamp, 0
        due = int((timestamp - self._since) * self._rate) - self._carried
        n_passed = min(max(due, 0), waiting)
        self._carried += n_passed
        if n_passed == waiting:
            self._since = None
        return n_passed


class Terminal(ABC):
    """Interface of the device's end of a line."""

    max_waiting: int
    """Largest number of bytes that were on their way to the device."""

    @abstractmethod
    def plug(self) -> None:
        """Connect the line."""

    @abstractmethod
    def unplug(self) -> None:
        """Disconnect the line and discard all bytes on their way."""

    @abstractmethod
    def read(self, timestamp: float) -> bytes:
        """Return the bytes that the line has carried to the device by now."""

    @abstractmethod
    def is_free(self) -> bool:
        """Return True if all queued bytes have left."""

    @abstractmethod
    def queue(self, data: bytes) -> None:
        """Queue bytes to send to the host."""

    @abstractmethod
    def write(self, timestamp: float) -> None:
        """Send the queued bytes that the line has carried from the device by now."""


class MemoryLine(Line):
    """Line in memory with both ends in one program, for virtual time: deterministic and never late.

    A host reads and writes it as a port; a ``Simulation`` has its other end, and is driven by whoever drives time.
    """

    def __init__(self, baud: int) -> None:
        """Create a line that is plugged in and empty."""
        self.far = _FarEnd(self, baud)
        """Device's end of the line."""
        self.to_device, self.to_host = bytearray(), bytearray()
        self.is_plugged = True

    def read(self) -> bytes:
        self._check()
        out = bytes(self.to_host)
        self.to_host.clear()
        return out

    def is_free(self) -> bool:
        self._check()
        return True

    def write(self, data: bytes) -> bool:
        self._check()
        self.to_device += data
        return True

    def close(self) -> None:
        self.to_host.clear()

    def _check(self) -> None:
        if not self.is_plugged:
            raise LineError("the line is unplugged")


class _FarEnd(Terminal):
    def __init__(self, line: MemoryLine, baud: int) -> None:
        self.max_waiting = 0
        self._line, self._queued = line, bytearray()
        self._incoming, self._outgoing = Throttle(baud), Throttle(baud)

    def plug(self) -> None:
        self._line.is_plugged = True

    def unplug(self) -> None:
        self._line.is_plugged = False
        for buffer in (self._line.to_device, self._line.to_host, self._queued):
            buffer.clear()

    def read(self, timestamp: float) -> bytes:
        waiting = self._line.to_device
        n_passed = self._incoming.n_passing(timestamp, len(waiting))
        data = bytes(waiting[:n_passed])
        del waiting[:n_passed]
        self.max_waiting = max(self.max_waiting, len(waiting))
        return data

    def is_free(self) -> bool:
        return self._line.is_plugged and not self._queued

    def queue(self, data: bytes) -> None:
        self._queued += data

    def write(self, timestamp: float) -> None:
        n_passed = self._outgoing.n_passing(timestamp, len(self._queued))
        self._line.to_host += self._queued[:n_passed]
        del self._queued[:n_passed]


FRAME_EVERY = 0.002
"""Time between the frames that a device sends [s], if the line is not slower."""
WANDER = 3e-4
"""Speed at which a simulated person's joints wander at rest [rad/s]: almost a count of the encoders a second. No
living hand stands perfectly still, and from a glove that measures no motion at all the host takes torque."""


class Simulation:
    """State of the simulation: the glove, its line, its faults, and its record."""

    def __init__(
        self,
        options: dict[str, Any],
        terminal: Terminal,
        timestamp: float,
        emit: Callable[[dict[str, Any]], None],
        model: GloveModel,
        sensors: Sensors,
    ):
        channels = len(model.joints)
        cable = Cable(channels) if options.get("friction") else None
        fingers = Fingers(wander=options.get("wander", WANDER))
        count = options.get("sensations", N_FINGERS)
        self.glove = SimulatedGlove(model, sensors, fingers=fingers, cable=cable, sensations=count)
        self.fault_injector: FaultInjector | None = None
        self.cut_until, self.back_at = -np.inf, np.inf
        self._clock0 = options.get("clock", random.randrange(TICKS))
        self._drift = options.get("drift", 5e-5)
        self.terminal, self._emit = terminal, emit
        self._start = self._stepped_at = timestamp
        self._next_frame = self._start
        self._had_torque = self._was_vibrating = False
        self._record = open(options["record"], "wb") if options.get("record") else None  # noqa: SIM115
        self._record_interval, self._recorded_at = options.get("record_every", 0.005), -np.inf

    def clock(self, timestamp: float) -> int:
        """Compute the device's own clock at a time [us]."""
        return (self._clock0 + int((timestamp - self._start) * (1 + self._drift) * 1e6)) % TICKS

    def step(self, timestamp: float) -> None:
        """Execute a pass of the loop at a time [s]: read, step the glove, send frames, record."""
        if self.back_at < timestamp:
            self.back_at = np.inf
            self.terminal.plug()
        data = self.terminal.read(timestamp)
        clock = self.clock(timestamp)
        if data and timestamp >= self.cut_until:
            self.glove.device.receive(clock, self.fault_injector.inject(data) if self.fault_injector else data)
        self.glove.step(timestamp, timestamp - self._stepped_at, clock)
        self._stepped_at = timestamp
        if timestamp >= self._next_frame and self.terminal.is_free():
            line = encode(self.glove.next_frame(clock))
            if timestamp >= self.cut_until:
                self.terminal.queue(self.fault_injector.inject(line) if self.fault_injector else line)
            self._next_frame = max(self._next_frame + FRAME_EVERY, timestamp)
        self.terminal.write(timestamp)
        self._record_events(timestamp)

    def _record_events(self, timestamp: float) -> None:
        device = self.glove.device
        has_torque = any(device.counts)
        if self._had_torque and not has_torque:
            event = {"event": "zero", "at": timestamp, "clock": self.clock(timestamp), "cause": device.cause.name}
            self._emit(event | {"state": device.state.name})
        self._had_torque = has_torque
        is_vibrating = any(device.amplitudes)
        if is_vibrating and not self._was_vibrating:
            self._emit({"event": "vibration", "at": timestamp, "amplitudes": list(device.amplitudes)})
        self._was_vibrating = is_vibrating
        if self._record is not None and timestamp - self._recorded_at >= self._record_interval:
            self._recorded_at = timestamp
            row = [timestamp, device.state, *device.counts, *self.glove.angles, *self.glove.tensions]
            self._record.write(np.array(row, np.float64).tobytes())
            self._record.flush()

    def report(self) -> dict[str, Any]:
        device = self.glove.device
        refused = {error.name: count for error, count in device.reader.refused.items()}
        numbers = {"accepted": device.accepted, "missing": device.order.missing, "stale": device.order.stale}
        device_state = {"state": device.state.name, "cause": device.cause.name, "counts": list(device.counts)}
        waiting = self.terminal.max_waiting / LINE_SIZE
        spoilt = self.fault_injector.faults if self.fault_injector else 0
        measured = {"angles": self.glove.angles.tolist(), "tensions": self.glove.tensions.tolist()}
        measured |= {"amplitudes": list(device.amplitudes), "skin": self.glove.skin_temperatures.tolist()}
        return {"refused": refused, "waiting": waiting, "spoilt": spoilt, **numbers, **device_state, **measured}

    def obey(self, order: dict[str, Any], timestamp: float) -> None:
        """Execute an order and report it; a fault lasts for the time in its order [s]."""
        match order:
            case {"bend": targets, "lasts": duration}:
                self.glove.bend(timestamp, np.array(targets, float), float(duration))
            case {"cut": duration}:
                self.cut_until = timestamp + duration
            case {"unplug": duration}:
                self.terminal.unplug()
                self.back_at = timestamp + duration
            case {"spoil": share, "seed": seed}:
                self.fault_injector = FaultInjector(share, seed) if share else None
            case {"stuck": stuck}:
                self.glove.are_encoders_stuck = bool(stuck)
            case {"frozen": channel}:
                self.glove.frozen = channel
            case {"jump": counts}:
                self.glove.jump = counts
            case {"slack": channel}:
                self.glove.slack = channel
            case {"press": pressed}:
                self.glove.device.press(bool(pressed))
            case {"fault": _}:
                self.glove.device.trip(Cause.OWN)
            case {"report": _}:
                pass
            case _:
                raise ValueError(f"order is {order}: expected one that the simulator knows")
        self._emit({"done": order, "at": timestamp, "report": self.report()})

    def close(self) -> None:
        self.terminal.unplug()
        if self._record is not None:
            self._record.close()


MILLISECOND = 0.001


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
        # A hand that stands still, so that what is computed from its angles has no noise.
        options = {"friction": friction, "wander": 0.0}
        self.simulation = Simulation(options, self.line.far, 0.0, self.events.append, model, sensors)
        self.peer = HeldPeer()
        host = GloveHost(model, sensors, lambda: self.line, Guard(model, scale=scale), baud=baud)
        self.controller = IOController(host, self.peer)
        self.record: list[tuple[float, np.ndarray, np.ndarray]] = []
        """Rows of time [s], counts of torque at the device, and angles [rad]."""
        self._period, self._next_step = 1 / turn_rate(baud), 0.0

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
                self._next_step += self._period
                self.controller.step(self.time)
