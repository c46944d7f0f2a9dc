"""Step of the I/O side: read sensors, evaluate the law at fresh angles, send torques; old data is never used.

Timing statistics of a loop: histograms of lateness and work, overruns, largest lateness.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.glove_device import GloveDevice, LinkState, Reading
from jaxgrasp.glove.guard import GuardOutput, GuardState
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.peers import MAX_LEAD, Peer
from jaxgrasp.glove.monitors import TensionControl
from jaxgrasp.glove.protocol.frames import LINE_SIZE
from jaxgrasp.glove.substitution import Sensations

EDGES = np.array([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]) * 1e-3
"""Edges of the histogram's bins [s]; the first bin begins at 0, the last has no end."""


FINE_EDGES = 1e-5 * 1.02 ** np.arange(700)
"""Edges of the fine bins from which percentiles are read [s]: 2 % apart, from 10 us to 10 s."""


class TickTimes:
    """Timing statistics of a loop with a fixed period."""

    def __init__(self, period: float) -> None:
        """Create statistics without any turns.

        Args:
            period: of its turns [s].
        """
        self.period = period
        self.late = np.zeros(len(EDGES) + 1, int)
        """Histogram of the turns by lateness, with the bins ``EDGES``."""
        self.busy = np.zeros(len(EDGES) + 1, int)
        """Histogram of the turns by working time, with the bins ``EDGES``."""
        self._busy_counts = np.zeros(len(FINE_EDGES) + 1, int)
        self.overruns = 0
        """Number of turns that were not over when the next was due."""
        self.worst = 0.0
        """Largest lateness of a turn [s]."""

    def add(self, late: float, busy: float) -> None:
        """Count a turn by its lateness [s] and working time [s]."""
        self.late[np.searchsorted(EDGES, late)] += 1
        self.busy[np.searchsorted(EDGES, busy)] += 1
        self._busy_counts[np.searchsorted(FINE_EDGES, busy)] += 1
        self.overruns += late + busy > self.period
        self.worst = max(self.worst, late)

    def busy_quantile(self, share: float) -> float:
        """Return the working time that a share of the turns, 0 to 1, does not exceed [s], to 2 %; 0 without turns."""
        total = int(self._busy_counts.sum())
        if not total:
            return 0.0
        k = int(np.searchsorted(np.cumsum(self._busy_counts), share * total))
        return float(FINE_EDGES[min(k, len(FINE_EDGES) - 1)])

    def summary(self) -> dict[str, Any]:
        """Return the statistics as a JSON-serializable dictionary; times in milliseconds."""
        return {
            "period": 1e3 * self.period,
            "turns": int(self.late.sum()),
            "overruns": int(self.overruns),
            "worst": 1e3 * self.worst,
            "edges": (1e3 * EDGES).tolist(),
            "late": self.late.tolist(),
            "busy": self.busy.tolist(),
            "busy_median": 1e3 * self.busy_quantile(0.5),
            "busy_99": 1e3 * self.busy_quantile(0.99),
        }

    @staticmethod
    def text(summary: dict[str, Any]) -> str:
        """Format a summary as a line of text."""
        late = np.array(summary["late"])
        edges = [f"<{edge:g}" for edge in summary["edges"]] + [f">{summary['edges'][-1]:g}"]
        shares = [
            f"{edge} ms {share:.1%}" for edge, share in zip(edges, late / max(late.sum(), 1), strict=True) if share
        ]
        overruns = summary["overruns"] / max(summary["turns"], 1)
        busy = f"busy for {summary['busy_median']:.2g} ms in the median and {summary['busy_99']:.2g} ms at 99 %"
        return f"{summary['turns']} turns, {overruns:.1%} overruns, {busy}, late by {', '.join(shares)}"


