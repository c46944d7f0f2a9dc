"""What a hand does with what it holds: it lifts it, turns it, and may let it go."""

import jax
import jax.numpy as jnp

from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.model.paths import smooth_step
from jaxgrasp.numerics.rotation import rotation_by


def lift_and_turn(
    closed: Posture, times: AnyArray, *, lift: float, turn: float, axis: AnyArray, release: Posture | None = None
) -> Posture:
    """What the hand does with what it holds: a quarter of the time each to hold, lift, turn, and hold or let go.

    Args:
        closed: the posture that holds, its wrist where it starts.
        times: ``(T,)``, ascending [s].
        lift: of the wrist, along the world's z [m].
        turn: about ``axis`` through the wrist [rad].
        axis: unit vector ``(3,)`` in the world.
        release: the posture whose angles let go; ``None`` to hold on.

    Returns:
        Postures of leading axis T, which start and stop smoothly.
    """
    way = (jnp.asarray(times) - times[0]) / (times[-1] - times[0]) * 4
    lifted, turned, opened = (smooth_step(way - begin) for begin in (1.0, 2.0, 3.0))
    rotation = jax.vmap(rotation_by)(turn * turned[:, None] * jnp.asarray(axis)) @ closed.wrist.rotation
    origin = closed.wrist.origin + lift * lifted[:, None] * jnp.array([0.0, 0.0, 1.0])
    angles = jnp.broadcast_to(closed.angles, (len(way), closed.angles.shape[0]))
    if release is not None:
        angles = angles + opened[:, None] * (release.angles - closed.angles)
    return Posture(Pose(origin, rotation), angles)
