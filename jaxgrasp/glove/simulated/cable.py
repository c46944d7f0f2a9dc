"""Capstan friction with stick and slip of a cable around its guides, for the simulator."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float


@dataclass(eq=False)
class Cable:
    """Cables from motors to fingers, each with one state: how far its friction is wound up, from -1 to 1.

    Around guides of an angle, tension grows by exp(friction x angle) against the motion (Euler and Eytelwein's
    capstan); friction winds up over a short travel before it slides (Dahl, 1968) and is larger at rest than in motion
    (Stribeck), so that what moves slowly sticks and slips.
    """

    channels: int
    wrap: float = np.pi
    """Total wrap angle around the guides [rad]."""
    sliding: float = 0.08
    """Coefficient of friction in motion."""
    resting: float = 0.12
    """Coefficient of friction at rest."""
    slow: float = 0.002
    """Speed scale of the transition from rest to motion [m/s]."""
    winding: float = 2e-4
    """Travel over which friction winds up [m]."""
    state: Float[np.ndarray, "channels"] = field(init=False)

    def __post_init__(self):
        self.state = np.zeros(self.channels)

    def pull(
        self, motor: Float[np.ndarray, "channels"], speed: Float[np.ndarray, "channels"], dt: float
    ) -> Float[np.ndarray, "channels"]:
        """Compute the tensions at the fingers [N].

        Args:
            motor: tensions at the motors [N].
            speed: of the cables [m/s], positive where fingers pull them out, as they bend.
            dt: time since the last call [s].
        """
        # Exactly over the step for a constant speed, so that no step is too long.
        reach = np.sign(speed)
        self.state = reach + (self.state - reach) * np.exp(-np.abs(speed) * dt / self.winding)
        friction = self.sliding + (self.resting - self.sliding) * np.exp(-((speed / self.slow) ** 2))
        return motor * np.exp(friction * self.wrap * self.state)