def run_at_rate(step: Callable[[float], None], rate: float, goes_on: Callable[[float], bool]) -> TickTimes:
    """Step at a constant rate until ``goes_on`` returns False; return the times of the steps.

    Args:
        step: function called with the time [s].
        rate: of the steps [Hz].
        goes_on: function called after each step with the time; False ends the loop.
    """
    times = TickTimes(1.0 / rate)
    due = time.perf_counter()
    while True:
        started = time.perf_counter()
        step(started)
        ended = time.perf_counter()
        times.add(started - due, ended - started)
        if not goes_on(ended):
            return times
        # A step that was missed is not made up for: its answer would be as late as it is.
        due = max(due + times.period, ended)
        time.sleep(max(0.0, due - time.perf_counter()))


SLOWEST_TURNS, FASTEST_TURNS = 200.0, 500.0
"""Frequencies of the I/O side's turns on a line of 115,200 baud and below, and on a fast one [Hz]."""


def turn_rate(baud: int) -> float:
    """Return the frequency of the I/O side's turns for a line [Hz]: in proportion to its baud rate, within bounds."""
    return float(np.clip(SLOWEST_TURNS * baud / 115_200, SLOWEST_TURNS, FASTEST_TURNS))


def loop_delay(baud: int, rate: float) -> float:
    """Estimate the delay from a finger's motion to its torque [s].

    Args:
        baud: bits a second of the line; ten make a byte (8N1).
        rate: frequency of the torque laws [Hz].
    """
    # Angles and torques cross the line, each waits for a turn, and a law is a part of its period too old.
    return 2 * 10 * LINE_SIZE / baud + 1.5 / turn_rate(baud) + 0.25 / rate


LONGEST_TURN = 0.1
"""Longest time that a turn counts in a record of torques [s]."""


class TorqueRecord:
    """Largest torques that a law asked for and a glove gave, and for how long each torque was cut."""

    def __init__(self, joints: Sequence[str]) -> None:
        """Create a record of these joints without any torques."""
        self._joints = tuple(joints)
        self.cut_s = np.zeros(len(joints))
        """Time for which each torque was cut while the glove was armed, by its limit or by its motor's warmth [s]."""
        self._asked, self._given = np.zeros(len(joints)), np.zeros(len(joints))

    def add(self, dt: float, requested: Float[np.ndarray, "channels"], output: GuardOutput) -> None:
        """Record a turn of ``dt`` [s] with the requested torques [N.m] and the guard's output for them."""
        if output.state != GuardState.ARMED:
            return
        is_cut = output.beyond > 0
        # A comparison with NaN is false: the first turn has no duration.
        self.cut_s += is_cut * (min(dt, LONGEST_TURN) if dt > 0 else 0.0)
        self._asked = np.fmax(self._asked, requested)
        self._given = np.fmax(self._given, output.torques)

    def summary(self) -> dict[str, Any]:
        """Return the record as a JSON-serializable dictionary, with an array by channel for each key."""
        arrays = {"asked": self._asked, "given": self._given, "cut": self.cut_s}
        return {"joints": list(self._joints)} | {name: array.tolist() for name, array in arrays.items()}

    @staticmethod
    def lines(summary: dict[str, Any]) -> list[str]:
        """Format a summary as lines of text: the torques that were cut, the longest first."""
        rows = zip(*(summary[name] for name in ("cut", "joints", "asked", "given")), strict=True)
        cut_rows = sorted((row for row in rows if row[0] > 0), reverse=True)
        if not cut_rows:
            return ["no torque was cut"]
        return ["torques that were cut: asked and given at most, and for how long"] + [
            f"  {joint:12s} asked {asked:.3f} N.m, given {given:.3f} N.m, cut for {cut_s:.1f} s"
            for cut_s, joint, asked, given in cut_rows
        ]


OLDEST_LAW = 0.03
"""Age beyond which a law is not acted on [s]: with a turn and two frames, a dead engine's torque is gone in 45 ms."""
MAX_OLDEST = 0.05
"""Largest value to which this age may be set [s]."""
REACH = 0.2
"""Largest deviation from a law's angles over which its derivative is followed [rad]."""


