"""Simulated glove on a simulated line, with faults and a record; any clock drives it."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.protocol.device import Cause
from jaxgrasp.glove.protocol.frames import LINE_SIZE, TICKS, encode
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.glove.simulated.cable import Cable
from jaxgrasp.glove.simulated.line_faults import Spoiler
from jaxgrasp.glove.simulated.simulated_glove import SimulatedGlove
from jaxgrasp.glove.simulated.slow_line import Terminal

FRAME_EVERY = 0.004
"""Time between the frames that a device sends [s], if the line is not slower."""


class Simulation:
    """State of the simulation: the glove, its line, its faults, and its record."""

    def __init__(
        self,
        options: dict[str, Any],
        terminal: Terminal,
        now: float,
        say: Callable[[dict[str, Any]], None],
        model: GloveModel,
        sensors: Sensors,
    ):
        channels = len(model.joints)
        cable = Cable(channels) if options.get("friction") else None
        self.glove = SimulatedGlove(model, sensors, cable=cable)
        self.spoiler: Spoiler | None = None
        self.cut_until, self.back_at = -np.inf, np.inf
        self._clock0 = options.get("clock", random.randrange(TICKS))
        self._drift = options.get("drift", 5e-5)
        self.terminal, self._say = terminal, say
        self._start = self._last = now
        self._next_frame = self._start
        self._held = False
        self._record = open(options["record"], "wb") if options.get("record") else None  # noqa: SIM115
        self._every, self._recorded_at = options.get("record_every", 0.005), -np.inf

    def clock(self, now: float) -> int:
        """Compute the device's own clock at a time [us]."""
        return (self._clock0 + int((now - self._start) * (1 + self._drift) * 1e6)) % TICKS

    def turn(self, now: float) -> None:
        """Execute a pass of the loop at a time [s]: read, step the glove, send frames, record."""
        if self.back_at < now:
            self.back_at = np.inf
            self.terminal.plug()
        data = self.terminal.read(now)
        clock = self.clock(now)
        if data and now >= self.cut_until:
            self.glove.device.receive(clock, self.spoiler.spoil(data) if self.spoiler else data)
        self.glove.step(now, now - self._last, clock)
        self._last = now
        if now >= self._next_frame and self.terminal.is_free():
            line = encode(self.glove.next_frame(clock))
            if now >= self.cut_until:
                self.terminal.queue(self.spoiler.spoil(line) if self.spoiler else line)
            self._next_frame = max(self._next_frame + FRAME_EVERY, now)
        self.terminal.write(now)
        self._tell(now)

    def _tell(self, now: float) -> None:
        device = self.glove.device
        holds = any(device.counts)
        if self._held and not holds:
            said = {"event": "zero", "at": now, "clock": self.clock(now), "cause": device.cause.name}
            self._say(said | {"state": device.state.name})
        self._held = holds
        if self._record is not None and now - self._recorded_at >= self._every:
            self._recorded_at = now
            row = [now, device.state, *device.counts, *self.glove.angles, *self.glove.tensions]
            self._record.write(np.array(row, np.float64).tobytes())
            self._record.flush()

    def report(self) -> dict[str, Any]:
        device = self.glove.device
        refused = {why.name: count for why, count in device.reader.refused.items()}
        numbers = {"accepted": device.accepted, "missing": device.order.missing, "stale": device.order.stale}
        held = {"state": device.state.name, "cause": device.cause.name, "counts": list(device.counts)}
        waiting = self.terminal.most_waiting / LINE_SIZE
        spoilt = self.spoiler.faults if self.spoiler else 0
        known = {"angles": self.glove.angles.tolist(), "tensions": self.glove.tensions.tolist()}
        return {"refused": refused, "waiting": waiting, "spoilt": spoilt, **numbers, **held, **known}

    def obey(self, order: dict[str, Any], now: float) -> None:
        """Execute an order and report it; a fault lasts for the time in its order [s]."""
        match order:
            case {"bend": targets, "lasts": lasts}:
                self.glove.bend(now, np.array(targets, float), float(lasts))
            case {"cut": lasts}:
                self.cut_until = now + lasts
            case {"unplug": lasts}:
                self.terminal.unplug()
                self.back_at = now + lasts
            case {"spoil": share, "seed": seed}:
                self.spoiler = Spoiler(share, seed) if share else None
            case {"stuck": stuck}:
                self.glove.are_encoders_stuck = bool(stuck)
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
                raise ValueError(f"order {order} is none that the simulator knows")
        self._say({"done": order, "at": now, "report": self.report()})

    def close(self) -> None:
        self.terminal.unplug()
        if self._record is not None:
            self._record.close()
