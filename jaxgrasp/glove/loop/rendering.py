"""Step of the I/O side: read sensors, evaluate the law at fresh angles, send torques; old data is never used."""

import numpy as np

from jaxgrasp.glove.glove_device import GloveDevice, LinkState, Reading
from jaxgrasp.glove.guard import GuardOutput, GuardState
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.peers import AHEAD, Peer
from jaxgrasp.glove.tension import TensionControl

OLDEST_LAW = 0.03
"""Age beyond which a law is not acted on [s]: with a turn and two frames, a dead engine's torque is gone in 45 ms."""
LONGEST = 0.05
"""Largest value to which this age may be set [s]."""
REACH = 0.2
"""Largest deviation from a law's angles over which its derivative is followed [rad]."""


class Rendering:
    """The I/O side of the loop, driven by calls to ``turn`` at the line's own rate."""

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
            raise ValueError(f"control needs measured torques, which {host.model.name} has not")
        if not (isinstance(oldest, int | float) and 0 < oldest <= LONGEST):
            raise ValueError(f"oldest is {oldest!r}: expected more than 0 and at most {LONGEST} s")
        self.host, self.peer = host, peer
        self._oldest, self._control = oldest, control
        self._before = np.nan

    def turn(self, now: float) -> GuardOutput:
        """Read the sensors, compute the torques, send them and publish the state; return the guard's output."""
        host = self.host
        reading = host.poll(now)
        wanted, slope = self._wanted(now, reading)
        control = self._control if self._may_control(now, reading) else None
        asked = wanted if control is None else control.ask(wanted, reading.torques)
        output = host.send(now, asked, reading.angles_at, slope)
        if control is not None:
            control.left(output.torques, wanted, reading.torques, max(now - self._before, 0.0))
        self._before = now
        self.peer.publish(now, self._state(now, reading, output))
        return output

    def arm(self, now: float, accepted: str = "") -> None:
        """Let torques flow, if there is a law to follow; ``accepted`` is what the user said.

        Raises:
            ValueError: without one, or as the host says.
        """
        trouble = self._trouble(now, self.peer.law(now))
        if trouble:
            raise ValueError(f"the glove cannot be armed: {trouble}")
        if self._control is not None:
            self._control.forget()
        self.host.arm(now, accepted)

    def _wanted(self, now: float, reading: Reading) -> tuple[np.ndarray, np.ndarray]:
        """Compute torques ``(channels,)`` and their slope ``(channels, channels)``; zeros without a usable law."""
        law = self.peer.law(now)
        trouble = self._trouble(now, law)
        if trouble:
            self.host.guard.trip(trouble)
        if law is None or trouble:
            channels = len(self.host.model.joints)
            return np.zeros(channels), np.zeros((channels, channels))
        return law.at(reading.angles, REACH), law.derivative

    def _trouble(self, now: float, law: TorqueLaw | None) -> str:
        if law is None:
            return "nobody says which torques"
        if not law.is_valid:
            return "who computes the torques says that they are not valid"
        age = now - law.computed_at
        if -AHEAD <= age <= self._oldest:
            return ""
        return (
            f"forces come too late ({1e3 * age:.0f} ms old, {1e3 * self._oldest:.0f} at most): "
            "the computer is busy, or too slow for its rate"
        )

    def _may_control(self, now: float, reading: Reading) -> bool:
        is_armed = self.host.guard.state == GuardState.ARMED and self.host.state == LinkState.ARMED
        return is_armed and now - reading.torques_at <= self._oldest

    def _state(self, now: float, reading: Reading, output: GuardOutput) -> GloveState:
        clipped = float(np.max(output.beyond + output.assisting))
        host = self.host
        head = (now, int(host.state), int(host.guard.state), clipped, reading.angles_at)
        return GloveState(*head, reading.angles, output.torques, reading.torques)
