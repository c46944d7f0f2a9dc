"""The task of the paper's sensitivity analysis (section II-G.3, Figs. 4 and 5), as far as the paper gives it."""

import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.held import HeldCylinder
from jaxgrasp.model.paths import Turn
from jaxgrasp.model.task import Task, carrying
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
RADIUS, WEIGHT, SPEED = 0.05, 10.0, float(np.pi)
"""The paper's: 5 cm, 10 N, and pi rad/s one way, then the other."""
INDEX_CONTRIBUTIONS = (0.02, 0.1, 0.4)
"""Three values of the index's contribution, as in Fig. 5; which ones it does not say."""
GRAVITY = 9.81


@checked
def cylinder_task() -> Task:
    """Five fingertips turn a cylinder about its own, level axis: two seconds one way, two seconds back.

    The paper gives the number of contacts, the radius, the weight and the angular speed. Ours are the places (four
    fingers side by side, 2 cm apart, the thumb opposite), the contributions (a weak index; the thumb's the sum of the
    others'), stiffness, depths and friction, the axis, where it starts (the fingers below), and when it reverses.
    With these method A pulls at the index about as long as the paper says it is unstable.
    """
    held = HeldCylinder(
        radius=RADIUS,
        length=0.15,
        azimuths=jnp.array([jnp.pi, 0.0, 0.0, 0.0, 0.0]),
        heights=jnp.array([0.0, 0.03, 0.01, -0.01, -0.03]),
        friction=jnp.full(5, 0.5),
        contributions=jnp.array([3.1, 0.1, 1.0, 1.0, 1.0]),
        stiffness=jnp.full(5, 1000.0),
        depths=jnp.full(5, 2.5e-3),
        mass=WEIGHT / GRAVITY,
        center_of_mass=jnp.zeros(3),
    )
    turn = Turn(axis=jnp.array([0.0, 0.0, 1.0]), speed=SPEED, reversal=2.0)
    return carrying(held, turn, gravity=jnp.array([GRAVITY, 0.0, 0.0]))
