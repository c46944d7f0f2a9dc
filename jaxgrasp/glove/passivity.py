"""Passivity of a teleoperator's network: time-domain observer and controller of a two-port, on both sides.

Between a person's glove and a robot far away lies a network with delay, jitter and loss. It must not give out more
energy than it took in at its two ports, the glove's torques with the person's speeds, and the measured forces with the
robot's desired speeds. Each side observes the energy of its own port, and controls what leaves by it [1, 2]: the
person's side lowers torques, the robot's side shortens the desired motion.

The energy that a side took in is passed on to the other side, but for a small reserve: each message carries the total
that was passed on so far, so that a lost message loses nothing and a late one is safe. (A reserve of zero is the rule
of [2], which counts inflow and outflow apart; the reserve lets the tremor of a hand at rest cancel at its own port, as
the energy tanks of [3] do.) A side never gives out what it does not have, so for both ports together

    E_person(t) + E_robot(t) = H_person + H_robot + (energy on its way) - 2 H(0) >= -2 H(0)

up to the error of a prediction over one step at the person's side.

[1] B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
Automation 18(1), 2002. [2] J.-H. Ryu, J. Artigas, C. Preusche, A passive bilateral control scheme for a teleoperator
with time-varying communication delay, Mechatronics 20(7), 2010. [3] M. Franken, S. Stramigioli, S. Misra, C. Secchi,
A. Macchelli, Bilateral telemanipulation with time delays, IEEE Transactions on Robotics 27(4), 2011.
"""

import math

import numpy as np
from jaxtyping import Float

INITIAL_ENERGY = 4e-4
"""Energy H(0) that a port may give out before any came in [J]."""
RESERVE = 6e-4
"""Energy that a port keeps for itself before it passes on the rest [J]."""
LARGEST_ACCELERATION = 200.0
"""Acceleration of a finger joint that the prediction of the next step allows for [rad/s2]."""
PERIOD = 2e-3
"""Time of a step [s]."""


class EnergyTank:
    """Energy that one port of the network holds, and the totals that it gave to and got from the other port."""

    def __init__(self, initial: float = INITIAL_ENERGY, reserve: float = RESERVE) -> None:
        """Create a tank that has exchanged nothing.

        Args:
            initial: energy that may be given out before any came in [J].
            reserve: energy that is kept before the rest is passed on [J].

        Raises:
            ValueError: for an energy that is negative or not finite.
        """
        for name, value in {"initial": initial, "reserve": reserve}.items():
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}: expected an energy, 0 or more [J]")
        self._reserve = reserve
        self.level = initial
        """Energy that the port may still give out [J]."""
        self.net = 0.0
        """Energy that came in by the port, minus what went out by it [J]."""
        self.sent = 0.0
        """Total energy passed on to the other port [J]; send it with each message."""
        self._received = 0.0

    def receive(self, sent_by_other: float) -> None:
        """Take over what the other port passed on, by its total [J]; totals that are old or not finite do nothing."""
        if math.isfinite(sent_by_other) and sent_by_other > self._received:
            self.level += sent_by_other - self._received
            self._received = sent_by_other

    def add(self, energy: float) -> None:
        """Count an energy that came in by the port [J], negative for one that went out, and pass on the excess."""
        self.net += energy
        self.level += energy
        # Only what came in by this port is passed on: what the other one sent is for use here.
        passed_on = min(energy, self.level - self._reserve)
        if passed_on > 0:
            self.level -= passed_on
            self.sent += passed_on


class TorquePort:
    """Port at the person's side: the network sets the torques against flexion, the person the angles.

    A channel may also be a force against a place [N, m]: only their product counts, the energy.
    """

    def __init__(
        self,
        initial: float = INITIAL_ENERGY,
        reserve: float = RESERVE,
        *,
        period: float = PERIOD,
        largest_acceleration: float | Float[np.ndarray, "channels"] = LARGEST_ACCELERATION,
    ) -> None:
        """Create a port at which nothing has moved.

        Args:
            initial: as for [`jaxgrasp.glove.passivity.EnergyTank`][], as is ``reserve``.
            reserve: energy that is kept [J].
            period: time of a step [s].
            largest_acceleration: that the prediction of the next step allows for, of each channel [rad/s2, m/s2].
        """
        self.tank = EnergyTank(initial, reserve)
        self._margin = largest_acceleration * period**2
        self._torques: np.ndarray | None = None
        self._angles: np.ndarray | None = None
        self._change: np.ndarray | None = None

    def step(
        self, angles: Float[np.ndarray, "channels"], requested: Float[np.ndarray, "channels"], sent_by_other: float
    ) -> Float[np.ndarray, "channels"]:
        """Observe the motion since the last step, and limit the torques of the next one.

        Args:
            angles: measured angles now [rad].
            requested: torques against flexion that the robot's side asks for [N.m].
            sent_by_other: newest known total of the other side's ``tank.sent`` [J].

        Returns:
            Torques [N.m], to be held until the next step: those of joints that may give energy to the person are
            lowered where the port has less than they could give.
        """
        self.tank.receive(sent_by_other)
        if self._angles is not None and self._torques is not None:
            self._change = angles - self._angles
            # dE = tau . dtheta: a person who flexes against a torque gives energy
            self.tank.add(float(self._torques @ self._change))
        self._angles = np.array(angles, float)
        torques = np.array(requested, float)
        if self._change is not None:
            # The next change may fall short of the last one by an acceleration.
            outflow = np.maximum(-torques * (self._change - np.sign(torques) * self._margin), 0.0)
            share = _allowed_share(self.tank.level, float(outflow.sum()))
            torques = np.where(outflow > 0, share * torques, torques)
        self._torques = torques
        return torques.copy()


class MotionPort:
    """Port at the robot's side: the network sets the desired angles, the robot's contacts the torques."""

    def __init__(
        self, angles: Float[np.ndarray, "channels"], initial: float = INITIAL_ENERGY, reserve: float = RESERVE
    ) -> None:
        """Create a port whose desired angles start here [rad]; the rest as for ``TorquePort``."""
        self.tank = EnergyTank(initial, reserve)
        self.angles = np.array(angles, float)
        """Desired angles that left the network [rad]."""

    def step(
        self, received: Float[np.ndarray, "channels"], torques: Float[np.ndarray, "channels"], sent_by_other: float
    ) -> Float[np.ndarray, "channels"]:
        """Move the desired angles towards the received ones, as far as there is energy to work against the torques.

        Args:
            received: newest angles of the person [rad].
            torques: measured torques against flexion now [N.m].
            sent_by_other: newest known total of the other side's ``tank.sent`` [J].

        Returns:
            Desired angles [rad]. What is held back now is made up for once there is energy, since the difference to
            the received angles remains.
        """
        self.tank.receive(sent_by_other)
        change = received - self.angles
        work = torques * change
        outflow, inflow = float(np.maximum(work, 0.0).sum()), float(np.maximum(-work, 0.0).sum())
        share = _allowed_share(self.tank.level + inflow, outflow)
        change = np.where(work > 0, share * change, change)
        self.angles = self.angles + change
        self.tank.add(-float(torques @ change))
        return self.angles.copy()


def _allowed_share(available: float, outflow: float) -> float:
    """Return the share, 0 to 1, of an outflow [J] that the available energy [J] allows."""
    return 1.0 if outflow <= max(available, 0.0) else max(available, 0.0) / outflow