class IOController:
    """The I/O side of the loop, driven by calls to ``step`` at the line's own rate."""

    def __init__(
        self, host: GloveDevice, peer: Peer, *, oldest: float = OLDEST_LAW, control: TensionControl | None = None
    ) -> None:
        """Create a loop that has not turned.

        Args:
            host: of the glove.
            peer: who computes.
            oldest: age beyond which its law is not acted on [s].
            control: of the torques by the measured tensions; none if None.

        Raises:
            ValueError: for an age that is not positive, or too long to be safe, and control of torques that nobody
                measures.
        """
        if control is not None and not host.capability.measures_torque:
            raise ValueError(f"control needs measured torques, and {host.model.name} does not measure them")
        if not (isinstance(oldest, int | float) and 0 < oldest <= MAX_OLDEST):
            raise ValueError(f"oldest is {oldest!r}: expected more than 0 and at most {MAX_OLDEST} s")
        self.host, self.peer = host, peer
        self._max_age, self._control = oldest, control
        self._last_step_at = np.nan
        self.record = TorqueRecord(host.model.joints)
        """Torques that the law asked for and that the glove gave, while it was armed."""

    def step(self, timestamp: float) -> GuardOutput:
        """Read the sensors, compute the torques, send them and publish the state; return the guard's output."""
        host = self.host
        reading = host.poll(timestamp)
        law = self.peer.law(timestamp)
        fault = self._law_fault(timestamp, law)
        requested, slope = self._requested_torques(reading, law, fault)
        host.sense(Sensations.none() if law is None or fault else law.sensations)
        control = self._control if self._may_control(timestamp, reading) else None
        command = requested if control is None else control.request(requested, reading.torques)
        output = host.send(timestamp, command, reading.angles_at, slope)
        if control is not None:
            control.update_integral(
                output.torques, requested, reading.torques, max(timestamp - self._last_step_at, 0.0)
            )
        self.record.add(timestamp - self._last_step_at, requested, output)
        self._last_step_at = timestamp
        self.peer.publish(timestamp, self._state(timestamp, reading, output, requested))
        return output

    def arm(self, timestamp: float, accepted: str = "") -> None:
        """Let torques flow, if there is a law to follow; ``accepted`` is what the user said.

        Raises:
            ValueError: without one, or as the host says.
        """
        fault = self._law_fault(timestamp, self.peer.law(timestamp))
        if fault:
            raise ValueError(f"the glove cannot be armed: {fault}")
        if self._control is not None:
            self._control.reset()
        self.host.arm(timestamp, accepted)

    def _requested_torques(self, reading: Reading, law: TorqueLaw | None, fault: str) -> tuple[np.ndarray, np.ndarray]:
        """Compute torques ``(channels,)`` and their slope ``(channels, channels)``; zeros without a usable law."""
        if fault:
            self.host.guard.trip(fault)
        if law is None or fault:
            channels = len(self.host.model.joints)
            return np.zeros(channels), np.zeros((channels, channels))
        return law.at(reading.angles, REACH), law.derivative

    def _law_fault(self, timestamp: float, law: TorqueLaw | None) -> str:
        if law is None:
            return "no torque law was given: the computing side must write one"
        if not law.is_valid:
            return "the computing side marked its torque law as invalid"
        age = timestamp - law.computed_at
        if -MAX_LEAD <= age <= self._max_age:
            return ""
        return (
            f"the torque law is too old ({1e3 * age:.0f} ms, at most {1e3 * self._max_age:.0f} ms): "
            "the computing side is busy or too slow for its rate"
        )

    def _may_control(self, timestamp: float, reading: Reading) -> bool:
        is_armed = self.host.guard.state == GuardState.ARMED and self.host.state == LinkState.ARMED
        return is_armed and timestamp - reading.torques_at <= self._max_age

    def _state(
        self, timestamp: float, reading: Reading, output: GuardOutput, requested: Float[np.ndarray, "channels"]
    ) -> GloveState:
        clipped = float(np.max(output.beyond + output.assisting))
        host = self.host
        cause = host.trouble if host.state < LinkState.LINKED else host.guard.cause
        head = (timestamp, int(host.state), int(host.guard.state), clipped, reading.angles_at)
        arrays = (reading.angles, output.torques, reading.torques, requested, self.record.cut_s.copy())
        return GloveState(*head, *arrays, cause)
